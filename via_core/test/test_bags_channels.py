"""`check` with a device reports signals that an estimator of it needs and does not get."""

from pathlib import Path

import numpy as np
import pytest
from via_core.bags.definitions import typestore_of
from via_core.bags.inspection import check
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
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


def complaints(path: Path) -> list[tuple[str, str]]:
    return [(each.severity, each.text) for each in check(path, DEVICE) if each.check == "channel"]


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


@pytest.mark.parametrize("topic", ["/robot/joint_states"])
def test_another_joint_topic_can_be_checked(tmp_path, topic):
    path = bag(tmp_path / "run", NAMES, effort=True)
    assert any(each.check == "joint" and topic in each.text for each in check(path, DEVICE, topic))
