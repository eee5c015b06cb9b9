"""The catalogue of effects: term, sites, and meaning and bounds of the parameters.

Each effect is defined once. Its kind writes numbers into slots of the parameter row; the torques, drives and
measurements that use these slots serve the simulator and the equations of a log. `term` is the definition as a formula
(s: sign of the speed v, phi: a deflection). `confused_with` names similar effects and what distinguishes them.
"""

from __future__ import annotations

from functools import partial
from math import pi

from via_core.errors import ParameterError
from via_core.signals import Array

from via_sim.effects.device_numbers import NAMES, numbers_of
from via_sim.effects.friction_kinds import FRICTION_KINDS
from via_sim.effects.kinds import NEVER, EffectKind, EffectParameter, Values, harmonics
from via_sim.joint.measurements import MAX_SKEW
from via_sim.joint.parameters import ENCODER_HARMONICS, LINK, RIPPLE_HARMONICS, P

MAX_DELAY = 0.1  # [s]

_transmission = partial(EffectKind, sites=("transmission",))
_motor = partial(EffectKind, sites=("motor",), of_drive=True)
_command = partial(EffectKind, sites=("command",))
_sensor = partial(EffectKind, sites=("sensor",))
_link = partial(EffectKind, sites=("link",))
_environment = partial(EffectKind, sites=("environment",))


def _gain(row: Array, axis: int, site: str, value: Values) -> None:
    row[(P.sensed_gain if site == "sensor" else P.torque_gain) + axis] = value["gain"]


def _bias(row: Array, axis: int, site: str, value: Values) -> None:
    row[(P.sensed_bias if site == "sensor" else P.torque_bias) + axis] = value["torque"]


def _dead_time(row: Array, _axis: int, _site: str, value: Values) -> None:
    total = row[P.delay] + value["delay"]
    if total > MAX_DELAY:
        raise ParameterError(f"delay {value['delay']} plus that of the drive is {total:.6g} s, must be <= {MAX_DELAY}")


def _goal_speed(row: Array, _axis: int, _site: str, value: Values) -> None:
    if value["limit"] < NEVER:
        row[P.drive_speed_limit] = min(row[P.drive_speed_limit], value["limit"])


def _increasing(row: Array, axis: int, _site: str, value: Values) -> None:
    """Refuse encoder errors with which the measured angle would not increase with the angle; count the harmonics."""
    steepest, last = 0.0, 0
    for k, of in enumerate(("", *(f"_{k}" for k in range(2, ENCODER_HARMONICS + 1)))):
        amplitude = value.get(f"amplitude{of}", 0.0)
        steepest += abs(amplitude * value.get(f"order{of}", k + 1.0))
        last = k + 1 if amplitude != 0.0 else last
    row[P.encoder_harmonics + axis] = last
    if steepest >= 1.0:
        raise ParameterError(
            f"amplitude times order adds up to {steepest:.6g}, must be < 1: the measured angle would decrease"
        )


def _payload(row: Array, _axis: int, _site: str, value: Values) -> None:
    row[P.inertia + LINK] += value["mass"] * value["distance"] ** 2
    row[P.gravity_torque] += value["mass"] * row[P.gravity] * value["distance"]


def _positive_inertia(row: Array, _axis: int, _site: str, value: Values) -> None:
    total = row[P.inertia + LINK] + value["inertia"]
    if total <= 0.0:
        raise ParameterError(f"inertia {value['inertia']} leaves {total:.6g} kg m^2, must be > 0")


def _one_side(_row: Array, _axis: int, _site: str, value: Values) -> None:
    if abs(value["side"]) != 1.0:
        raise ParameterError(f"side must be -1 or 1, got {value['side']}")


def _forward(_row: Array, _axis: int, _site: str, value: Values) -> None:
    if value["stop"] < value["start"]:
        raise ParameterError(f"stop {value['stop']} s must not be before start {value['start']} s")


