"""The catalogue of effects: term, sites, and meaning and bounds of the parameters.

Each effect is defined once. Its kind writes numbers into slots of the parameter row; the torques, drives and
measurements that use these slots serve the simulator and the equations of a log. `term` is the definition as a formula
(s: sign of the speed v, phi: a deflection). `confused_with` names similar effects and what distinguishes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from types import MappingProxyType

from via_sim.effects.device_numbers import NAMES
from via_sim.effects.friction_kinds import FRICTION_KINDS
from via_sim.effects.kinds import (
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
from via_sim.joint.measurements import MAX_SKEW
from via_sim.joint.parameters import ENCODER_HARMONICS, MOTOR_1, RIPPLE_HARMONICS, P

_SWING = harmonic(0, "rad", 0.5)

_KINDS = (
    *FRICTION_KINDS,
    EffectKind(
        "backlash",
        ("transmission",),
        "a torque-free gap between motor and spring; `motor` is the number of the transmission",
        "tau_e(0) for |phi| < gap/2, else tau_e(phi -+ gap/2)",
        "presliding_friction, spring_law: a torque-free gap of constant width, impact at its end",
        (EffectParameter("gap", "rad", 0.0, 0.5, 0.0, "full width of the gap"),),
        into_slot(P.backlash, "gap", MOTOR_1),
    ),
    EffectKind(
        "hysteresis",
        ("transmission",),
        "a Maxwell element parallel to the spring: elastic until it slips",
        "-F, dF = stiffness dphi within |F| <= torque",
        "spring_law, preset_error: loading against unloading; presliding_friction: acts on both sides",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "torque at which it slips"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1.0, "stiffness until it slips"),
        ),
        write_hysteresis,
    ),
    EffectKind(
        "spring_damping",
        ("transmission",),
        "damping in the transmission, proportional to the rate of deflection",
        "-coefficient dphi/dt",
        "viscous_friction: acts on both sides",
        (EffectParameter("coefficient", "N m s/rad", 0.0, 1e2, 0.0, "torque per rate of deflection", True),),
        into_slot(P.spring_damping, "coefficient", MOTOR_1),
    ),
    EffectKind(
        "spring_law",
        ("transmission",),
        "error of the spring law: its scale, and hardening (or softening) with the squared deflection",
        "scale (1 + hardening phi^2) tau_e(phi)",
        "hysteresis: loading against unloading",
        (
            EffectParameter("scale", "-", 0.1, 10.0, 1.0, "torque relative to the spring law", True),
            EffectParameter("hardening", "1/rad^2", -1e3, 1e3, 0.0, "relative increase per squared deflection", True),
        ),
        write_spring_law,
    ),
    EffectKind(
        "stiffness_drift",
        ("transmission",),
        "a spring that stiffens or softens during the run",
        "(1 + rate t) tau_e(phi), t since the beginning of the run",
        "payload, wear: time",
        (EffectParameter("rate", "1/s", -1.0, 1.0, 0.0, "relative increase of the torque per time", True),),
        into_slot(P.stiffness_rate, "rate", MOTOR_1),
    ),
    EffectKind(
        "preset_error",
        ("transmission",),
        "offset of the angle that pretensions the spring, of the preset motor in a serial joint, else of its own",
        "tau_e(phi - offset); serial: tau_e(phi, preset + offset)",
        "encoder_offset, spring_law: other presets",
        (EffectParameter("offset", "rad", -1.0, 1.0, 0.0, "added to the angle"),),
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
        "the motor torque is gain times the command; at a sensor the measured torque is gain times the torque",
        "gain u",
        "all parameters scaled: one known mass",
        (
            EffectParameter(
                "gain", "-", 0.0, 10.0, 1.0, "torque per commanded torque; measured torque per torque", True
            ),
        ),
        write_gain,
        needs_torque_drive=True,
        of_drive=True,
    ),
    EffectKind(
        "torque_bias",
        ("motor", "sensor"),
        "a constant torque added to the command; at a sensor added to the measured torque",
        "u + torque",
        "asymmetric_coulomb: a hold at standstill; preset_error: does not depend on stiffness",
        (EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "added torque", True),),
        write_bias,
        needs_torque_drive=True,
        of_drive=True,
    ),
    EffectKind(
        "torque_ripple",
        ("motor",),
        "cogging: a torque that is periodic in the motor angle, a Fourier series of a few orders",
        "sum_k amplitude_k sin(order_k theta + phase_k)",
        "encoder_eccentricity: order, and sign under reversal",
        harmonic(0, "N m", 1e3),
        write_ripple,
        needs_torque_drive=True,
        of_drive=True,
        optional=more_harmonics(RIPPLE_HARMONICS, "N m", 1e3),
    ),
    EffectKind(
        "torque_saturation",
        ("motor",),
        "an unknown limit of the drive torque; of a servo a limit of its speed [rad/s]",
        "clip(u, -limit, limit)",
        "torque_gain: only large commands",
        (
            EffectParameter(
                "limit", "N m", 1e-3, NEVER, NEVER, "largest torque; of a servo largest speed", servo_unit="rad/s"
            ),
        ),
        into_slot(P.saturation, "limit"),
        of_drive=True,
    ),
    EffectKind(
        "actuator_lag",
        ("command",),
        "a first-order lag between command and torque of all drives; of a servo added to 2/w; of a position drive "
        "it acts on the goal",
        "T dy/dt = u - y",
        "actuator_delay: the step response starts immediately",
        (EffectParameter("time_constant", "s", 0.0, 0.5, 0.0, "T"),),
        into_slot(P.lag, "time_constant"),
    ),
    EffectKind(
        "actuator_delay",
        ("command",),
        "dead time of all commands, in any fraction of a tick, in addition to that of a position drive",
        "u(t - delay)",
        "actuator_lag, friction, a filter: linear in frequency, not in 1/v",
        (EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time"),),
        write_dead_time,
    ),
    EffectKind(
        "speed_limit",
        ("command",),
        "largest speed at which the goal of a position drive follows the commanded angle; of this and the limit in the "
        "device file the lower one acts",
        "|dg/dt| <= limit, g the acting goal",
        "torque_saturation, actuator_lag: the same steps against another load, and smaller steps",
        (EffectParameter("limit", "rad/s", 1e-3, NEVER, NEVER, "largest speed of the goal"),),
        write_goal_speed,
        of_goal=True,
    ),
    EffectKind(
        "encoder_offset",
        ("sensor",),
        "an offset of an encoder; `motor` 0 is the link encoder",
        "measures angle + offset",
        "preset_error, gravity_error: the other equations that use the angle",
        (EffectParameter("offset", "rad", -pi, pi, 0.0, "added to the angle"),),
        into_slot(P.encoder_offset, "offset"),
    ),
    EffectKind(
        "encoder_eccentricity",
        ("sensor",),
        "periodic error of an encoder, of order 1 if mounted off its axis; `motor` 0 is the link encoder",
        "measures angle + sum_k amplitude_k sin(order_k angle + phase_k)",
        "torque_ripple: affects every equation that contains the angle",
        (_SWING[0], _SWING[2]),
        write_encoder_error,
        optional=(_SWING[1], *more_harmonics(ENCODER_HARMONICS, "rad", 0.5)),
    ),
    EffectKind(
        "encoder_quantisation",
        ("sensor",),
        "an encoder with a coarser resolution than in the device file; `motor` 0 is the link encoder",
        "measures quantum round(angle/quantum)",
        "noise: measurements are on a grid",
        (EffectParameter("quantum", "rad", 0.0, 0.5, 0.0, "resolution; no effect if finer than in the device file"),),
        into_slot(P.encoder_quantum, "quantum"),
    ),
    EffectKind(
        "channel_skew",
        ("timing",),
        "one angle is stamped later than the other channels; `motor` 0 is the link",
        "measures angle(t - delay)",
        "actuator_delay, viscous_friction: other equations with that angle; response of the drive",
        (EffectParameter("delay", "s", 0.0, MAX_SKEW, 0.0, "delay of the stamp"),),
        into_slot(P.skew, "delay"),
    ),
    EffectKind(
        "payload",
        ("link",),
        "a mass on the link, aligned with its gravity; without gravity (upright axis) only inertia increases",
        "M + m l^2, gravity_torque + m g l",
        "link_inertia, gravity_error: both change together",
        (
            EffectParameter("mass", "kg", 0.0, 1e3, 0.0, "m"),
            EffectParameter("distance", "m", 0.0, 10.0, 0.0, "l, from the axis"),
        ),
        write_payload,
    ),
    EffectKind(
        "link_inertia",
        ("link",),
        "error of the link's inertia",
        "M + inertia",
        "payload: changes gravity as well",
        (EffectParameter("inertia", "kg m^2", -1e3, 1e3, 0.0, "added to the device value", True),),
        write_link_inertia,
    ),
    EffectKind(
        "gravity_error",
        ("link",),
        "error of the gravity torque, or of the angle at which the link hangs at rest",
        "(gravity_torque + torque) sin(q - gravity_angle - angle)",
        "payload: changes inertia as well",
        (
            EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "added to the device value", True),
            EffectParameter("angle", "rad", -pi, pi, 0.0, "added to the device value"),
        ),
        write_gravity,
    ),
    EffectKind(
        "contact",
        ("environment",),
        "a wall on one side of the link: a spring and a damper that never pull",
        "-side max(stiffness depth + damping d(depth)/dt, 0), depth = side (q - angle) > 0",
        "spring_law: starts at one link angle",
        (
            EffectParameter("angle", "rad", -10.0, 10.0, 0.0, "of the wall"),
            EffectParameter("stiffness", "N m/rad", 0.0, 1e6, 0.0, "of the wall", True),
            EffectParameter("damping", "N m s/rad", 0.0, 1e4, 0.0, "of the wall", True),
            EffectParameter("side", "-", -1.0, 1.0, 1.0, "1: wall at larger angles, -1: at smaller ones"),
        ),
        write_contact,
    ),
    EffectKind(
        "external_torque",
        ("environment",),
        "an unrecorded torque on the link, constant from start until stop",
        "torque for start <= t < stop, t since the beginning of the run",
        "gravity_error, torque_bias: depends on time and not on the angle",
        (
            EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "on the link", True),
            EffectParameter("start", "s", 0.0, NEVER, 0.0, "time since the beginning of the run"),
            EffectParameter("stop", "s", 0.0, NEVER, NEVER, "time since the beginning of the run"),
        ),
        write_pulse,
    ),
)

EFFECTS: Mapping[str, EffectKind] = MappingProxyType({kind.name: kind for kind in _KINDS})
DEVICE_NUMBERS = EffectKind(
    "device_numbers",
    ("device",),
    "factors on numbers of the device file, fitted with the effects and written before them",
    "factor times the number",
    "",
    (),
    write_numbers,
    optional=tuple(EffectParameter(name, "-", 0.1, 10.0, 1.0, "factor") for name in NAMES),
)
