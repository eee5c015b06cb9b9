"""The catalogue of effects: what each adds to a joint, where it may sit, what its numbers mean and how far they go.

An effect is defined once: its kind writes numbers into slots of the parameter row, and the torques, drives and readings
that use those slots serve both the simulator and the equations of a log. `term` is that definition on paper (s = sign
of the speed v, phi a deflection), `confused_with` its nearest neighbour in the residual and what tells the two apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from types import MappingProxyType

from via_core.errors import ParameterError
from via_core.signals import Array

from via_sim.device_numbers import NAMES, numbers_of
from via_sim.parameters import LINK, MOTOR_1, P
from via_sim.readings import MAX_SKEW

MAX_DELAY = 0.1  # [s]
NEVER = 1e6  # [s] later than any run; also a torque [N m] and a speed [rad/s] beyond all drives

Values = Mapping[str, float]


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect: allowed range [low, high], and the neutral value at which the effect is absent.

    linear  the torques of the equations are linear in it, the other parameters held: a fit need not search for it
    servo_unit  where the device's motors are servos and it means another quantity there
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    text: str
    linear: bool = False
    servo_unit: str = ""

    def unit_on(self, drive: str) -> str:
        """Its unit on a device with this drive, `torque` or `servo`."""
        return self.servo_unit if drive == "servo" and self.servo_unit else self.unit


@dataclass(frozen=True)
class EffectKind:
    """What an effect is. `write` puts parameter values at an axis (0 link, 1, 2 motors) into a row in place."""

    name: str
    sites: tuple[str, ...]
    text: str
    term: str
    confused_with: str
    parameters: tuple[EffectParameter, ...]
    write: Callable[[Array, int, str, Values], None]
    needs_torque_drive: bool = False  # at a motor: means nothing where a servo imposes the angle
    of_drive: bool = False  # at a motor: of the path of the torque, which a rigid joint has too (its motor 1)
    adds: bool = False  # several at one place add up
    partial: bool = False  # parameters that are left out are neutral


def _coulomb(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.breakaway_friction + axis] += value["torque"]
    row[P.kinetic_friction + axis] += value["torque"]


def _numbers(row: Array, _axis: int, _site: str, value: Values) -> None:
    slots = {number.name: number.slots for number in numbers_of(row)}
    for name, factor in value.items():
        if name not in slots:
            raise ParameterError(f"'{name}' is no number of this joint; it has {', '.join(slots)}")
        row[list(slots[name])] *= factor


def _asymmetric_coulomb(row: Array, axis: int, _site: str, value: Values) -> None:
    mean, half = 0.5 * (value["forward"] + value["backward"]), 0.5 * (value["forward"] - value["backward"])
    row[P.breakaway_friction + axis] += mean
    row[P.kinetic_friction + axis] += mean
    row[P.friction_asymmetry + axis] += half


def _stribeck(row: Array, axis: int, _site: str, value: Values) -> None:
    if value["breakaway"] < value["kinetic"]:
        raise ParameterError(f"breakaway {value['breakaway']} N m must be >= kinetic {value['kinetic']} N m")
    row[P.breakaway_friction + axis] += value["breakaway"]
    row[P.kinetic_friction + axis] += value["kinetic"]
    row[P.stribeck_velocity + axis] = value["velocity"]


def _viscous(row: Array, axis: int, _site: str, value: Values) -> None:
    _more_viscous(row, axis, value["coefficient"], 0.0, f"coefficient {value['coefficient']}")


def _asymmetric_viscous(row: Array, axis: int, _site: str, value: Values) -> None:
    forward, backward = value["forward"], value["backward"]
    told = f"forward {forward} and backward {backward}"
    _more_viscous(row, axis, 0.5 * (forward + backward), 0.5 * (forward - backward), told)


def _more_viscous(row: Array, axis: int, mean: float, half: float, told: str) -> None:
    total, skewed = row[P.viscous_friction + axis] + mean, row[P.viscous_asymmetry + axis] + half
    if total - abs(skewed) < 0.0:
        raise ParameterError(f"{told} leaves {total - abs(skewed):.6g} N m s/rad of viscous friction, must stay >= 0")
    row[P.viscous_friction + axis], row[P.viscous_asymmetry + axis] = total, skewed


def _presliding(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.bristle_torque + axis], row[P.bristle_stiffness + axis] = value["torque"], value["stiffness"]


def _hysteresis(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.hysteresis_torque + axis - MOTOR_1] = value["torque"]
    row[P.hysteresis_stiffness + axis - MOTOR_1] = value["stiffness"]


def _spring_law(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.spring_scale + axis - MOTOR_1] = value["scale"]
    row[P.spring_hardening + axis - MOTOR_1] = value["hardening"]


def _gain(row: Array, axis: int, site: str, value: Values) -> None:
    row[(P.sensed_gain if site == "sensor" else P.torque_gain) + axis] = value["gain"]


def _bias(row: Array, axis: int, site: str, value: Values) -> None:
    row[(P.sensed_bias if site == "sensor" else P.torque_bias) + axis] = value["torque"]


def _ripple(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.ripple_amplitude + axis], row[P.ripple_order + axis] = value["amplitude"], value["order"]
    row[P.ripple_phase + axis] = value["phase"]


def _eccentricity(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.eccentricity + axis], row[P.eccentricity_phase + axis] = value["amplitude"], value["phase"]


def _payload(row: Array, _axis: int, _site: str, value: Values) -> None:
    row[P.inertia + LINK] += value["mass"] * value["distance"] ** 2
    row[P.gravity_torque] += value["mass"] * row[P.gravity] * value["distance"]


def _link_inertia(row: Array, _axis: int, _site: str, value: Values) -> None:
    total = row[P.inertia + LINK] + value["inertia"]
    if total <= 0.0:
        raise ParameterError(f"inertia {value['inertia']} leaves {total:.6g} kg m^2, must stay > 0")
    row[P.inertia + LINK] = total


def _gravity(row: Array, _axis: int, _site: str, value: Values) -> None:
    row[P.gravity_torque] += value["torque"]
    row[P.gravity_angle] += value["angle"]


def _contact(row: Array, _axis: int, _site: str, value: Values) -> None:
    if abs(value["side"]) != 1.0:
        raise ParameterError(f"side must be -1 or 1, got {value['side']}")
    row[P.contact_angle], row[P.contact_side] = value["angle"], value["side"]
    row[P.contact_stiffness], row[P.contact_damping] = value["stiffness"], value["damping"]


def _pulse(row: Array, _axis: int, _site: str, value: Values) -> None:
    if value["stop"] < value["start"]:
        raise ParameterError(f"stop {value['stop']} s must not be before start {value['start']} s")
    row[P.pulse_torque], row[P.pulse_start], row[P.pulse_stop] = value["torque"], value["start"], value["stop"]


def _dead_time(row: Array, _axis: int, _site: str, value: Values) -> None:
    total = row[P.delay] + value["delay"]
    if total > MAX_DELAY:
        raise ParameterError(f"delay {value['delay']} and the drive's own are {total:.6g} s, must stay <= {MAX_DELAY}")
    row[P.delay] = total


def _into(slot: int, name: str, first: int = 0) -> Callable[[Array, int, str, Values], None]:
    """A writer of one number into one slot per axis, of which `first` is the first that has one."""

    def write(row: Array, axis: int, _site: str, value: Values) -> None:
        row[slot + axis - first] = value[name]

    return write


_FRICTION = ("motor", "link")
_TORQUE = EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "breakaway and kinetic friction", True)
_PHASE = EffectParameter("phase", "rad", -2.0 * pi, 2.0 * pi, 0.0, "at angle zero")

_KINDS = (
    EffectKind(
        "coulomb_friction",
        _FRICTION,
        "dry friction of constant size; the axis sticks while the torque on it stays below",
        "-torque s",
        "viscous_friction, quadratic_drag: a ladder of speeds",
        (_TORQUE,),
        _coulomb,
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
        _asymmetric_coulomb,
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
        _stribeck,
        needs_torque_drive=True,
    ),
    EffectKind(
        "viscous_friction",
        _FRICTION,
        "error of the viscous friction: what the device file forgot (or has too much)",
        "-coefficient v",
        "coulomb_friction: a ladder of speeds",
        (EffectParameter("coefficient", "N m s/rad", -1e2, 1e2, 0.0, "added to the device's coefficient", True),),
        _viscous,
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
        _asymmetric_viscous,
        needs_torque_drive=True,
    ),
    EffectKind(
        "quadratic_drag",
        _FRICTION,
        "drag that grows with the square of the speed",
        "-coefficient v |v|",
        "viscous_friction: a ladder of speeds",
        (EffectParameter("coefficient", "N m s^2/rad^2", 0.0, 1e2, 0.0, "torque at 1 rad/s", True),),
        _into(P.quadratic_drag, "coefficient"),
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
        _presliding,
        needs_torque_drive=True,
    ),
    EffectKind(
        "load_dependent_friction",
        _FRICTION,
        "dry friction in proportion to the torque the axis carries: of its transmissions, of a rigid joint its drive's",
        "-coefficient |load| s",
        "coulomb_friction: the same speeds under another load; torque_gain: reversals",
        (EffectParameter("coefficient", "-", 0.0, 1.0, 0.0, "friction per torque", True),),
        _into(P.load_friction, "coefficient"),
        needs_torque_drive=True,
    ),
    EffectKind(
        "backlash",
        ("transmission",),
        "a torque-free gap between motor and spring; `motor` is the number of the transmission",
        "tau_e(0) for |phi| < gap/2, else tau_e(phi -+ gap/2)",
        "presliding_friction, spring_law: a torque-free gap of constant width, impact at its end",
        (EffectParameter("gap", "rad", 0.0, 0.5, 0.0, "whole width of the gap"),),
        _into(P.backlash, "gap", MOTOR_1),
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
        _hysteresis,
    ),
    EffectKind(
        "spring_damping",
        ("transmission",),
        "damping inside the transmission, of the speed of deflection",
        "-coefficient dphi/dt",
        "viscous_friction: it acts on both sides",
        (EffectParameter("coefficient", "N m s/rad", 0.0, 1e2, 0.0, "torque per speed of deflection", True),),
        _into(P.spring_damping, "coefficient", MOTOR_1),
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
        _spring_law,
    ),
    EffectKind(
        "stiffness_drift",
        ("transmission",),
        "a spring that stiffens or softens while the run goes on",
        "(1 + rate t) tau_e(phi), t since the run began",
        "payload, wear: time",
        (EffectParameter("rate", "1/s", -1.0, 1.0, 0.0, "share of the torque added per time", True),),
        _into(P.stiffness_rate, "rate", MOTOR_1),
    ),
    EffectKind(
        "preset_error",
        ("transmission",),
        "the angle that pretensions the spring is off: of a serial joint the preset motor's, else its own motor's",
        "tau_e(phi - offset); serial: tau_e(phi, preset + offset)",
        "encoder_offset, spring_law: other presets",
        (EffectParameter("offset", "rad", -1.0, 1.0, 0.0, "added to the angle the spring sees"),),
        _into(P.pretension_offset, "offset", MOTOR_1),
    ),
    EffectKind(
        "joint_coupling",
        ("transmission", "link"),
        "torque from the angle of a neighbour joint (channel `neighbour`): on the link, or between link and motor",
        "stiffness neighbour",
        "external_torque: other motion of the neighbour",
        (EffectParameter("stiffness", "N m/rad", -1e3, 1e3, 0.0, "torque per angle of the neighbour", True),),
        _into(P.coupling, "stiffness"),
    ),
    EffectKind(
        "torque_gain",
        ("motor", "sensor"),
        "the motor gives gain times the torque commanded, unknown to the torque measurement; or that reads gain times",
        "gain u",
        "everything scaled: one known mass",
        (EffectParameter("gain", "-", 0.0, 10.0, 1.0, "torque per torque commanded; reading per torque", True),),
        _gain,
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
        _bias,
        needs_torque_drive=True,
        of_drive=True,
    ),
    EffectKind(
        "torque_ripple",
        ("motor",),
        "cogging: a torque over the angle of the motor",
        "amplitude sin(order theta + phase)",
        "encoder_eccentricity: its order, and its sign under reversal",
        (
            EffectParameter("amplitude", "N m", 0.0, 1e3, 0.0, "largest torque", True),
            EffectParameter("order", "1/rev", 0.5, 1e3, 1.0, "periods per turn"),
            _PHASE,
        ),
        _ripple,
        needs_torque_drive=True,
        of_drive=True,
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
        _into(P.saturation, "limit"),
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
        _into(P.lag, "time_constant"),
    ),
    EffectKind(
        "actuator_delay",
        ("command",),
        "dead time between a command and what it does, in any fraction of a tick; all commands of the joint; beside "
        "that of a position drive",
        "u(t - delay)",
        "actuator_lag, friction, a filter: linear in frequency, not in 1/v",
        (EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time"),),
        _dead_time,
    ),
    EffectKind(
        "encoder_offset",
        ("sensor",),
        "an encoder whose zero is off; `motor` 0 is the link's",
        "reads angle + offset",
        "preset_error, gravity_error: the other equations that use the angle",
        (EffectParameter("offset", "rad", -pi, pi, 0.0, "read too much"),),
        _into(P.encoder_offset, "offset"),
    ),
    EffectKind(
        "encoder_eccentricity",
        ("sensor",),
        "an encoder off its axis: an error once per turn; `motor` 0 is the link's",
        "reads angle + amplitude sin(angle + phase)",
        "torque_ripple: it bends every equation that uses the angle",
        (EffectParameter("amplitude", "rad", 0.0, 0.5, 0.0, "largest error"), _PHASE),
        _eccentricity,
    ),
    EffectKind(
        "encoder_quantisation",
        ("sensor",),
        "an encoder with coarser steps than its file says; `motor` 0 is the link's",
        "reads quantum round(angle/quantum)",
        "noise: the readings stand on a grid",
        (EffectParameter("quantum", "rad", 0.0, 0.5, 0.0, "least step; finer than the file's has no effect"),),
        _into(P.encoder_quantum, "quantum"),
    ),
    EffectKind(
        "channel_skew",
        ("timing",),
        "one angle is stamped later than the other channels; `motor` 0 is the link's",
        "reads angle(t - delay)",
        "actuator_delay, viscous_friction: other equations that use the angle; which reading its drive answered to",
        (EffectParameter("delay", "s", 0.0, MAX_SKEW, 0.0, "by which it is late"),),
        _into(P.skew, "delay"),
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
        _payload,
    ),
    EffectKind(
        "link_inertia",
        ("link",),
        "error of the link's inertia",
        "M + inertia",
        "payload: no gravity comes with it",
        (EffectParameter("inertia", "kg m^2", -1e3, 1e3, 0.0, "added to the device's", True),),
        _link_inertia,
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
        _gravity,
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
        _contact,
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
        _pulse,
    ),
)

EFFECTS: Mapping[str, EffectKind] = MappingProxyType({kind.name: kind for kind in _KINDS})
DEVICE_NUMBERS = EffectKind(
    "device_numbers",
    ("device",),
    "not an effect but what it was fitted with: factors on numbers of the device file, written before all effects",
    "factor times the number",
    "",
    tuple(EffectParameter(name, "-", 0.1, 10.0, 1.0, "factor") for name in NAMES),
    _numbers,
    partial=True,
)
