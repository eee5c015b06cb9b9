"""Layouts of Foxglove and PlotJuggler: every topic is in the wire contract, every field in its message."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from via_bringup.dashboards import FORMATS, foxglove, layout, plotjuggler, plots
from via_core.devices import device_names, load_device
from via_core.errors import ParameterError
from via_ros.interfaces import message_class

ROOT = Path(__file__).resolve().parents[1]
DEVICES = device_names()


def types(device: str) -> dict[str, str]:
    """Topic -> type, by the table of docs/wire.md."""
    rows = re.findall(r"^\| `(/\S+)` \| (\w+)/(\w+) \|", (ROOT / "docs" / "wire.md").read_text("utf-8"), re.MULTILINE)
    found = {topic.replace("<device>", device): f"{package}/msg/{name}" for topic, package, name in rows}
    return found | {load_device(device).command_topic: found[f"/{device}/command"]}


def is_number(kind: Any, path: str) -> bool:
    """Whether a member of a message, e.g. 'inertia[0]', is there and is a number."""
    name, _, index = path.partition("[")
    declared = kind.get_fields_and_field_types().get(name, "")
    element = re.fullmatch(r"sequence<(\w+)>", declared)
    plain = element[1] if element and index else declared
    return plain in ("double", "float", "uint8", "uint64") and bool(element) == bool(index)


def foxglove_paths(text: str) -> list[tuple[str, str]]:
    panels = json.loads(text)["configById"]
    values = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    return [(topic, field) for topic, _, field in (each.partition(".") for each in values)]


@pytest.mark.parametrize("name", DEVICES)
def test_every_topic_and_field_of_foxglove_exists(name: str) -> None:
    known, paths = (
        types(name) | {load_device(name).command_topic: "via_interfaces/msg/VsaCommand"},
        foxglove_paths(foxglove(load_device(name))),
    )
    assert paths and all(is_number(message_class(known[topic]), field) for topic, field in paths)


@pytest.mark.parametrize("name", DEVICES)
def test_every_curve_of_plotjuggler_exists(name: str) -> None:
    device = load_device(name)
    known = types(name)
    curves = [each.get("name") or "" for each in ElementTree.fromstring(plotjuggler(device).encode()).iter("curve")]
    assert curves
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        if topic.startswith("/joint_states/"):
            assert topic.removeprefix("/joint_states/") in (device.link_joint, *device.motor_joints)
            assert is_number(message_class(known["/joint_states"]), f"{field}[0]")
        else:
            assert is_number(message_class(known[topic]), field), curve


def test_a_field_that_does_not_exist_is_noticed() -> None:
    kind = message_class("via_interfaces/msg/MotorEstimate")
    assert is_number(kind, "inertia[0]") and is_number(kind, "status")
    assert not any(is_number(kind, path) for path in ("inertia", "status[0]", "stiffness", "method"))


def test_every_panel_is_in_the_layout() -> None:
    whole = json.loads(foxglove(load_device("cubic_demo")))
    assert all(f'"{panel}"' in json.dumps(whole["layout"]) for panel in whole["configById"])


def test_the_layout_has_what_the_estimator_publishes() -> None:
    titles = {name: [plot.title for plot in plots(load_device(name))] for name in ("cubic_demo", "compact_vpda")}
    assert "Stiffness [N m/rad]" in titles["cubic_demo"] and "Motor inertia [kg m^2]" in titles["cubic_demo"]
    assert "Damping [N m s/rad]" in titles["compact_vpda"] and "Stiffness [N m/rad]" not in titles["compact_vpda"]


def test_an_unknown_program_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ParameterError, match=f"no layout for 'rviz'; there are: {', '.join(FORMATS)}"):
        layout(load_device("cubic_demo"), "rviz")
