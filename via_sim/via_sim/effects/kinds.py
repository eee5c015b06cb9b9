"""Kinds of effects: parameters, sites, and writers of parameter values into a parameter row.

A writer puts the values of one effect into a row in place; optional values may be missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import pi

from via_core.errors import ParameterError
from via_core.signals import Array

from via_sim.effects.device_numbers import numbers_of
from via_sim.joint.parameters import ENCODER_HARMONICS, LINK, MOTOR_1, RIPPLE_HARMONICS, P

Values = Mapping[str, float]
Writer = Callable[[Array, int, str, Values], None]

MAX_DELAY = 0.1  # [s]
NEVER = 1e6  # [s] later than any run; also larger than any drive torque [N m] and speed [rad/s]


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect: range [low, high], and the neutral value at which the effect is absent.

    linear      whether the torques of the equations are linear in it for fixed other parameters
    servo_unit  unit on devices with servos, where it is a different quantity
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
        """Unit on a device with this drive."""
        return self.servo_unit if drive == "servo" and self.servo_unit else self.unit


@dataclass(frozen=True)
class EffectKind:
    """Definition of an effect. `write` puts parameter values at an axis (0 link, 1, 2 motors) into a row in place.

    `parameters` are required, `optional` ones default to neutral.
    """

    name: str
    sites: tuple[str, ...]
    text: str
    term: str
    confused_with: str
    parameters: tuple[EffectParameter, ...]
    write: Writer
    needs_torque_drive: bool = False  # at a motor: not on devices with servos, which impose the angle
    of_goal: bool = False  # acts on the goal of a position drive
    of_drive: bool = False  # at a motor: acts on the drive, which a rigid joint has as well (motor 1)
    adds: bool = False  # several at one location add up
    optional: tuple[EffectParameter, ...] = ()

    @property
    def all_parameters(self) -> tuple[EffectParameter, ...]:
        """Required parameters, then optional ones."""
        return (*self.parameters, *self.optional)


def _suffix(k: int) -> str:
    """Suffix of the names of harmonic k (from 0): '', '_2', '_3'."""
    return f"_{k + 1}" if k else ""


def harmonic(k: int, unit: str, high: float) -> tuple[EffectParameter, EffectParameter, EffectParameter]:
    """Amplitude (up to `high`), order and phase of harmonic k (from 0) of a periodic effect."""
    of = _suffix(k)
    return (
        EffectParameter(f"amplitude{of}", unit, 0.0, high, 0.0, "amplitude", True),
        EffectParameter(f"order{of}", "1/rev", 0.5, 1e3, k + 1.0, "periods per turn; not an integer behind a gear"),
        EffectParameter(f"phase{of}", "rad", -2.0 * pi, 2.0 * pi, 0.0, "at angle zero"),
    )


def more_harmonics(count: int, unit: str, high: float) -> tuple[EffectParameter, ...]:
    """Parameters of all harmonics except the first."""
    return tuple(parameter for k in range(1, count) for parameter in harmonic(k, unit, high))


def write_coulomb(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.breakaway_friction + axis] += value["torque"]
    row[P.kinetic_friction + axis] += value["torque"]


def write_numbers(row: Array, _axis: int, _site: str, value: Values) -> None:
    slots = {number.name: number.slots for number in numbers_of(row)}
    for name, factor in value.items():
        if name not in slots:
            raise ParameterError(f"'{name}' is not a number of this joint; choose from {', '.join(slots)}")
        row[list(slots[name])] *= factor


def write_asymmetric_coulomb(row: Array, axis: int, _site: str, value: Values) -> None:
    mean, half = 0.5 * (value["forward"] + value["backward"]), 0.5 * (value["forward"] - value["backward"])
    row[P.breakaway_friction + axis] += mean
    row[P.kinetic_friction + axis] += mean
    row[P.friction_asymmetry + axis] += half


def write_stribeck(row: Array, axis: int, _site: str, value: Values) -> None:
    if value["breakaway"] < value["kinetic"]:
        raise ParameterError(f"breakaway {value['breakaway']} N m must be >= kinetic {value['kinetic']} N m")
    row[P.breakaway_friction + axis] += value["breakaway"]
    row[P.kinetic_friction + axis] += value["kinetic"]
    row[P.stribeck_velocity + axis] = value["velocity"]


def write_viscous(row: Array, axis: int, _site: str, value: Values) -> None:
    _more_viscous(row, axis, value["coefficient"], 0.0, f"coefficient {value['coefficient']}")


def write_asymmetric_viscous(row: Array, axis: int, _site: str, value: Values) -> None:
    forward, backward = value["forward"], value["backward"]
    given = f"forward {forward} and backward {backward}"
    _more_viscous(row, axis, 0.5 * (forward + backward), 0.5 * (forward - backward), given)


def _more_viscous(row: Array, axis: int, mean: float, half: float, given: str) -> None:
    total, skewed = row[P.viscous_friction + axis] + mean, row[P.viscous_asymmetry + axis] + half
    if total - abs(skewed) < 0.0:
        raise ParameterError(f"{given} leaves {total - abs(skewed):.6g} N m s/rad of viscous friction, must be >= 0")
    row[P.viscous_friction + axis], row[P.viscous_asymmetry + axis] = total, skewed


def write_presliding(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.bristle_torque + axis], row[P.bristle_stiffness + axis] = value["torque"], value["stiffness"]


def write_hysteresis(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.hysteresis_torque + axis - MOTOR_1] = value["torque"]
    row[P.hysteresis_stiffness + axis - MOTOR_1] = value["stiffness"]


def write_load_friction(row: Array, axis: int, _site: str, value: Values) -> None:
    """Dry friction that depends on load and counter torque, see friction.py."""
    row[P.load_friction + axis] = value["coefficient"]
    for name, slot in (
        ("counter_coefficient", P.counter_friction),
        ("stribeck", P.load_stribeck),
        ("counter_stribeck", P.counter_stribeck),
        ("quadratic", P.load_quadratic),
    ):
        row[slot + axis] = value.get(name, 0.0)
        row[P.both_sides + axis] = float(row[P.both_sides + axis] != 0.0 or row[slot + axis] != 0.0)
    row[P.load_velocity + axis] = value.get("velocity", 1.0)


def write_spring_law(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.spring_scale + axis - MOTOR_1] = value["scale"]
    row[P.spring_hardening + axis - MOTOR_1] = value["hardening"]


def write_gain(row: Array, axis: int, site: str, value: Values) -> None:
    row[(P.sensed_gain if site == "sensor" else P.torque_gain) + axis] = value["gain"]


def write_bias(row: Array, axis: int, site: str, value: Values) -> None:
    row[(P.sensed_bias if site == "sensor" else P.torque_bias) + axis] = value["torque"]


def _harmonics(value: Values, count: int) -> Iterator[tuple[int, float, float, float]]:
    """(k, amplitude, order, phase) of `count` harmonics; the default orders are 1, 2, 3."""
    for k in range(count):
        of = _suffix(k)
        yield k, value.get(f"amplitude{of}", 0.0), value.get(f"order{of}", k + 1.0), value.get(f"phase{of}", 0.0)


def write_ripple(row: Array, axis: int, _site: str, value: Values) -> None:
    """Harmonics of a torque ripple."""
    for k, amplitude, order, phase in _harmonics(value, RIPPLE_HARMONICS):
        here = 3 * k + axis
        row[P.ripple_amplitude + here], row[P.ripple_order + here] = amplitude, order
        row[P.ripple_phase + here] = phase


def write_encoder_error(row: Array, axis: int, _site: str, value: Values) -> None:
    """Harmonics of an encoder error; refused where the measured angle would not increase with the angle."""
    steepest, last = 0.0, 0
    for k, amplitude, order, phase in _harmonics(value, ENCODER_HARMONICS):
        here = 3 * k + axis
        row[P.eccentricity + here], row[P.eccentricity_order + here] = amplitude, order
        row[P.eccentricity_phase + here] = phase
        steepest, last = steepest + abs(amplitude * order), k + 1 if amplitude != 0.0 else last
    row[P.encoder_harmonics + axis] = last
    if steepest >= 1.0:
        raise ParameterError(
            f"amplitude times order adds up to {steepest:.6g}, must be < 1: the measured angle would decrease"
        )


def write_payload(row: Array, _axis: int, _site: str, value: Values) -> None:
    row[P.inertia + LINK] += value["mass"] * value["distance"] ** 2
    row[P.gravity_torque] += value["mass"] * row[P.gravity] * value["distance"]


def write_link_inertia(row: Array, _axis: int, _site: str, value: Values) -> None:
    total = row[P.inertia + LINK] + value["inertia"]
    if total <= 0.0:
        raise ParameterError(f"inertia {value['inertia']} leaves {total:.6g} kg m^2, must be > 0")
    row[P.inertia + LINK] = total


def write_gravity(row: Array, _axis: int, _site: str, value: Values) -> None:
    row[P.gravity_torque] += value["torque"]
    row[P.gravity_angle] += value["angle"]


def write_contact(row: Array, _axis: int, _site: str, value: Values) -> None:
    if abs(value["side"]) != 1.0:
        raise ParameterError(f"side must be -1 or 1, got {value['side']}")
    row[P.contact_angle], row[P.contact_side] = value["angle"], value["side"]
    row[P.contact_stiffness], row[P.contact_damping] = value["stiffness"], value["damping"]


def write_pulse(row: Array, _axis: int, _site: str, value: Values) -> None:
    if value["stop"] < value["start"]:
        raise ParameterError(f"stop {value['stop']} s must not be before start {value['start']} s")
    row[P.pulse_torque], row[P.pulse_start], row[P.pulse_stop] = value["torque"], value["start"], value["stop"]


def write_dead_time(row: Array, _axis: int, _site: str, value: Values) -> None:
    """Delay in addition to that of a position drive."""
    total = row[P.delay] + value["delay"]
    if total > MAX_DELAY:
        raise ParameterError(f"delay {value['delay']} plus that of the drive is {total:.6g} s, must be <= {MAX_DELAY}")
    row[P.delay] = total


def write_goal_speed(row: Array, _axis: int, _site: str, value: Values) -> None:
    """Speed limit of the goal; the lower one of this and the limit in the device file acts."""
    if value["limit"] < NEVER:
        row[P.drive_speed_limit] = min(row[P.drive_speed_limit], value["limit"])


def into_slot(slot: int, name: str, first: int = 0) -> Callable[[Array, int, str, Values], None]:
    """Writer of one value into one slot per axis; `first` is the axis of the first slot."""

    def write(row: Array, axis: int, _site: str, value: Values) -> None:
        row[slot + axis - first] = value[name]

    return write
