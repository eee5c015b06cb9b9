"""The catalogue of effects: what each adds to a joint, where it may sit, what its numbers mean and how far they go.

An effect is defined once: its kind writes numbers into slots of the parameter row, and the torques, drives and readings
that use those slots serve both the simulator and the equations of a log. `term` is that definition on paper (s = sign
of the speed v, phi a deflection), `confused_with` its nearest neighbour in the residual and what tells the two apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from types import MappingProxyType

from via_sim.device_numbers import NAMES
from via_sim.effect_kinds import (
    MAX_DELAY,
    NEVER,
    EffectKind,
    EffectParameter,
    harmonic,
    into_slot,
    more_harmonics,
    write_bias,
    write_contact,
    write_dead_time,
    write_encoder_error,
    write_gain,
    write_goal_speed,
    write_gravity,
    write_hysteresis,
    write_link_inertia,
    write_numbers,
    write_payload,
    write_pulse,
    write_ripple,
    write_spring_law,
)
from via_sim.friction_kinds import FRICTION_KINDS
from via_sim.measurements import MAX_SKEW
from via_sim.parameters import ENCODER_HARMONICS, MOTOR_1, RIPPLE_HARMONICS, P

_SWING = harmonic(0, "rad", 0.5)

_KINDS = (
    *FRICTION_KINDS,
    EffectKind(
        "backlash",
        ("transmission",),
        "a torque-free gap between motor and spring; `motor` is the number of the transmission",
        "tau_e(0) for |phi| < gap/2, else tau_e(phi -+ gap/2)",
        "presliding_friction, spring_law: a torque-free gap of constant width, impact at its end",
        (EffectParameter("gap", "rad", 0.0, 0.5, 0.0, "whole width of the gap"),),
        into_slot(P.backlash, "gap", MOTOR_1),
    ),
    EffectKind(
        "hysteresis",
        ("transmission",),
        "a Maxwell element beside the spring: elastic until it slips",
        "-F, dF = stiffness dphi within |F| <= torque",
        "spring_law, preset_error: loading against unloading; presliding_friction: it acts on both sides",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "at which it slips"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1.0, "until then"),
        ),
        write_hysteresis,
    ),
    EffectKind(
        "spring_damping",
        ("transmission",),
        "damping inside the transmission, of the speed of deflection",
        "-coefficient dphi/dt",
        "viscous_friction: it acts on both sides",
        (EffectParameter("coefficient", "N m s/rad", 0.0, 1e2, 0.0, "torque per speed of deflection", True),),
        into_slot(P.spring_damping, "coefficient", MOTOR_1),
    ),
    EffectKind(
        "spring_law",
        ("transmission",),
        "error of the spring's law: its scale, and hardening (or softening) that grows with the deflection",
        "scale (1 + hardening phi^2) tau_e(phi)",
        "hysteresis: loading against unloading",
        (
            EffectParameter("scale", "-", 0.1, 10.0, 1.0, "torque per torque of the law", True),
            EffectParameter("hardening", "1/rad^2", -1e3, 1e3, 0.0, "share added per squared deflection", True),
        ),
        write_spring_law,
    ),
    EffectKind(
        "stiffness_drift",
        ("transmission",),
        "a spring that stiffens or softens while the run goes on",
        "(1 + rate t) tau_e(phi), t since the run began",
        "payload, wear: time",
        (EffectParameter("rate", "1/s", -1.0, 1.0, 0.0, "share of the torque added per time", True),),
        into_slot(P.stiffness_rate, "rate", MOTOR_1),
    ),
    EffectKind(
        "preset_error",
        ("transmission",),
        "the angle that pretensions the spring is off: of a serial joint the preset motor's, else its own motor's",
        "tau_e(phi - offset); serial: tau_e(phi, preset + offset)",
        "encoder_offset, spring_law: other presets",
        (EffectParameter("offset", "rad", -1.0, 1.0, 0.0, "added to the angle the spring sees"),),
        into_slot(P.pretension_offset, "offset", MOTOR_1),
    ),
    EffectKind(
        "joint_coupling",
        ("transmission", "link"),
        "torque from the angle of a neighbour joint (channel `neighbour`): on the link, or between link and motor",
        "stiffness neighbour",
        "external_torque: other motion of the neighbour",
        (EffectParameter("stiffness", "N m/rad", -1e3, 1e3, 0.0, "torque per angle of the neighbour", True),),
        into_slot(P.coupling, "stiffness"),
    ),
    EffectKind(
        "torque_gain",
        ("motor", "sensor"),
        "the motor gives gain times the torque commanded, unknown to the torque measurement; or that reads gain times",
        "gain u",
        "everything scaled: one known mass",
        (EffectParameter("gain", "-", 0.0, 10.0, 1.0, "torque per torque commanded; reading per torque", True),),
        write_gain,
        needs_torque_drive=True,
        of_drive=True,
    ),
    EffectKind(
        "torque_bias",
        ("motor", "sensor"),
        "a constant torque that nobody commanded; or that the torque measurement adds",
        "u + torque",
        "asymmetric_coulomb: a hold at standstill; preset_error: it does not depend on stiffness",
        (EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "added", True),),
        write_bias,
        needs_torque_drive=True,
        of_drive=True,
    ),
    EffectKind(
        "torque_ripple",
        ("motor",),
        "cogging: a torque over the angle of the motor, a Fourier series of a few orders",
        "sum_k amplitude_k sin(order_k theta + phase_k)",
        "encoder_eccentricity: its order, and its sign under reversal",
        harmonic(0, "N m", 1e3),
        write_ripple,
        needs_torque_drive=True,
        of_drive=True,
        optional=more_harmonics(RIPPLE_HARMONICS, "N m", 1e3),
    ),
    EffectKind(
        "torque_saturation",
        ("motor",),
        "a limit of the drive that nobody knows: of its torque; of a servo the speed [rad/s] at which it slews",
        "clip(u, -limit, limit)",
        "torque_gain: only large commands",
        (EffectParameter("limit", "N m", 1e-3, NEVER, NEVER, "largest torque; speed of a servo", servo_unit="rad/s"),),
        into_slot(P.saturation, "limit"),
        of_drive=True,
    ),
    EffectKind(
        "actuator_lag",
        ("command",),
        "a lag of first order between command and torque, of all drives; a servo's 2/w grows by it; a position drive's "
        "goal lags",
        "T dy/dt = u - y",
        "actuator_delay: the answer to a step bends at once",
        (EffectParameter("time_constant", "s", 0.0, 0.5, 0.0, "T"),),
        into_slot(P.lag, "time_constant"),
    ),
    EffectKind(
        "actuator_delay",
        ("command",),
        "dead time between all commands and what they do, in any fraction of a tick; beside that of a position drive",
        "u(t - delay)",
        "actuator_lag, friction, a filter: linear in frequency, not in 1/v",
        (EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time"),),
        write_dead_time,
    ),
    EffectKind(
        "speed_limit",
        ("command",),
        "a position drive's goal follows the commanded angle at most at this speed; beside a limit that the device "
        "file states, the lower one acts",
        "|dg/dt| <= limit, g the goal that acts",
        "torque_saturation, actuator_lag: the same steps against another load, and smaller steps",
        (EffectParameter("limit", "rad/s", 1e-3, NEVER, NEVER, "largest speed of the goal"),),
        write_goal_speed,
        of_goal=True,
    ),
    EffectKind(
        "encoder_offset",
        ("sensor",),
        "an encoder whose zero is off; `motor` 0 is the link's",
        "reads angle + offset",
        "preset_error, gravity_error: the other equations that use the angle",
        (EffectParameter("offset", "rad", -pi, pi, 0.0, "read too much"),),
        into_slot(P.encoder_offset, "offset"),
    ),
    EffectKind(
        "encoder_eccentricity",
        ("sensor",),
        "periodic error of an encoder, of order 1 where it is off its axis; `motor` 0 is the link's",
        "reads angle + sum_k amplitude_k sin(order_k angle + phase_k)",
        "torque_ripple: it bends every equation that uses the angle",
        (_SWING[0], _SWING[2]),
        write_encoder_error,
        optional=(_SWING[1], *more_harmonics(ENCODER_HARMONICS, "rad", 0.5)),
    ),
    EffectKind(
        "encoder_quantisation",
        ("sensor",),
        "an encoder with coarser steps than its file says; `motor` 0 is the link's",
        "reads quantum round(angle/quantum)",
        "noise: the readings stand on a grid",
        (EffectParameter("quantum", "rad", 0.0, 0.5, 0.0, "least step; finer than the file's has no effect"),),
        into_slot(P.encoder_quantum, "quantum"),
    ),
    EffectKind(
        "channel_skew",
        ("timing",),
        "one angle is stamped later than the other channels; `motor` 0 is the link's",
        "reads angle(t - delay)",
        "actuator_delay, viscous_friction: other equations that use the angle; which reading its drive answered to",
        (EffectParameter("delay", "s", 0.0, MAX_SKEW, 0.0, "by which it is late"),),
        into_slot(P.skew, "delay"),
    ),
    EffectKind(
        "payload",
        ("link",),
        "a mass on the link, along its gravity; where the device has none, the axis is upright and only inertia grows",
        "M + m l^2, gravity_torque + m g l",
        "link_inertia, gravity_error: it ties the two",
        (
            EffectParameter("mass", "kg", 0.0, 1e3, 0.0, "m"),
            EffectParameter("distance", "m", 0.0, 10.0, 0.0, "l from the axis"),
        ),
        write_payload,
    ),
    EffectKind(
        "link_inertia",
        ("link",),
        "error of the link's inertia",
        "M + inertia",
        "payload: no gravity comes with it",
        (EffectParameter("inertia", "kg m^2", -1e3, 1e3, 0.0, "added to the device's", True),),
        write_link_inertia,
    ),
    EffectKind(
        "gravity_error",
        ("link",),
        "error of the gravity torque, or of where the link hangs at rest",
        "(gravity_torque + torque) sin(q - gravity_angle - angle)",
        "payload: no inertia comes with it",
        (
            EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "added to the device's", True),
            EffectParameter("angle", "rad", -pi, pi, 0.0, "added to the device's"),
        ),
        write_gravity,
    ),
    EffectKind(
        "contact",
        ("environment",),
        "a wall on one side of the link: a spring and a damper that never pull",
        "-side max(stiffness depth + damping d(depth)/dt, 0), depth = side (q - angle) > 0",
        "spring_law: it starts at one link angle",
        (
            EffectParameter("angle", "rad", -10.0, 10.0, 0.0, "where the wall stands"),
            EffectParameter("stiffness", "N m/rad", 0.0, 1e6, 0.0, "of the wall", True),
            EffectParameter("damping", "N m s/rad", 0.0, 1e4, 0.0, "of the wall", True),
            EffectParameter("side", "-", -1.0, 1.0, 1.0, "1: beyond the angle, -1: before it"),
        ),
        write_contact,
    ),
    EffectKind(
        "external_torque",
        ("environment",),
        "a torque on the link that nobody recorded, constant from start until stop",
        "torque for start <= t < stop, t since the run began",
        "gravity_error, torque_bias: it does not depend on the angle, and on time",
        (
            EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "on the link", True),
            EffectParameter("start", "s", 0.0, NEVER, 0.0, "age of the run at which it begins"),
            EffectParameter("stop", "s", 0.0, NEVER, NEVER, "age of the run at which it ends"),
        ),
        write_pulse,
    ),
)

EFFECTS: Mapping[str, EffectKind] = MappingProxyType({kind.name: kind for kind in _KINDS})
DEVICE_NUMBERS = EffectKind(
    "device_numbers",
    ("device",),
    "not an effect but what it was fitted with: factors on numbers of the device file, written before all effects",
    "factor times the number",
    "",
    (),
    write_numbers,
    optional=tuple(EffectParameter(name, "-", 0.1, 10.0, 1.0, "factor") for name in NAMES),
)
