"""`check` with a device reports signals that an estimator of it needs and does not get."""

from pathlib import Path

import numpy as np
import pytest
from via_core.bags.definitions import typestore_of
from via_core.bags.inspection import check
from via_core.bags.joints import StampReport
from via_core.bags.writer import BagWriter
from via_core.devices import Device, load_device
from via_core.wire import JOINT_STATE

DEVICE = load_device("cubic_demo")
NAMES = (DEVICE.link_joint, *DEVICE.motor_joints)


def bag(folder: Path, names: tuple[str, ...], effort: bool, still: bool = False) -> Path:
    """Fifty samples of joints that move, with or without effort, which may stand still at 0."""
    store = typestore_of(JOINT_STATE)
    kinds = store.types
    with BagWriter(folder) as writer:
        writer.add_topic("/joint_states", JOINT_STATE)
        for k in range(50):
            stamp = kinds["builtin_interfaces/msg/Time"](0, k * 1_000_000)
            header = kinds["std_msgs/msg/Header"](stamp, "")
            position = 0.1 * np.sin(0.3 * k + np.arange(len(names)))
            torque = np.zeros(len(names)) if still else position + 1.0
            message = kinds[JOINT_STATE](header, list(names), position, np.empty(0), torque if effort else np.empty(0))
            writer.write("/joint_states", bytes(store.serialize_cdr(message, JOINT_STATE)), k * 1_000_000)
    return folder


def complaints(path: Path, device: Device = DEVICE) -> list[tuple[str, str]]:
    return [(each.severity, each.text) for each in check(path, device) if each.check == "channel"]


def test_a_complete_joint_has_no_findings(tmp_path):
    assert complaints(bag(tmp_path / "run", NAMES, effort=True)) == []


def test_missing_efforts_are_reported(tmp_path):
    found = complaints(bag(tmp_path / "run", NAMES, effort=False))
    assert [severity for severity, _ in found] == ["warning", "warning"]
    assert all(f"the effort of motor {i}" in text for i, (_, text) in enumerate(found, start=1))


def test_a_missing_motor_is_reported_twice(tmp_path):
    found = complaints(bag(tmp_path / "run", NAMES[:2], effort=True))
    assert [text.split(" is ")[0] for _, text in found] == ["the angle of motor 2", "the effort of motor 2"]


def test_efforts_that_are_always_zero_are_reported(tmp_path):
    found = complaints(bag(tmp_path / "run", NAMES, effort=True, still=True))
    assert [severity for severity, _ in found] == ["warning", "warning"]
    assert "is 0 in all messages" in found[0][1]


def test_the_torque_of_a_rigid_joint_is_missed_as_well(tmp_path):
    """It comes alone, or never changes, or is there."""
    pendulum = load_device("dfki_simple_pendulum")
    names = (pendulum.link_joint, *pendulum.drive_joints)
    assert complaints(bag(tmp_path / "whole", names, effort=True), pendulum) == []
    (still,) = complaints(bag(tmp_path / "still", names, effort=True, still=True), pendulum)
    assert still == ("warning", "the effort of the drive is 0 in all messages; check that it is measured")
    ((_, alone),) = complaints(bag(tmp_path / "alone", names[:1], effort=True), pendulum)
    assert alone.startswith("the effort of the drive is in no message that names the link")


def test_messages_without_the_link_are_named_where_a_torque_is_missing(tmp_path):
    report = StampReport("/joint_states", 0, messages=100, others=50, repeated=0, backward=0, kept=50)
    assert report.hint == "; 50 of 100 messages do not name the link: publish its drive in the same ones"


@pytest.mark.parametrize("topic", ["/robot/joint_states"])
def test_another_joint_topic_can_be_checked(tmp_path, topic):
    path = bag(tmp_path / "run", NAMES, effort=True)
    assert any(each.check == "joint" and topic in each.text for each in check(path, DEVICE, topic))
