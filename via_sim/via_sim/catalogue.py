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
    EffectKind,
    EffectParameter,
    harmonic_suffix,
    into_slot,
    write_asymmetric_coulomb,
    write_asymmetric_viscous,
    write_bias,
    write_contact,
    write_coulomb,
    write_encoder_error,
    write_gain,
    write_gravity,
    write_hysteresis,
    write_link_inertia,
    write_numbers,
    write_payload,
    write_presliding,
    write_pulse,
    write_ripple,
    write_spring_law,
    write_stribeck,
    write_viscous,
)
from via_sim.parameters import ENCODER_HARMONICS, MOTOR_1, RIPPLE_HARMONICS, P
from via_sim.readings import MAX_SKEW

MAX_DELAY = 0.1  # [s]
NEVER = 1e6  # [s] later than any run; also a torque [N m] and a speed [rad/s] beyond all drives

_FRICTION = ("motor", "link")
_TORQUE = EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "breakaway and kinetic friction", True)


def _harmonic(k: int, unit: str, high: float) -> tuple[EffectParameter, EffectParameter, EffectParameter]:
    """Amplitude, order and phase of harmonic k (from 0) of an effect over the angle, amplitudes up to `high`."""
    of = harmonic_suffix(k)
    return (
        EffectParameter(f"amplitude{of}", unit, 0.0, high, 0.0, "largest value", True),
        EffectParameter(f"order{of}", "1/rev", 0.5, 1e3, k + 1.0, "periods per turn, no integer behind a gear"),
        EffectParameter(f"phase{of}", "rad", -2.0 * pi, 2.0 * pi, 0.0, "at angle zero"),
    )


def _more_harmonics(count: int, unit: str, high: float) -> tuple[EffectParameter, ...]:
    """The parameters of all harmonics but the first."""
    return tuple(parameter for k in range(1, count) for parameter in _harmonic(k, unit, high))


_SWING = _harmonic(0, "rad", 0.5)

_KINDS = (
    EffectKind(
        "coulomb_friction",
        _FRICTION,
        "dry friction of constant size; the axis sticks while the torque on it stays below",
        "-torque s",
        "viscous_friction, quadratic_drag: a ladder of speeds",
        (_TORQUE,),
        write_coulomb,
        needs_torque_drive=True,
        adds=True,
    ),
    EffectKind(
        "asymmetric_coulomb",
        _FRICTION,
        "dry friction that differs with the direction of motion",
        "-forward for v > 0, +backward for v < 0",
        "torque_bias: only a hold at standstill; on moving data name both",
        (
            EffectParameter("forward", "N m", 0.0, 1e3, 0.0, "friction while the angle grows", True),
            EffectParameter("backward", "N m", 0.0, 1e3, 0.0, "friction while it falls", True),
        ),
        write_asymmetric_coulomb,
        needs_torque_drive=True,
        adds=True,
    ),
    EffectKind(
        "stribeck_friction",
        _FRICTION,
        "dry friction that falls from breakaway to kinetic as exp(-(v/velocity)^2)",
        "-(kinetic + (breakaway - kinetic) exp(-(v/velocity)^2)) s",
        "coulomb_friction, presliding_friction: slow speeds, stick-slip",
        (
            EffectParameter("breakaway", "N m", 0.0, 1e3, 0.0, "friction at standstill", True),
            EffectParameter("kinetic", "N m", 0.0, 1e3, 0.0, "friction at speed, at most breakaway", True),
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed that leaves 1/e of the difference"),
        ),
        write_stribeck,
        needs_torque_drive=True,
    ),
    EffectKind(
        "viscous_friction",
        _FRICTION,
        "error of the viscous friction: what the device file forgot (or has too much)",
        "-coefficient v",
        "coulomb_friction: a ladder of speeds",
        (EffectParameter("coefficient", "N m s/rad", -1e2, 1e2, 0.0, "added to the device's coefficient", True),),
        write_viscous,
        needs_torque_drive=True,
        adds=True,
    ),
    EffectKind(
        "asymmetric_viscous",
        _FRICTION,
        "viscous friction that differs with the direction of motion",
        "-forward v for v > 0, -backward v for v < 0",
        "torque_bias, quadratic_drag: the slope over |v|",
        (
            EffectParameter("forward", "N m s/rad", -1e2, 1e2, 0.0, "added while the angle grows", True),
            EffectParameter("backward", "N m s/rad", -1e2, 1e2, 0.0, "added while it falls", True),
        ),
        write_asymmetric_viscous,
        needs_torque_drive=True,
    ),
    EffectKind(
        "quadratic_drag",
        _FRICTION,
        "drag that grows with the square of the speed",
        "-coefficient v |v|",
        "viscous_friction: a ladder of speeds",
        (EffectParameter("coefficient", "N m s^2/rad^2", 0.0, 1e2, 0.0, "torque at 1 rad/s", True),),
        into_slot(P.quadratic_drag, "coefficient"),
        needs_torque_drive=True,
    ),
    EffectKind(
        "presliding_friction",
        _FRICTION,
        "Dahl's bristle: friction that builds up over the way since the last reversal, elastic at first",
        "-F, dF/dx = stiffness (1 - F s/torque)",
        "backlash, spring_law: micro-reversals, width of the loop over its amplitude",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "friction once it slides"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1e2, "of the bristle at rest"),
        ),
        write_presliding,
        needs_torque_drive=True,
    ),
    EffectKind(
        "load_dependent_friction",
        _FRICTION,
        "dry friction in proportion to the torque the axis carries: of its transmissions, of a rigid joint its drive's",
        "-coefficient |load| s",
        "coulomb_friction: the same speeds under another load; torque_gain: reversals",
        (EffectParameter("coefficient", "-", 0.0, 1.0, 0.0, "friction per torque", True),),
        into_slot(P.load_friction, "coefficient"),
        needs_torque_drive=True,
    ),
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
        _harmonic(0, "N m", 1e3),
        write_ripple,
        needs_torque_drive=True,
        of_drive=True,
        optional=_more_harmonics(RIPPLE_HARMONICS, "N m", 1e3),
    ),
    EffectKind(
        "torque_saturation",
        ("motor",),
        "a limit of the drive that nobody knows: of its torque; of a servo the speed [rad/s] at which it slews",
        "clip(u, -limit, limit)",
        "torque_gain: only large commands",
        (
            EffectParameter(
                "limit", "N m", 1e-3, NEVER, NEVER, "largest torque; of a servo speed [rad/s]", servo_unit="rad/s"
            ),
        ),
        into_slot(P.saturation, "limit"),
        of_drive=True,
    ),
    EffectKind(
        "actuator_lag",
        ("command",),
        "a lag of first order between command and torque, of all drives; a servo's 2/w grows by it",
        "T dy/dt = u - y",
        "actuator_delay: the answer to a step bends at once",
        (EffectParameter("time_constant", "s", 0.0, 0.5, 0.0, "T"),),
        into_slot(P.lag, "time_constant"),
    ),
    EffectKind(
        "actuator_delay",
        ("command",),
        "dead time between a command and what it does, in any fraction of a tick; all commands of the joint",
        "u(t - delay)",
        "actuator_lag, friction, a filter: linear in frequency, not in 1/v",
        (EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time"),),
        into_slot(P.delay, "delay"),
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
        optional=(_SWING[1], *_more_harmonics(ENCODER_HARMONICS, "rad", 0.5)),
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
