"""All physics that a case adds to a joint's device file, as one frozen record; the defaults add nothing.

Axis 0 is the link, 1 and 2 are the motors; transmissions are 0 and 1. The comment of a field names the MuJoCo feature
that implements it; `loop` computes the torques that MuJoCo lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

Three = tuple[float, float, float]
Two = tuple[float, float]
Terms = tuple[float, ...]  # per motor, or per axis, HARMONICS numbers each
NO_AXIS: Three = (0.0, 0.0, 0.0)
NO_MOTOR: Two = (0.0, 0.0)
HARMONICS = 4  # most terms of a periodic effect


@dataclass(frozen=True)
class Physics:
    """Additions to the joint of a device file. Tuples hold one entry per axis (link, motor 1, motor 2) or per motor."""

    # features of MuJoCo
    friction: Three = NO_AXIS  # [N m] dof_frictionloss
    viscous: Three = NO_AXIS  # [N m s/rad] dof_damping
    drag: Three = NO_AXIS  # [N m s^2/rad^2] dof_dampingpoly
    gap: Two = NO_MOTOR  # [rad] dead band of the tendon's rest length
    rest: Two = NO_MOTOR  # [rad] shift of the tendon's rest length, as if the motor angle were larger by this
    slip_stiffness: Two = NO_MOTOR  # [N m/rad] of a tendon with plastic yield beside the spring
    slip_torque: Two = NO_MOTOR  # [N m] at which it yields
    spring_damping: Two = NO_MOTOR  # [N m s/rad] tendon_damping
    gain: Two = (1.0, 1.0)  # [-] gain of the actuator
    bias: Two = NO_MOTOR  # [N m] bias of the actuator
    limit: Two = (float("inf"), float("inf"))  # [N m] force range of the actuator
    lag: float = 0.0  # [s] activation filter of the actuators
    delay: float = 0.0  # [s] delay of the actuators; for a position drive, additional delay of its goal
    goal_speed: float = float("inf")  # [rad/s] rate limit of a position drive's goal
    position_gain: float = 1.0  # [-] factor on kp of a position drive; `gain` also scales its kd and its limit
    integral_rate: float = 0.0  # [1/s] integral of a position drive's error, added to the error
    feedforward: float = 0.0  # [-] share of kd that also acts on the speed of a position drive's goal
    goal_band: float = 0.0  # [rad] error of its goal below which it gives no torque
    inertia: float = 1.0  # [-] factor on the link's inertia about its axis
    gravity: float = 1.0  # [-] factor on the link's gravity torque
    gravity_turn: float = 0.0  # [rad] turn of the direction of gravity
    payload_mass: float = 0.0  # [kg] a body on the link
    payload_arm: float = 0.0  # [m]
    tie_stiffness: float = 0.0  # [N m/rad] jnt_stiffness: a spring between link and base
    tie_rest: float = 0.0  # [rad] qpos_spring: link angle at which it gives no torque
    wall: float = float("inf")  # [rad] link angle at which its tip touches a plane
    wall_side: float = 1.0  # +1 the plane stops positive motion, -1 negative
    wall_stiffness: float = 0.0  # [N m/rad] solref of the contact
    wall_damping: float = 0.0  # [N m s/rad]
    follower_inertia: float = 0.0  # [kg m^2] another body on a tendon from the link: an additional mode
    follower_stiffness: float = 0.0  # [N m/rad]
    follower_damping: float = 0.0  # [N m s/rad]
    # dof_frictionloss and dof_damping rewritten at every substep
    uneven: Three = NO_AXIS  # [N m] dry friction forwards minus backwards, over two
    uneven_viscous: Three = NO_AXIS  # [N m s/rad] added while the axis moves forwards, taken off while backwards
    breakaway: Three = NO_AXIS  # [N m] additional dry friction at rest
    stribeck_velocity: Three = (1.0, 1.0, 1.0)  # [rad/s]
    load_friction: Three = NO_AXIS  # [-] dry friction per torque in the transmission
    texture: Three = NO_AXIS  # [N m] dry friction that changes with the angle
    texture_order: Three = NO_AXIS  # [1/rev]
    warm_friction: Three = NO_AXIS  # [N m] dry friction of a cold joint
    warming_energy: Three = (1.0, 1.0, 1.0)  # [J] dissipated energy after which 1/e of it is left
    # torques of `loop`
    bristle: Three = NO_AXIS  # [N m] friction at which the bristle slides
    bristle_length: Three = (1.0, 1.0, 1.0)  # [rad] its deflection then
    ripple: Terms = (0.0,) * 2 * HARMONICS  # [N m] per motor
    ripple_order: Terms = (0.0,) * 2 * HARMONICS  # [1/rev]
    ripple_phase: Terms = (0.0,) * 2 * HARMONICS  # [rad]
    deadband: Two = NO_MOTOR  # [N m] command below which the drive gives no torque
    dead_zone: Two = NO_MOTOR  # [N m] that is missing from every command
    gear: Terms = (0.0,) * 2 * HARMONICS  # [rad] per motor: angle behind the gear less that of the motor
    gear_order: Terms = (1.0,) * 2 * HARMONICS  # [1/rev]
    gear_phase: Terms = (0.0,) * 2 * HARMONICS  # [rad]
    hardening: Two = NO_MOTOR  # [1/rad^2] spring torque times (1 + hardening phi^2)
    drift: Two = NO_MOTOR  # [1/s] spring torque times (1 + drift t)
    soften: Two = NO_MOTOR  # [rad] spring torque times phi^2 / (phi^2 + soften^2)
    relaxing: Two = NO_MOTOR  # [N m/rad] stiffness of a spring in series with a damper beside the spring
    relaxation: Two = (1.0, 1.0)  # [s] its time constant
    preset_shift: float = 0.0  # [rad] of the preset motor's drum (serial)
    sag: Two = NO_MOTOR  # [1/W] fraction of the torque lost per mechanical power
    # sensors
    offset: Three = NO_AXIS  # [rad]
    eccentricity: Terms = (0.0,) * 3 * HARMONICS  # [rad] per axis
    eccentric_order: Terms = (1.0,) * 3 * HARMONICS  # [1/rev]
    eccentric_phase: Terms = (0.0,) * 3 * HARMONICS  # [rad]
    quantum: Three = NO_AXIS  # [rad] used if larger than the device file's
    skew: Three = NO_AXIS  # [s] delay of the channel
    sensed_gain: Two = (1.0, 1.0)  # [-] measured torque per commanded torque
    sensed_bias: Two = NO_MOTOR  # [N m] added to the measured torque
    skipping: float = 0.0  # [rad] random slips of the link's encoder
    # environment
    push: float = 0.0  # [N m] torque on the link, constant from `push_from` to `push_until`
    push_from: float = 0.0  # [s]
    push_until: float = float("inf")  # [s]
    coupling: float = 0.0  # [N m/rad] torque on the link per angle of the neighbouring joint
    neighbour_period: float = 0.0  # [s] period of that joint's swing of +-0.5 rad; 0: no such joint
    unrest: float = 0.0  # [N m] standard deviation of a random torque on the link
    unrest_time: float = 1.0  # [s] its correlation time

    def __post_init__(self) -> None:
        for each in fields(self):  # numpy scalars would be written into the model's XML with their type
            value = getattr(self, each.name)
            plain = tuple(map(float, value)) if isinstance(value, tuple) else float(value)
            object.__setattr__(self, each.name, plain)

    def with_(self, **changes: Any) -> Physics:
        return replace(self, **changes)

    def joined(self, other: Physics) -> Physics:
        """Both together. Raises ValueError if both change the same field."""
        added = {name: getattr(other, name) for name in changed_fields(other)}
        if twice := changed_fields(self) & added.keys():
            raise ValueError(f"both change {', '.join(sorted(twice))}")
        return replace(self, **added)


def changed_fields(physics: Physics) -> set[str]:
    """Names of the fields that differ from the defaults."""
    neutral = Physics()
    return {f.name for f in fields(physics) if getattr(physics, f.name) != getattr(neutral, f.name)}


def at_axis(axis: int, value: float, others: float = 0.0) -> Three:
    """`value` at one axis, `others` at the other axes."""
    first, second, third = (value if i == axis else others for i in range(3))
    return first, second, third


def terms_at(index: int, count: int, values: Sequence[float], others: float = 0.0) -> Terms:
    """Up to HARMONICS `values` at axis or motor `index` of `count`, `others` elsewhere."""
    row = [others] * count * HARMONICS
    row[index * HARMONICS : index * HARMONICS + len(values)] = values
    return tuple(row)


def on_both_motors(physics: Physics) -> Physics:
    """The same physics with motor 1's values on both motors."""
    changes: dict[str, Any] = {}
    for name in changed_fields(physics):
        value = getattr(physics, name)
        if isinstance(value, tuple):
            each = len(value) // 2 if len(value) in (2, 2 * HARMONICS) else len(value) // 3
            motor_1 = value[-2 * each : -each]
            changes[name] = (*value[: -2 * each], *motor_1, *motor_1)
    return replace(physics, **changes)


def at_motor(motor: int, value: float, others: float = 0.0) -> Two:
    """`value` at motor or transmission 1 or 2, `others` at the other one."""
    return (value, others) if motor == 1 else (others, value)