def _numbers(row: Array, _axis: int, _site: str, value: Values) -> None:
    slots = {number.name: number.slots for number in numbers_of(row)}
    for name, factor in value.items():
        if name not in slots:
            raise ParameterError(f"'{name}' is not a number of this joint; choose from {', '.join(slots)}")
        row[list(slots[name])] *= factor


def _harmonic_slots(count: int, *first: int) -> tuple[int, ...]:
    """Slots of `harmonics`; `first` are those of the first amplitude, order and phase."""
    return tuple(slot + 3 * k for k in range(count) for slot in first)


_RIPPLES = harmonics(RIPPLE_HARMONICS, "N m", 1e3)
_SWING, _ORDER, _PHASE, *_SWINGS = harmonics(ENCODER_HARMONICS, "rad", 0.5)
_SWING_SLOTS = _harmonic_slots(ENCODER_HARMONICS, P.eccentricity, P.eccentricity_order, P.eccentricity_phase)

_KINDS = (
    *FRICTION_KINDS,
    _transmission(
        "backlash",
        "a torque-free gap between motor and spring; `motor` is the number of the transmission",
        "tau_e(0) for |phi| < gap/2, else tau_e(phi -+ gap/2)",
        "presliding_friction, spring_law: a torque-free gap of constant width, impact at its end",
        (EffectParameter("gap", "rad", 0.0, 0.5, 0.0, "full width of the gap"),),
        slots=(P.backlash,),
    ),
    _transmission(
        "hysteresis",
        "a Maxwell element parallel to the spring: elastic until it slips",
        "-F, dF = stiffness dphi within |F| <= torque",
        "spring_law, preset_error: loading against unloading; presliding_friction: acts on both sides",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "torque at which it slips"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1.0, "stiffness until it slips"),
        ),
        slots=(P.hysteresis_torque, P.hysteresis_stiffness),
    ),
    _transmission(
        "spring_damping",
        "damping in the transmission, proportional to the rate of deflection",
        "-coefficient dphi/dt",
        "viscous_friction: acts on both sides",
        (EffectParameter("coefficient", "N m s/rad", 0.0, 1e2, 0.0, "torque per rate of deflection", True),),
        slots=(P.spring_damping,),
    ),
    _transmission(
        "spring_law",
        "error of the spring law: its scale, and hardening (or softening) with the squared deflection",
        "scale (1 + hardening phi^2) tau_e(phi)",
        "hysteresis: loading against unloading",
        (
            EffectParameter("scale", "-", 0.1, 10.0, 1.0, "torque relative to the spring law", True),
            EffectParameter("hardening", "1/rad^2", -1e3, 1e3, 0.0, "relative increase per squared deflection", True),
        ),
        slots=(P.spring_scale, P.spring_hardening),
    ),
    _transmission(
        "stiffness_drift",
        "a spring that stiffens or softens during the run",
        "(1 + rate t) tau_e(phi), t since the beginning of the run",
        "payload, wear: time",
        (EffectParameter("rate", "1/s", -1.0, 1.0, 0.0, "relative increase of the torque per time", True),),
        slots=(P.stiffness_rate,),
    ),
    _transmission(
        "preset_error",
        "offset of the angle that pretensions the spring, of the preset motor in a serial joint, else of its own",
        "tau_e(phi - offset); serial: tau_e(phi, preset + offset)",
        "encoder_offset, spring_law: other presets",
        (EffectParameter("offset", "rad", -1.0, 1.0, 0.0, "added to the angle"),),
        slots=(P.pretension_offset,),
    ),
    EffectKind(
        "joint_coupling",
        "torque from the angle of a neighbour joint (channel `neighbour`): on the link, or between link and motor",
        "stiffness neighbour",
        "external_torque: other motion of the neighbour",
        (EffectParameter("stiffness", "N m/rad", -1e3, 1e3, 0.0, "torque per angle of the neighbour", True),),
        ("transmission", "link"),
        slots=(P.coupling,),
    ),
    EffectKind(
        "torque_gain",
        "the motor torque is gain times the command; at a sensor the measured torque is gain times the torque",
        "gain u",
        "all parameters scaled: one known mass",
        (
            EffectParameter(
                "gain", "-", 0.0, 10.0, 1.0, "torque per commanded torque; measured torque per torque", True
            ),
        ),
        ("motor", "sensor"),
        before=_gain,
        needs_torque_drive=True,
        of_drive=True,
    ),
    EffectKind(
        "torque_bias",
        "a constant torque added to the command; at a sensor added to the measured torque",
        "u + torque",
        "asymmetric_coulomb: a hold at standstill; preset_error: does not depend on stiffness",
        (EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "added torque", True),),
        ("motor", "sensor"),
        before=_bias,
        needs_torque_drive=True,
        of_drive=True,
    ),
    _motor(
        "torque_ripple",
        "cogging: a torque that is periodic in the motor angle, a Fourier series of a few orders",
        "sum_k amplitude_k sin(order_k theta + phase_k)",
        "encoder_eccentricity: order, and sign under reversal",
        _RIPPLES[:3],
        needs_torque_drive=True,
        slots=_harmonic_slots(RIPPLE_HARMONICS, P.ripple_amplitude, P.ripple_order, P.ripple_phase),
        optional=_RIPPLES[3:],
    ),
    _motor(
        "torque_saturation",
        "an unknown limit of the drive torque; of a servo a limit of its speed [rad/s]",
        "clip(u, -limit, limit)",
        "torque_gain: only large commands",
        (
            EffectParameter(
                "limit", "N m", 1e-3, NEVER, NEVER, "largest torque; of a servo largest speed", servo_unit="rad/s"
            ),
        ),
        slots=(P.saturation,),
    ),
    _command(
        "actuator_lag",
        "a first-order lag between command and torque of all drives; of a servo added to 2/w; of a position drive "
        "it acts on the goal",
        "T dy/dt = u - y",
        "actuator_delay: the step response starts immediately",
        (EffectParameter("time_constant", "s", 0.0, 0.5, 0.0, "T"),),
        slots=(P.lag,),
    ),
    _command(
        "actuator_delay",
        "dead time of all commands, in any fraction of a tick, in addition to that of a position drive",
        "u(t - delay)",
        "actuator_lag, friction, a filter: linear in frequency, not in 1/v",
        (EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time"),),
        added_to=(P.delay,),
        before=_dead_time,
    ),
    _command(
        "speed_limit",
        "largest speed at which the goal of a position drive follows the commanded angle; of this and the limit in the "
        "device file the lower one acts",
        "|dg/dt| <= limit, g the acting goal",
        "torque_saturation, actuator_lag: the same steps against another load, and smaller steps",
        (EffectParameter("limit", "rad/s", 1e-3, NEVER, NEVER, "largest speed of the goal"),),
        before=_goal_speed,
        of_goal=True,
    ),
    _sensor(
        "encoder_offset",
        "an offset of an encoder; `motor` 0 is the link encoder",
        "measures angle + offset",
        "preset_error, gravity_error: the other equations that use the angle",
        (EffectParameter("offset", "rad", -pi, pi, 0.0, "added to the angle"),),
        slots=(P.encoder_offset,),
    ),
    _sensor(
        "encoder_eccentricity",
        "periodic error of an encoder, of order 1 if mounted off its axis; `motor` 0 is the link encoder",
        "measures angle + sum_k amplitude_k sin(order_k angle + phase_k)",
        "torque_ripple: affects every equation that contains the angle",
        (_SWING, _PHASE),
        slots=(_SWING_SLOTS[0], _SWING_SLOTS[2], _SWING_SLOTS[1], *_SWING_SLOTS[3:]),
        before=_increasing,
        optional=(_ORDER, *_SWINGS),
    ),
    _sensor(
        "encoder_quantisation",
        "an encoder with a coarser resolution than in the device file; `motor` 0 is the link encoder",
        "measures quantum round(angle/quantum)",
        "noise: measurements are on a grid",
        (EffectParameter("quantum", "rad", 0.0, 0.5, 0.0, "resolution; no effect if finer than in the device file"),),
        slots=(P.encoder_quantum,),
    ),
    EffectKind(
        "channel_skew",
        "one angle is stamped later than the other channels; `motor` 0 is the link",
        "measures angle(t - delay)",
        "actuator_delay, viscous_friction: other equations with that angle; response of the drive",
        (EffectParameter("delay", "s", 0.0, MAX_SKEW, 0.0, "delay of the stamp"),),
        ("timing",),
        slots=(P.skew,),
    ),
    _link(
        "payload",
        "a mass on the link, aligned with its gravity; without gravity (upright axis) only inertia increases",
        "M + m l^2, gravity_torque + m g l",
        "link_inertia, gravity_error: both change together",
        (
            EffectParameter("mass", "kg", 0.0, 1e3, 0.0, "m"),
            EffectParameter("distance", "m", 0.0, 10.0, 0.0, "l, from the axis"),
        ),
        before=_payload,
    ),
    _link(
        "link_inertia",
        "error of the link's inertia",
        "M + inertia",
        "payload: changes gravity as well",
        (EffectParameter("inertia", "kg m^2", -1e3, 1e3, 0.0, "added to the device value", True),),
        added_to=(P.inertia,),
        before=_positive_inertia,
    ),
    _link(
        "gravity_error",
        "error of the gravity torque, or of the angle at which the link hangs at rest",
        "(gravity_torque + torque) sin(q - gravity_angle - angle)",
        "payload: changes inertia as well",
        (
            EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "added to the device value", True),
            EffectParameter("angle", "rad", -pi, pi, 0.0, "added to the device value"),
        ),
        added_to=(P.gravity_torque, P.gravity_angle),
    ),
    _environment(
        "contact",
        "a wall on one side of the link: a spring and a damper that never pull",
        "-side max(stiffness depth + damping d(depth)/dt, 0), depth = side (q - angle) > 0",
        "spring_law: starts at one link angle",
        (
            EffectParameter("angle", "rad", -10.0, 10.0, 0.0, "of the wall"),
            EffectParameter("stiffness", "N m/rad", 0.0, 1e6, 0.0, "of the wall", True),
            EffectParameter("damping", "N m s/rad", 0.0, 1e4, 0.0, "of the wall", True),
            EffectParameter("side", "-", -1.0, 1.0, 1.0, "1: wall at larger angles, -1: at smaller ones"),
        ),
        slots=(P.contact_angle, P.contact_stiffness, P.contact_damping, P.contact_side),
        before=_one_side,
    ),
    _environment(
        "external_torque",
        "an unrecorded torque on the link, constant from start until stop",
        "torque for start <= t < stop, t since the beginning of the run",
        "gravity_error, torque_bias: depends on time and not on the angle",
        (
            EffectParameter("torque", "N m", -1e3, 1e3, 0.0, "on the link", True),
            EffectParameter("start", "s", 0.0, NEVER, 0.0, "time since the beginning of the run"),
            EffectParameter("stop", "s", 0.0, NEVER, NEVER, "time since the beginning of the run"),
        ),
        slots=(P.pulse_torque, P.pulse_start, P.pulse_stop),
        before=_forward,
    ),
)

# A package of its own may add a kind: EFFECTS[kind.name] = kind. Simulator, effects files and diagnosis then use it.
EFFECTS: dict[str, EffectKind] = {kind.name: kind for kind in _KINDS}
DEVICE_NUMBERS = EffectKind(
    "device_numbers",
    "factors on numbers of the device file, fitted with the effects and written before them",
    "factor times the number",
    "",
    (),
    ("device",),
    before=_numbers,
    optional=tuple(EffectParameter(name, "-", 0.1, 10.0, 1.0, "factor") for name in NAMES),
)
