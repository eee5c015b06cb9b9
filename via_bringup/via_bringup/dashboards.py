"""Layouts of Foxglove and PlotJuggler for the topics of one joint (docs/wire.md)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from via_core.devices import Device
from via_core.errors import ParameterError
from via_estimators.methods import estimator_for, methods_for

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd", "#17becf")
SAMPLES = "/joint_states"


@dataclass(frozen=True)
class Curve:
    """One number over time.

    topic  of the message
    field  path of the member, e.g. 'inertia[0]'
    joint  of a JointState: name of the joint whose member it is; empty for other messages
    """

    topic: str
    field: str
    joint: str = ""


@dataclass(frozen=True)
class Plot:
    """Curves with common axes."""

    title: str
    curves: tuple[Curve, ...]


def plots(device: Device) -> list[Plot]:
    """What there is to see of a joint: samples, commands, estimates of its default method, controller, gap."""
    joints = (device.link_joint, *device.motor_joints)
    motors = range(len(device.motor_joints))

    def own(topic: str, *fields: str) -> tuple[Curve, ...]:
        return tuple(Curve(f"/{device.name}/{topic}", each) for each in fields)

    def sampled(member: str) -> tuple[Curve, ...]:
        return tuple(Curve(SAMPLES, f"{member}[{at}]", joint) for at, joint in enumerate(joints))

    found = [
        Plot("Angles [rad]", sampled("position")),
        Plot("Measured torques [N m]", sampled("effort")),
        Plot("Motor commands", tuple(Curve(device.command_topic, f"motor[{at}]") for at in motors)),
    ]
    outputs = estimator_for(device).outputs if methods_for(device) else ()
    status: tuple[Curve, ...] = ()
    for topic, unit in (("stiffness", "N m/rad"), ("damping", "N m s/rad")):
        if topic in outputs:
            found.append(Plot(f"{topic.capitalize()} [{unit}]", own(topic, "value", "standard_deviation")))
            status += own(topic, "status")
    if any("inertia" in each for each in outputs):
        found.append(Plot("Motor inertia [kg m^2]", own("motor", *(f"inertia[{at}]" for at in motors))))
    found.append(Plot("Status of estimates and controller", (*status, *own("control", "activity", "limited"))))
    found.append(Plot("Gap", own("gap", "normalised_error", "residual_ratio")))
    return [each for each in found if each.curves]


def foxglove(device: Device) -> str:
    """A layout of Foxglove: plots in two columns, over the state and the diagnostics of all nodes."""
    panels: dict[str, Any] = {
        f"Plot!{at}": {
            "foxglovePanelTitle": plot.title,
            "paths": [
                {"value": f"{each.topic}.{each.field}", "label": each.joint or each.field, "enabled": True,
                 "timestampMethod": "headerStamp"}
                for each in plot.curves
            ],
            "showLegend": True,
            "xAxisVal": "timestamp",
            "followingViewWidth": 20,
        }
        for at, plot in enumerate(plots(device))
    }  # fmt: skip
    half = (len(panels) + 1) // 2
    names = list(panels)
    panels["DiagnosticSummary!0"] = {
        "topicToRender": "/diagnostics",
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
    }
    layout = {
        "first": {"first": _stacked(names[:half]), "second": _stacked(names[half:]), "direction": "row"},
        "second": "DiagnosticSummary!0",
        "direction": "column",
        "splitPercentage": 80,
    }
    whole = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(whole, indent=1) + "\n"


def _stacked(names: list[str]) -> Any:
    """Panels of equal height below each other, as Foxglove nests them."""
    if len(names) == 1:
        return names[0]
    return {
        "first": names[0],
        "second": _stacked(names[1:]),
        "direction": "column",
        "splitPercentage": 100.0 / len(names),
    }


def plotjuggler(device: Device) -> str:
    """A layout of PlotJuggler: one tab, plots below each other; JointStates are split by the names of their joints."""
    shown = plots(device)
    root = ElementTree.Element("root")
    widget = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = ElementTree.SubElement(widget, "Tab", tab_name=device.name, containers="1")
    sizes = ";".join([f"{1.0 / len(shown):.6f}"] * len(shown))
    splitter = ElementTree.SubElement(
        ElementTree.SubElement(tab, "Container"), "DockSplitter", orientation="-", count=str(len(shown)), sizes=sizes
    )
    for plot in shown:
        area = ElementTree.SubElement(splitter, "DockArea", name=plot.title)
        drawn = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        for curve, colour in zip(plot.curves, COLOURS * len(plot.curves), strict=False):
            member = curve.field.partition("[")[0] if curve.joint else curve.field
            name = "/".join(part for part in (curve.topic, curve.joint, member) if part)
            ElementTree.SubElement(drawn, "curve", name=name, color=colour)
    ElementTree.SubElement(widget, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.SubElement(root, "previouslyLoaded_Streamer", name="ROS2 Topic Subscriber")
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"


FORMATS: Mapping[str, Callable[[Device], str]] = {"foxglove": foxglove, "plotjuggler": plotjuggler}


def layout(device: Device, to: str) -> str:
    """The text of a layout file. Raises ParameterError for a format that is not in FORMATS."""
    if to not in FORMATS:
        raise ParameterError(f"no layout for '{to}'; there are: {', '.join(FORMATS)}")
    return FORMATS[to](device)
