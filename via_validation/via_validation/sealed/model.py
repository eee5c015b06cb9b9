"""MuJoCo model of a device file with its Physics: bodies about one axis, tendons as springs, actuators as motors.

Joint 0 is the link, 1 and 2 are the motors, 3 is a follower. Polynomial springs are fixed tendons with polynomial
stiffness. A MACCEPA is a spatial tendon between a site on the motor's lever and a site on the link, tensioned by an
actuator. MuJoCo has no exponential springs; `loop` computes their torques.
"""

from __future__ import annotations

from math import cos, inf, isfinite, sin

import mujoco
from via_core.device_parts import ServoMotor, TorqueMotor
from via_core.devices import Device
from via_core.springs import CubicSpring, LinearSpring, MaccepaSpring, OddPolynomialSpring

from via_validation.sealed.physics import Physics

STEP = 0.25e-3  # [s] of RK4
SERVO_INERTIA = 1e4  # [kg m^2] of a servo's body: so large that the spring cannot back-drive it
TIP = 0.3  # [m] from the axis to the point that touches the wall
G = 9.81  # [m/s^2]


def polynomial(device: Device, i: int) -> tuple[float, float] | None:
    """c_0, c_1 of tau = c_0 phi + c_1 phi^3; None for springs of another form."""
    spring = device.springs[i]
    if isinstance(spring, LinearSpring):
        return spring.k, 0.0
    if isinstance(spring, CubicSpring):
        return 0.0, spring.coefficient
    if isinstance(spring, OddPolynomialSpring) and len(spring.odd_coefficients) <= 2:
        first, second = (*spring.odd_coefficients, 0.0)[:2]
        return first, second
    return None


def is_geometric(device: Device, physics: Physics, i: int) -> bool:
    """Whether transmission i is modelled as a spatial tendon: a MACCEPA without backlash."""
    return isinstance(device.springs[i], MaccepaSpring) and physics.gap[i] == 0.0


def build(device: Device, physics: Physics, step: float = STEP) -> mujoco.MjModel:
    """The compiled MuJoCo model; `step` [s]."""
    link, servo = device.link, device.drive == "servo"
    downwards = link.gravity_angle + physics.gravity_turn
    bodies = [_link(device, physics)]
    for i, motor in enumerate(device.motors):
        inertia = motor.inertia if isinstance(motor, TorqueMotor) else SERVO_INERTIA
        viscous = motor.viscous_friction if isinstance(motor, TorqueMotor) else 0.0
        dry = motor.coulomb_friction if isinstance(motor, TorqueMotor) else 0.0
        joint = _joint(f"m{i}", viscous, dry, physics, 1 + i)
        lever = ""
        if i == 0 and isinstance(device.springs[0], MaccepaSpring):
            lever = f'<site name="lever" pos="{device.springs[0].lever} 0 0"/>'
        bodies.append(f"<body>{joint}{_inertial(inertia)}{lever}</body>")
    if physics.follower_inertia > 0.0:
        bodies.append(f'<body><joint name="f" type="hinge" axis="0 0 1"/>{_inertial(physics.follower_inertia)}</body>')
    g = G if link.gravity_torque or physics.payload_mass else 0.0
    sign = -1.0 if link.gravity_torque < 0.0 else 1.0
    motors = "".join(_actuator(device, physics, i, servo, step) for i in range(max(device.n_motors, 1)))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/>
<option timestep="{step!r}" integrator="RK4" gravity="{sign * g * cos(downwards)!r} {sign * g * sin(downwards)!r} 0"
 jacobian="dense" iterations="50" tolerance="1e-14">
<flag contact="{"enable" if isfinite(physics.wall) else "disable"}" island="disable"/></option>
<default><joint solreffriction="{2.0 * step!r} 1" solimpfriction="0.9999 0.9999 0.001"/>
<geom contype="0" conaffinity="0" condim="1"/></default>
<worldbody>{"".join(bodies)}{_wall(physics)}</worldbody>
<tendon>{_tendons(device, physics)}</tendon>
<actuator>{motors}{_tension_actuator(device, physics)}</actuator></mujoco>"""
    )
    _soften_wall(model, device, physics)
    return model


def _inertial(inertia: float, mass: float = 1.0, arm: float = 0.0) -> str:
    return f'<inertial pos="{arm!r} 0 0" mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'


def _joint(name: str, viscous: float, dry: float, physics: Physics, axis: int) -> str:
    damping = f"{viscous + physics.viscous[axis]!r} {physics.drag[axis]!r}"
    loss = dry + physics.friction[axis]
    spring = f'stiffness="{physics.tie_stiffness!r}" springref="{physics.tie_rest!r}"' if axis == 0 else ""
    return f'<joint name="{name}" type="hinge" axis="0 0 1" damping="{damping}" frictionloss="{loss!r}" {spring}/>'


def _link(device: Device, physics: Physics) -> str:
    """Body of the link; the mass has so short an arm that the inertia about the axis equals the device file's."""
    link = device.link
    inertia, weight = link.inertia * physics.inertia, abs(link.gravity_torque) * physics.gravity
    arm = 0.1 * link.inertia * G / weight if weight else 0.0  # the mass contributes a tenth of the inertia
    mass = weight / (G * arm) if weight else 1.0
    parts = [_joint("q", link.viscous_friction, link.coulomb_friction, physics, 0)]
    parts.append(_inertial(inertia - mass * arm * arm, mass, arm))
    if any(isinstance(spring, MaccepaSpring) for spring in device.springs):
        spring = device.springs[0]
        assert isinstance(spring, MaccepaSpring)
        parts.append(f'<site name="base" pos="{spring.base} 0 0"/>')
    if physics.payload_mass > 0.0:
        payload = _inertial(1e-9, physics.payload_mass)
        parts.append(f'<body pos="{physics.payload_arm!r} 0 0">{payload}</body>')
    if isfinite(physics.wall):
        parts.append(f'<geom name="tip" type="sphere" size="0.02" pos="{TIP} 0 0" contype="1" conaffinity="1"/>')
    return f"<body>{''.join(parts)}</body>"


