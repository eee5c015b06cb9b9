"""MuJoCo model (MJCF) of a joint, for MuJoCo 4.

    link                body with hinge: damping (linear, quadratic), frictionloss, ref (encoder offset)
    motor i             body with hinge beside the link's, on the same axis
    spring i            fixed tendons of length q - theta_i, see springs.py; spatial ones between levers
    drive               actuator: gain, bias, control range, filter, delay; position drives: kp, force range, slew rate
    ripple, LuGre       passive DC motors without electrical part
    servo               actuator on a body that is too heavy for the springs to move

Friction constraints of MuJoCo are soft: a stuck joint creeps. `solreffriction` of two time steps and an impedance close
to one make that negligible. Sources: XML reference and changelog of MuJoCo 4.0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, pi, sin

from via_core.spring_equations import N_COEFFICIENTS
from via_core.springs import MaccepaSpring, TwoLeverSpring
from via_sim.joint.parameters import LINK, P
from via_sim.plants import GRAVITY

from via_export.mjcf_drives import NOT_A_SERVO, drive, limited, servo_inertia
from via_export.mjcf_timing import integrator, late, step
from via_export.springs import PRESET_LAWS, SpringTerm, preload, spring_terms
from via_export.target import Target
from via_export.xml import Attributes, Element, Value, document, element, text

FAR = 1e3  # [rad] of a tendon that pulls on one side
STUCK = 1e-6  # [rad] least travel of LuGre's bristle until it slides, for Stribeck friction
RESOLVED = 0.5  # [rad] most of an oscillation on that bristle in a time step
SOFTEST = 1e-4  # smallest impedance of a constraint, with which it is a spring and a damper


@dataclass
class Parts:
    """Elements of a joint that a model or a fragment contains."""

    joint: Attributes = field(default_factory=dict)  # attributes of the link's joint
    in_link: list[Element] = field(default_factory=list)  # sites of the link
    bodies: list[Element] = field(default_factory=list)  # motors and sites, beside the link
    tendons: list[Element] = field(default_factory=list)
    actuators: list[Element] = field(default_factory=list)
    sensors: list[Element] = field(default_factory=list)


def write(target: Target, comment: str = "") -> str:
    """The model of the joint alone; angle 0 of the link is that of the device."""
    parts, h = joint_parts(target), step(target)
    mass, distance, about = target.centre
    hang = target.gravity_angle
    inertial = element(
        "inertial", pos=(distance * cos(hang), -distance * sin(hang), 0.0), mass=mass, diaginertia=(about,) * 3
    )
    link = element("body", element("joint", **parts.joint), inertial, *parts.in_link, name=f"{target.device.name}_link")
    frame = element("frame", link, *parts.bodies)
    if target.gravity_torque > 0.0:  # x of the frame points down, z is the axis
        frame.set("xyaxes", "0 0 -1 -1 0 0")
    root = element(
        "mujoco",
        element("compiler", angle="radian", autolimits=True),
        element("option", element("flag", contact="disable"), timestep=h, integrator=integrator(target),
                gravity=(0.0, 0.0, -GRAVITY), iterations=100, tolerance=1e-12),
        element("worldbody", frame),
        *sections(parts),
        model=target.device.name,
    )  # fmt: skip
    return document(root, comment)


def sections(parts: Parts) -> list[Element]:
    """The sections beside the bodies that are not empty."""
    named = (("tendon", parts.tendons), ("actuator", parts.actuators), ("sensor", parts.sensors))
    return [element(name, *children) for name, children in named if children]


def joint_parts(target: Target, link: str = "", kept: float = 0.0) -> Parts:
    """All elements.

    link  name of the link's joint in a given model; empty: that of the device
    kept  [rad] value of that joint at its reference in the given model
    """
    names = (link or target.names[0], *target.names[1:])
    parts = Parts()
    parts.joint = {"name": names[0], "type": "hinge", "axis": "0 0 1", **_axis(target, LINK, kept), **_wall(target)}
    _passive(target, LINK, names, parts)
    for axis in range(1, 1 + target.device.n_motors):
        _motor(target, axis, names, parts)
        _passive(target, axis, names, parts)
    for i in range(target.device.n_transmissions):
        _spring(target, i, names, parts)
    _damper(target, names, parts)
    for axis in target.drives:
        parts.actuators.append(drive(target, axis, names[axis]))
    for axis, name in enumerate(names):
        parts.sensors.append(_sensor(target, axis, name))
    return parts


def _axis(target: Target, axis: int, kept: float = 0.0) -> Attributes:
    """Attributes of a joint: damping, dry friction, a spring to the base, encoder offset."""
    row, h, shift = target.row, step(target), target.of_axis(P.encoder_offset, axis) + kept
    found: Attributes = {"ref": shift}
    if stiffness := float(row[P.link_spring + axis]):
        found |= {"stiffness": stiffness, "springref": float(row[P.link_spring_rest + axis]) + shift}
    linear, quadratic = target.viscous(axis), float(row[P.quadratic_drag + axis])
    if axis == LINK and target.device.damper is not None and target.device.damper.site == "link":
        linear += float(target.device.damping_of(0.0)) * _damper_scale(target)
    if linear or quadratic:
        found["damping"] = (linear, quadratic, 0.0) if quadratic else linear
    breakaway, kinetic, _ = target.dry(axis)
    if breakaway == kinetic > 0.0:
        found |= {"frictionloss": kinetic, "solreffriction": (2.0 * h, 1.0), "solimpfriction": (0.9999, 0.9999, 1e-3)}
    return found


def _wall(target: Target) -> Attributes:
    """A soft limit: with the smallest impedance its force is stiffness depth + damping speed, never pulling."""
    row = target.row
    stiffness = float(row[P.contact_stiffness])
    if stiffness <= 0.0:
        return {}
    wall = float(row[P.contact_angle]) + target.of_axis(P.encoder_offset, LINK)
    ends = (-FAR, wall) if row[P.contact_side] > 0.0 else (wall, FAR)
    return {
        **limited("", ends),
        "solreflimit": (-stiffness / target.inertia, -float(row[P.contact_damping]) / target.inertia),
        "solimplimit": (SOFTEST, SOFTEST, 1e-3), "margin": 0.0,
    }  # fmt: skip


def _passive(target: Target, axis: int, names: tuple[str, ...], parts: Parts) -> None:
    """Passive DC motors: constant torque, ripple, Stribeck friction and bristles."""
    offset = target.of_axis(P.encoder_offset, axis)

    def add(what: str, **more: Value) -> None:
        parts.actuators.append(
            element("dcmotor", name=f"{names[axis]}_{what}", joint=names[axis], input="none", resistance=1.0,
                    motorconst=(0.0, 0.0), **more)
        )  # fmt: skip

    constant = target.constant(axis)
    if constant:
        add("constant", cogging=(constant, 0.0, 0.5 * pi))
    for k, (amplitude, order, phase) in enumerate(target.ripple(axis), 1):
        # `poles` is an integer: other orders by the gear, which scales the torque as well
        gear, poles = (1.0, order) if order == round(order) else (order, 1.0)
        add(f"ripple_{k}", gear=gear, cogging=(amplitude / gear, poles, phase - order * offset))
    breakaway, kinetic, speed = target.dry(axis)
    if breakaway > kinetic:
        stiffest = target.of_axis(P.inertia, axis) * (RESOLVED / step(target)) ** 2
        add("stribeck", lugre=(min(breakaway / STUCK, stiffest), 0.0, kinetic, breakaway, speed))
    torque, stiffness = target.bristle(axis)
    if torque > 0.0:
        add("presliding", lugre=(stiffness, 0.0, torque, torque, 1.0))


def _motor(target: Target, axis: int, names: tuple[str, ...], parts: Parts) -> None:
    """The body of a motor: with its inertia, or of a servo, heavy. The preset motor of a MACCEPA is a slide."""
    device = target.device
    spring = device.springs[min(axis, device.n_transmissions) - 1]
    inertia = servo_inertia(target, axis) if target.is_servo(axis) else target.of_axis(P.inertia, axis)
    inertial = element("inertial", pos=(0.0, 0.0, 0.0), mass=1.0, diaginertia=(inertia,) * 3)
    joint = element("joint", name=names[axis], type="hinge", axis="0 0 1", **_axis(target, axis))
    body = element("body", joint, inertial, name=f"{names[axis]}_rotor")
    parts.bodies.append(body)
    if isinstance(spring, MaccepaSpring) and axis == 1:
        body.append(element("site", name=f"{names[axis]}_lever", pos=(spring.lever, 0.0, 0.0)))
        parts.in_link.append(element("site", name=f"{names[0]}_base", pos=(spring.base, 0.0, 0.0)))
    if isinstance(spring, MaccepaSpring) and axis == 2 and device.arrangement == "serial":
        joint.set("type", "slide")  # its travel is the length on the drum
        joint.set("ref", text(spring.drum_radius * target.of_axis(P.encoder_offset, axis)))
        inertial.set("mass", inertial.get("diaginertia", "").split()[0])
        body.set("pos", f"{-FAR * spring.drum_radius!r} 0 0")
        joint.set("axis", "-1 0 0")
        body.append(element("site", name=f"{names[axis]}_drum", pos=(0.0, 0.0, 0.0)))
        parts.bodies.append(element("site", name=f"{names[axis]}_end", pos=(0.0, 0.0, 0.0)))
    if isinstance(spring, TwoLeverSpring):
        body.set("pos", f"{spring.offset!r} {-spring.side * spring.distance!r} 0")
        body.append(element("site", name=f"{names[axis]}_lever", pos=(0.0, spring.side * spring.motor_lever, 0.0)))
        parts.in_link.append(element("site", name=f"{names[0]}_lever_{axis}", pos=(spring.link_lever, 0.0, 0.0)))


def _spring(target: Target, i: int, names: tuple[str, ...], parts: Parts) -> None:
    """Tendons of transmission i between the link and motor i + 1."""
    row, motor, device = target.row, names[1 + i], target.device
    shift = target.of_axis(P.encoder_offset, LINK) - target.of_axis(P.encoder_offset, 1 + i)
    if row[P.serial] == 0.0:
        shift += float(row[P.pretension_offset + i])
    half = 0.5 * float(row[P.backlash + i])

    def fixed(name: str, low: float, high: float, **more: Value) -> None:
        ends = [element("joint", joint=joint, coef=coef) for joint, coef in ((names[0], 1.0), (motor, -1.0))]
        rest = tuple(-0.9999999999 if x == -1.0 else x for x in (low, high))  # -1 would mean: computed
        parts.tendons.append(element("fixed", *ends, name=f"{motor}_{name}", springlength=rest, **more))

    if device.springs[i].kind in PRESET_LAWS:
        parts.tendons.append(_levers(target, i, names))
    else:
        for k, term in enumerate(spring_terms(target, i), 1):
            low, high = _band(term, shift, half)
            fixed(f"spring_{k}", low, high, stiffness=(term.a, term.b, term.c))
        if base := preload(target, i):  # pulls the link back
            fixed("preload", shift, shift)
            parts.actuators.append(
                element("dcmotor", name=f"{motor}_preload", tendon=f"{motor}_preload", input="none", resistance=1.0,
                        motorconst=(0.0, 0.0), cogging=(-base, 0.0, 0.5 * pi))
            )  # fmt: skip
    if damping := float(row[P.spring_damping + i]):
        fixed("damping", shift, shift, damping=damping)
    if (slip := float(row[P.hysteresis_torque + i])) > 0.0:
        stiffness = float(row[P.hysteresis_stiffness + i])
        fixed("hysteresis", shift, shift, stiffness=stiffness, springyield=slip / stiffness)


def _band(term: SpringTerm, shift: float, half: float) -> tuple[float, float]:
    """Rest lengths of a term: the dead band of its knot and of the backlash."""
    knot = term.knot + half
    return (-FAR if term.direction > 0 else shift - knot), (FAR if term.direction < 0 else shift + knot)


def _levers(target: Target, i: int, names: tuple[str, ...]) -> Element:
    """The spring between two levers as a spatial tendon; that of a MACCEPA continues to the drum."""
    spring, row = target.device.springs[i], target.row
    motor = names[1 + i]
    k = float(row[P.spring_scale + i]) * float(row[P.spring + i * N_COEFFICIENTS])
    if isinstance(spring, MaccepaSpring):
        k /= spring.lever * spring.base
        path = [element("site", site=f"{motor}_lever"), element("site", site=f"{names[0]}_base")]
        rest = spring.free_length - spring.drum_radius * float(row[P.pretension_offset + i])
        if target.device.arrangement == "serial":
            path += [
                element("pulley", divisor=1.0),
                *(element("site", site=f"{names[2]}_{end}") for end in ("end", "drum")),
            ]
            rest += FAR * spring.drum_radius
        return element("spatial", *path, name=f"{motor}_spring", stiffness=k, springlength=rest)
    assert isinstance(spring, TwoLeverSpring)
    path = [element("site", site=f"{motor}_lever"), element("site", site=f"{names[0]}_lever_{1 + i}")]
    return element("spatial", *path, name=f"{motor}_spring", stiffness=k, springlength=spring.rest_length)


def _damper_scale(target: Target) -> float:
    """Factor on the damper of the device file."""
    slots, filed = target.row[P.damper : P.damper + 2], target.nominal[P.damper : P.damper + 2]
    return float(slots[1] / filed[1]) if filed[1] else 1.0


def _damper(target: Target, names: tuple[str, ...], parts: Parts) -> None:
    """Actuators whose gain is a velocity: torque -(coefficient u) v; one per stage of the damper."""
    device = target.device
    if device.damper is None:
        return
    where: Attributes = {"joint": names[0]}
    if device.damper.site == "transmission":
        ends = [element("joint", joint=joint, coef=coef) for joint, coef in ((names[0], 1.0), (names[1], -1.0))]
        name = f"{names[1]}_damper"
        least = float(device.damping_of(0.0)) * _damper_scale(target)
        parts.tendons.append(element("fixed", *ends, name=name, springlength=(0.0, 0.0), damping=least))
        where = {"tendon": name}
    ends_of = (0.0, 1.0) if device.damper.map == "linear" else (0.0, 0.5, 1.0)
    for k, (low, high) in enumerate(pairwise(ends_of), 1):
        rise = float(device.damping_of(high) - device.damping_of(low)) * _damper_scale(target) / (high - low)
        more: Attributes = {"biastype": "affine", "biasprm": (0.0, 0.0, rise * low)} if low else {}
        parts.actuators.append(
            element("general", name=f"{device.name}_damper_{k}", **where, **limited("ctrl", (low, high)),
                    gaintype="affine", gainprm=(NOT_A_SERVO, 0.0, -rise), **more, **late(target))
        )  # fmt: skip


def _sensor(target: Target, axis: int, name: str) -> Element:
    """The encoder; a late channel is a delayed sensor. The preset motor of a MACCEPA is measured at its actuator."""
    skew = target.of_axis(P.skew, axis)
    more: Attributes = {}
    if skew > 0.0:
        more = {"delay": skew, "nsample": float(2 * round(skew / step(target)) + 3), "interp": "linear"}
    device = target.device
    spring = device.springs[min(axis, device.n_transmissions) - 1] if axis else None
    if device.arrangement == "serial" and axis == 2 and isinstance(spring, MaccepaSpring):
        return element("actuatorpos", name=f"{name}_position", actuator=f"{name}_drive", **more)
    return element("jointpos", name=f"{name}_position", joint=name, **more)
