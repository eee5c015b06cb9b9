"""SDF model of a joint, for Gazebo: a link for the base, one for the motors if there are springs, and one for the link.

With springs the motors turn the base's joint and the link turns a second joint, whose angle is the deflection; that
joint has the spring and its damping. Friction of the link then acts on the deflection's joint and not on the link.
Sources: SDFormat 1.9, elements joint/axis/dynamics and joint/axis/limit; Gazebo system JointPositionController.
"""

from __future__ import annotations

from math import cos, inf, isfinite, sin

import numpy as np
from via_core.device_parts import ServoMotor
from via_core.spring_equations import TWO_LEVER
from via_sim.joint.parameters import LINK, POSITION_DRIVE, P

from via_export import notes, payloads
from via_export.target import Target
from via_export.xml import Element, child, document, element, joint_named, leaf

VERSION = "1.9"  # the elements below are those of 1.11; older parsers refuse newer versions
MIDDLE = 0.5  # of the stop: deflection at which the stiffness of a nonlinear spring is taken
CONTROLLER = "gz::sim::systems::JointPositionController"
WIDE = 1e16  # SDF's own value of a missing limit


def write(target: Target, comment: str = "") -> str:
    """The model; at angle `gravity_angle` the link hangs along -z."""
    name = target.device.name
    flexible = target.device.n_transmissions > 0
    links = [element("link", name=f"{name}_base")]
    joints = [
        element("joint", leaf("parent", "world"), leaf("child", f"{name}_base"), name=f"{name}_fixed", type="fixed")
    ]
    if flexible:
        inertial = _inertial(1.0, (0.0, 0.0, 0.0), _motor_inertia(target))
        links.append(element("link", _turned(target, 1), inertial, name=f"{name}_motor"))
        joints.append(_joint(target, target.names[1], f"{name}_base", f"{name}_motor", _motor_axis(target)))
    links.append(_link(target))
    parent = f"{name}_motor" if flexible else f"{name}_base"
    joints.append(_joint(target, target.names[0], parent, f"{name}_link", _link_axis(target, flexible)))
    model = element("model", *links, *joints, *_plugins(target, target.names[0]), name=name)
    return document(element("sdf", model, version=VERSION), comment, declaration=True)


