"""Definition of a kind of effect: parameters with units and bounds, sites, and how values enter a parameter row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi

from via_core.signals import Array

from via_sim.joint.parameters import MOTOR_1, PER_MOTOR

Values = Mapping[str, float]
Writer = Callable[[Array, int, str, Values], None]

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
    """Definition of an effect; `parameters` are required, `optional` ones default to neutral.

    slots     the slot of each value in the parameter row, in the order of all parameters: the first one per axis
    added_to  slots to which the values are added instead
    before    checks the values, and writes those without such a slot; arguments as `write`
    """

    name: str
    text: str
    term: str
    confused_with: str
    parameters: tuple[EffectParameter, ...]
    sites: tuple[str, ...]
    slots: tuple[int, ...] = ()
    added_to: tuple[int, ...] = ()
    before: Writer | None = None
    needs_torque_drive: bool = False  # at a motor: not on devices with servos, which impose the angle
    of_goal: bool = False  # acts on the goal of a position drive
    of_drive: bool = False  # at a motor: acts on the drive, which a rigid joint has as well (motor 1)
    adds: bool = False  # several at one location add up
    optional: tuple[EffectParameter, ...] = ()

    @property
    def all_parameters(self) -> tuple[EffectParameter, ...]:
        """Required parameters, then optional ones."""
        return (*self.parameters, *self.optional)

    def write(self, row: Array, axis: int, site: str, values: Values) -> None:
        """Write parameter values at an axis (0 link, 1, 2 motors) into a row in place; optional ones may be missing."""
        if self.before is not None:
            self.before(row, axis, site, values)
        given = [values.get(parameter.name, parameter.neutral) for parameter in self.all_parameters]
        for slot, value in zip(self.slots, given):
            row[slot + axis - (MOTOR_1 if slot in PER_MOTOR else 0)] = value
        for slot, value in zip(self.added_to, given):
            row[slot + axis] += value


def harmonics(count: int, unit: str, high: float) -> tuple[EffectParameter, ...]:
    """Amplitude (up to `high`), order and phase of each harmonic of a periodic effect."""
    return tuple(
        parameter
        for k, of in enumerate(("", *(f"_{k}" for k in range(2, count + 1))))
        for parameter in (
            EffectParameter(f"amplitude{of}", unit, 0.0, high, 0.0, "amplitude", True),
            EffectParameter(f"order{of}", "1/rev", 0.5, 1e3, k + 1.0, "periods per turn; not an integer behind a gear"),
            EffectParameter(f"phase{of}", "rad", -2.0 * pi, 2.0 * pi, 0.0, "at angle zero"),
        )
    )
