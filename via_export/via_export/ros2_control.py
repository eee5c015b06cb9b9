"""ros2_control description of a joint (URDF fragment), with joint limits and controller parameters as YAML.

ros2_control holds interfaces, limits and encoder offsets, no physics. Source: ros2_control documentation (Jazzy):
hardware components, transmissions, joint limits; ros2_controllers: pid_controller, forward_command_controller.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

import yaml
from via_core.devices import Device
from via_sim.joint.parameters import LINK, POSITION_DRIVE, P

from via_export.target import Target
from via_export.xml import Element, document, element, leaf

PLUGIN = "mock_components/GenericSystem"  # of a simulated hardware; replace it by your own


def write(target: Target, comment: str = "") -> str:
    """XML fragment for a URDF. The YAML of limits and controllers is in `parameters`."""
    device = target.device
    root = element(
        "ros2_control", element("hardware", leaf("plugin", PLUGIN)),
        *(_joint(target, axis) for axis in range(len(target.names))),
        *(_transmission(target, axis) for axis in target.drives if target.of_axis(P.encoder_offset, axis)),
        name=device.name, type="system",
    )  # fmt: skip
    return document(root, comment)


def _interface(device: Device) -> str:
    return "effort" if device.drive == "torque" else "position"


def _joint(target: Target, axis: int) -> Element:
    """An axis with the command interface of its drive, and on the link that of the damper."""
    commands = []
    if axis in target.drives:
        interface = _interface(target.device)
        limit = target.limit(axis) * target.of_axis(P.torque_gain, axis) if interface == "effort" else inf
        commands.append(command(interface, -limit, limit))
    if target.device.damper is not None and axis == LINK:
        commands.append(command("damping", 0.0, 1.0))
    return joint(target.names[axis], *commands)


def joint(name: str, *commands: Element) -> Element:
    """A joint with these command interfaces and all state interfaces."""
    states = (element("state_interface", name=each) for each in ("position", "velocity", "effort"))
    return element("joint", *commands, *states, name=name)


def command(name: str, low: float, high: float) -> Element:
    """A command interface with its range, unless that is infinite."""
    ends = [parameter("min", low), parameter("max", high)] if isfinite(high) else []
    return element("command_interface", *ends, name=name)


def parameter(name: str, value: str | float) -> Element:
    """An element `param` with this name and value."""
    made = leaf("param", value)
    made.set("name", name)
    return made


def _transmission(target: Target, axis: int) -> Element:
    """A simple transmission with the encoder offset: the joint's position is the measured one minus the offset."""
    name = target.names[axis]
    joint = element(
        "joint", leaf("mechanical_reduction", 1.0), leaf("offset", -target.of_axis(P.encoder_offset, axis)),
        name=name, role="joint1",
    )  # fmt: skip
    parts = [leaf("plugin", "transmission_interface/SimpleTransmission")]
    return element(
        "transmission", *parts, element("actuator", name=f"{name}_actuator", role="actuator1"), joint,
        name=f"{name}_transmission",
    )  # fmt: skip


def parameters(target: Target) -> str:
    """YAML: joint limits, and the gains of a position drive as a pid_controller."""
    limits: dict[str, Any] = {}
    for axis in target.drives:
        effort = target.limit(axis) * target.of_axis(P.torque_gain, axis)
        speed = target.speed if axis in target.moving or target.is_servo(axis) else float("inf")
        limits[target.names[axis]] = {
            "has_effort_limits": isfinite(effort),
            **({"max_effort": effort} if isfinite(effort) else {}),
            "has_velocity_limits": isfinite(speed),
            **({"max_velocity": speed} if isfinite(speed) else {}),
        }
    low, high = target.ends
    if isfinite(low) or isfinite(high):
        ends = {"has_position_limits": True, "min_position": max(low, -1e3), "max_position": min(high, 1e3)}
        limits.setdefault(target.names[LINK], {}).update(ends)
    content: dict[str, Any] = {"joint_limits": limits}
    if target.row[P.link_drive] == POSITION_DRIVE:
        gain = target.of_axis(P.torque_gain, LINK)
        gains: dict[str, Any] = {
            "p": gain * float(target.row[P.drive_stiffness]), "i": gain * target.integral_gain,
            "d": float(target.row[P.drive_damping]),
        }  # fmt: skip
        if isfinite(target.integral_limit) and target.integral_gain > 0.0:
            most = gain * target.integral_limit
            gains |= {"i_clamp_max": most, "i_clamp_min": -most}
        if isfinite(target.effort):
            gains |= {"u_clamp_max": target.effort, "u_clamp_min": -target.effort}
        content[f"{target.device.name}_pid_controller"] = {
            "ros__parameters": {
                "type": "pid_controller/PidController",
                "dof_names": [target.names[LINK]],
                "command_interface": "effort",
                "reference_and_state_interfaces": ["position", "velocity"],
                "gains": {target.names[LINK]: gains},
            }
        }
    return yaml.safe_dump(content, sort_keys=False)