def _wall(physics: Physics) -> str:
    """A plane that the tip touches at the angle `wall`; `_soften_wall` makes the contact a spring and a damper."""
    if not isfinite(physics.wall):
        return ""
    a, side = physics.wall, physics.wall_side
    forwards = (-side * sin(a), side * cos(a))
    x, y = TIP * cos(a) + 0.02 * forwards[0], TIP * sin(a) + 0.02 * forwards[1]
    return (
        f'<geom name="wall" type="plane" size="1 1 1" pos="{x!r} {y!r} 0" zaxis="{-forwards[0]!r} {-forwards[1]!r} 0" '
        'contype="1" conaffinity="1"/>'
    )


def _soften_wall(model: mujoco.MjModel, device: Device, physics: Physics) -> None:
    """Make the contact a spring and a damper.

    The contact force is (a_ref - a_0) / (A + R) with R = (1 - d) / d A and a_ref = -(s r / d + b v) / d for a solref of
    (-s, -b). For a small impedance d it is (s r + b v) / A. A is the link body's invweight0, which MuJoCo computes at
    the centre of mass; here it is set to the value at the tip.
    """
    if isfinite(physics.wall):
        inertia = device.link.inertia * physics.inertia + physics.payload_mass * physics.payload_arm**2
        model.body_invweight0[1, 0] = TIP**2 / inertia
        model.geom_solref[:] = (-physics.wall_stiffness / inertia, -physics.wall_damping / inertia)
        model.geom_solimp[:, :3] = (0.001, 0.001, 0.001)


def _tendons(device: Device, physics: Physics) -> str:
    made = []
    for i in range(device.n_transmissions):
        joints = f'<joint joint="q" coef="1"/><joint joint="m{i}" coef="-1"/>'
        powers, half, rest = polynomial(device, i), 0.5 * physics.gap[i], physics.rest[i]
        if powers is not None or physics.spring_damping[i]:
            first, second = powers or (0.0, 0.0)
            made.append(
                f'<fixed springlength="{rest - half!r} {rest + half!r}" stiffness="{first!r} 0 {second!r}" '
                f'damping="{physics.spring_damping[i]!r}">{joints}</fixed>'
            )
        if is_geometric(device, physics, i):
            made.append('<spatial name="cord"><site site="lever"/><site site="base"/></spatial>')
        if physics.slip_torque[i] > 0.0:
            stiffness = physics.slip_stiffness[i]
            travel = physics.slip_torque[i] / stiffness
            made.append(
                f'<fixed springlength="0 0" stiffness="{stiffness!r}" springyield="{travel!r}">{joints}</fixed>'
            )
    if physics.follower_inertia > 0.0:
        made.append(
            f'<fixed springlength="0 0" stiffness="{physics.follower_stiffness!r}" '
            f'damping="{physics.follower_damping!r}">'
            '<joint joint="q" coef="1"/><joint joint="f" coef="-1"/></fixed>'
        )
    return "".join(made)


def _actuator(device: Device, physics: Physics, i: int, servo: bool, step: float) -> str:
    motor, more = device.motors[i] if device.motors else None, ""
    joint = f"m{i}" if device.motors else "q"  # the drive of a rigid joint acts on the link
    if physics.delay > 0.0:
        samples = max(round(physics.delay / step), 1)
        # A quarter of a step less, so that rounding cannot select the neighbouring sample.
        more += f' nsample="{samples + 2}" delay="{(samples - 0.25) * step!r}"'
    if isinstance(motor, ServoMotor):
        w = motor.bandwidth
        gain, bias = SERVO_INERTIA * w * w, f"0 {-SERVO_INERTIA * w * w!r} {-2.0 * SERVO_INERTIA * w!r}"
        return f'<general joint="m{i}" gainprm="{gain!r}" biastype="affine" biasprm="{bias}"{more}/>'
    if physics.lag > 0.0:
        more += f' dyntype="filterexact" dynprm="{physics.lag!r}"'
    if physics.limit[i] < inf:
        more += f' forcelimited="true" forcerange="{-physics.limit[i]!r} {physics.limit[i]!r}"'
    return (
        f'<general joint="{joint}" gainprm="{physics.gain[i]!r}" '
        f'biastype="affine" biasprm="{physics.bias[i]!r} 0 0"{more}/>'
    )


def _tension_actuator(device: Device, physics: Physics) -> str:
    """Actuator for the cord's tension K (A - A0 + r preset); its control is the preset motor's drum angle."""
    spring = device.springs[0] if device.springs else None
    if not isinstance(spring, MaccepaSpring) or not is_geometric(device, physics, 0):
        return ""
    k = spring.k
    bias = f"{k * spring.free_length!r} {-k!r} 0"
    return f'<general tendon="cord" gainprm="{-k * spring.drum_radius!r}" biastype="affine" biasprm="{bias}"/>'