def _inertial(mass: float, centre: tuple[float, float, float], about: float) -> Element:
    parts = [leaf(key, about if key[1] == key[2] else 0.0) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    return element("inertial", leaf("pose", (*centre, 0.0, 0.0, 0.0)), leaf("mass", mass), element("inertia", *parts))


def _axis_of(target: Target) -> tuple[float, float, float]:
    return (0.0, 0.0, 1.0) if target.gravity_torque == 0.0 else (0.0, -1.0, 0.0)


def _link(target: Target) -> Element:
    mass, distance, about = target.centre
    hang = target.gravity_angle
    inertial = _inertial(mass, (-distance * sin(hang), 0.0, -distance * cos(hang)), about)
    return element("link", _turned(target, LINK), inertial, name=f"{target.device.name}_link")


def _turned(target: Target, axis: int) -> Element:
    """Pose of a link, turned by the encoder offset, so that angles of joints are those of the encoders."""
    turn = [-target.of_axis(P.encoder_offset, axis) * part for part in _axis_of(target)]
    return leaf("pose", (0.0, 0.0, 0.0, *turn))


def _offset(target: Target) -> float:
    """[rad] added to the angle of the link's joint: with springs that is the deflection."""
    of_motor = target.of_axis(P.encoder_offset, 1) if target.device.n_transmissions else 0.0
    return target.of_axis(P.encoder_offset, LINK) - of_motor


def _joint(target: Target, name: str, parent: str, child: str, axis: list[Element]) -> Element:
    parts = [leaf("parent", parent), leaf("child", child), element("axis", leaf("xyz", _axis_of(target)), *axis)]
    return element("joint", *parts, name=name, type="revolute")


def _dynamics(damping: float, friction: float, spring: tuple[float, float] | None = (0.0, 0.0)) -> Element:
    """spring: rest angle and stiffness; None: not written."""
    parts = [leaf("damping", damping), leaf("friction", friction)]
    if spring is not None:
        parts += [leaf("spring_reference", spring[0]), leaf("spring_stiffness", spring[1])]
    return element("dynamics", *parts)


def _limit(target: Target, wall: bool, driven: bool) -> Element:
    """Range up to a wall, with its stiffness and damping; limits of the drive."""
    low, high = target.ends if wall else (-WIDE, WIDE)
    offset = _offset(target)
    parts = [
        leaf("lower", low + offset if isfinite(low) else -WIDE),
        leaf("upper", high + offset if isfinite(high) else WIDE),
    ]
    if driven and isfinite(target.effort):
        parts.append(leaf("effort", target.effort))
    if driven and isfinite(target.speed):
        parts.append(leaf("velocity", target.speed))
    if wall and target.row[P.contact_stiffness] > 0.0:
        parts += [
            leaf("stiffness", float(target.row[P.contact_stiffness])),
            leaf("dissipation", float(target.row[P.contact_damping])),
        ]
    return element("limit", *parts)


def _motor_inertia(target: Target) -> float:
    """[kg m^2] of the motors that act on the link; of servos that of the link."""
    return target.rigid_inertia - target.inertia or target.inertia


def _motor_axis(target: Target) -> list[Element]:
    motors = target.moving[1:]
    dry = sum(target.dry(axis)[1] + target.bristle(axis)[0] for axis in motors)
    return [_dynamics(sum(target.viscous(axis) for axis in motors), dry), _limit(target, wall=False, driven=True)]


def _link_axis(target: Target, flexible: bool) -> list[Element]:
    device, row = target.device, target.row
    damping = target.viscous(LINK) + float(device.damping_of(0.0))
    dry = target.dry(LINK)[1] + target.bristle(LINK)[0]
    if not flexible:
        return [_dynamics(damping, dry, _spring_to_base(target) or (0.0, 0.0)), _limit(target, wall=True, driven=True)]
    stiffness, moment = 0.0, 0.0
    for i in range(device.n_transmissions):
        each = stiffness_of(target, i)
        shift = float(row[P.pretension_offset + i]) if row[P.serial] == 0.0 else 0.0
        stiffness, moment = stiffness + each, moment + each * shift
    damping += sum(float(row[P.spring_damping + i]) for i in range(device.n_transmissions))
    rest = moment / stiffness + _offset(target)
    return [_dynamics(damping, dry, (rest, stiffness)), _limit(target, wall=True, driven=False)]


def _spring_to_base(target: Target) -> tuple[float, float] | None:
    """Rest angle [rad] as the encoder shows it, and stiffness [N m/rad], of a spring between link and base, if any."""
    stiffness, rest = float(target.row[P.link_spring]), float(target.row[P.link_spring_rest])
    return (rest + target.of_axis(P.encoder_offset, LINK), stiffness) if stiffness else None


def stiffness_of(target: Target, i: int) -> float:
    """[N m/rad] of transmission i: of a linear spring, else half-way to the stop, of two levers at rest.

    The stiffness of a spring between two levers changes its sign with the deflection.
    """
    spring = target.device.springs[i]
    deflection = 0.0 if spring.kind == TWO_LEVER else MIDDLE * spring.max_deflection
    return float(target.row[P.spring_scale + i]) * float(spring.stiffness(deflection))


def _plugins(target: Target, joint: str) -> list[Element]:
    """A position controller for a position drive on a joint, or for the servo behind springs."""
    device, row = target.device, target.row
    if row[P.link_drive] == POSITION_DRIVE:
        gain = target.of_axis(P.torque_gain, LINK)
        p, d = gain * float(row[P.drive_stiffness]), float(row[P.drive_damping])
        limit, offset = target.effort, target.of_axis(P.torque_bias, LINK)
        integral = gain * target.integral_gain, gain * target.integral_limit
        return [_controller(joint, (p, d), limit, offset, integral)]
    if device.motors and isinstance(device.motors[0], ServoMotor):
        w, inertia = target.of_axis(P.bandwidth, 0), _motor_inertia(target)
        p, offset = inertia * w * w, target.of_axis(P.encoder_offset, 1)  # a servo follows the true angle
        return [_controller(target.names[1], (p, 2.0 * inertia * w), inf, p * offset)]
    return []


def _controller(
    joint: str, gains: tuple[float, float], limit: float, offset: float, integral: tuple[float, float] = (0.0, inf)
) -> Element:
    """gains: of error and speed; integral: gain and largest torque."""
    parts = [
        leaf("joint_name", joint),
        leaf("p_gain", gains[0]),
        leaf("i_gain", integral[0]),
        leaf("d_gain", gains[1]),
        leaf("cmd_offset", offset),
    ]
    if integral[0] > 0.0 and isfinite(integral[1]):
        parts += [leaf("i_max", integral[1]), leaf("i_min", -integral[1])]
    if isfinite(limit):
        parts += [leaf("cmd_max", limit), leaf("cmd_min", -limit)]
    return element(
        "plugin", *parts, filename="gz-sim-joint-position-controller-system", name=CONTROLLER,
    )  # fmt: skip


def into(source: Element, target: Target, name: str) -> list[str]:
    """Write friction, spring and limits into a joint of a given model, in place; notes for the user.

    Raises ValueError if there is no such joint.
    """
    found = joint_named(source, name, "axis")
    axis, slides = child(found, "axis"), found.get("type") == "prismatic"
    flexible = target.device.n_transmissions > 0
    spring = None if flexible else _spring_to_base(target)
    values: dict[str, tuple[float, float]] = {}
    for part in (_dynamics(target.rigid_viscous, target.rigid_dry[1], spring), _limit(target, wall=True, driven=True)):
        there = child(axis, part.tag)
        for value in part:
            old = there.find(value.tag)
            number = float(value.text or 0.0)
            if old is None:
                there.append(value)
            elif part.tag != "limit" or value.tag not in ("lower", "upper") or abs(number) != WIDE:
                values[f"{part.tag} {value.tag}"] = (float(old.text or 0.0), number)
                old.text = value.text
    changed = notes.replaced(values)
    below, unit = str(found.findtext("child", "")).strip(), "m" if slides else "rad"
    if offset := target.of_axis(P.encoder_offset, LINK):
        turn, about = ("move", "along") if slides else ("turn", "about")
        changed.append(
            f"encoder offset: {turn} link '{below}' and what follows it by {-offset:.6g} {unit} {about} the axis, "
            f"and add {offset:.6g} {unit} to limits that the file states"
        )
    change = notes.inertia_added(target, target.rigid_inertia)
    if slides:
        change += payloads.moments(target.effects)[0]
        changed += notes.sliding_payload(target)
    else:
        changed += _add_payloads(source, found, target)
    if abs(change) > notes.ROUNDED * target.inertia:
        to_add = f"mass: add {change:.6g} kg" if slides else f"inertia about the axis: add {change:.6g} kg m^2"
        changed.append(f"{to_add} to link '{below}'")
    changed += notes.weight(target, f"link '{below}'")
    if flexible:
        changed.append("the springs need a link of their own: take the whole model instead of --into")
        return changed
    model = next(each for each in source.iter("model") if found in list(each))
    for made in _plugins(target, name):
        for old in model.findall("plugin"):
            if old.get("name") == CONTROLLER and str(old.findtext("joint_name")).strip() == name:
                model.remove(old)
                changed.append(f"the position controller of joint '{name}' is replaced by that of the device")
        model.append(made)
    return changed


def _add_payloads(source: Element, joint: Element, target: Target) -> list[str]:
    """Add payloads as links fixed to the child link, in the direction of its centre of mass; notes where that fails."""
    inertia, gravity = payloads.moments(target.effects)
    if not inertia:
        return []
    name, child, xyz = str(joint.get("name")), str(joint.findtext("child", "")).strip(), joint.find("axis/xyz")
    link = next((each for each in source.iter("link") if each.get("name") == child), None)
    pose = None if link is None else link.findtext("inertial/pose")
    if pose is None or xyz is None or xyz.get("expressed_in") or joint.find("pose") is not None:
        return [f"payload: add {inertia:.6g} kg m^2 about the axis of '{name}' and {gravity:.6g} N m of weight"]
    centre, axis = (np.array([float(each) for each in str(text).split()[:3]]) for text in (pose, xyz.text))
    model = next(each for each in source.iter("model") if joint in list(each))
    for point in payloads.payloads_of(target.effects, name, payloads.across(centre, axis)):
        model.extend(point.sdf(child))
    return []
