"""Definition of an effect: parameters with units and bounds, sites, slots of the parameter row, starts, words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Protocol

from via_sim.catalogue.starts import Starts
from via_sim.catalogue.terms import Term

Values = Mapping[str, float]
NEVER = 1e6  # [s] later than any run; also larger than any drive torque [N m] and speed [rad/s]


@dataclass(frozen=True)
class Slot:
    """`size` neighbouring entries of the parameter row with default value `neutral`."""

    name: str
    unit: str
    text: str
    size: int = 1
    neutral: float = 0.0


class Spot(Protocol):
    """The parameter row at the location of an effect: `spot["lag"]`, `spot["ripple_order", k]` of harmonic k."""

    site: str

    def __getitem__(self, slot: str | tuple[str, int]) -> float: ...

    def __setitem__(self, slot: str | tuple[str, int], value: float) -> None: ...


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect: range [low, high], and the neutral value at which the effect is absent.

    linear      whether the torques of the equations are linear in it for fixed other parameters
    servo_unit  unit on devices with servos, where it is a different quantity
    slot        slot of the row that holds the value; empty if the effect's `write` stores it
    adds        whether the value is added to the slot instead
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    text: str
    linear: bool = False
    servo_unit: str = ""
    slot: str | tuple[str, int] = ""
    adds: bool = False

    def unit_on(self, drive: str) -> str:
        """Unit on a device with this drive."""
        return self.servo_unit if drive == "servo" and self.servo_unit else self.unit


@dataclass(frozen=True)
class Form:
    """A function of the parameters `names`, with its gradient, that data may determine better than each parameter."""

    expression: str
    unit: str
    names: tuple[str, ...]
    value: Callable[..., float]
    gradient: Callable[..., Sequence[float]]


@dataclass(frozen=True)
class EffectKind:
    """Definition of an effect; `parameters` are required, `optional` ones default to neutral.

    term           definition as a formula (s: sign of the speed v, phi: a deflection)
    confused_with  similar effects and what distinguishes them
    slots          slots of the row that only this effect uses
    terms          compiled parts of the equations of motion that the kernels are composed from
    write          checks the values and writes those that have no slot of their own
    starts         initial values of fits; None: a tenth of the typical sizes
    further        sets of optional parameters with which a good fit is repeated, and their initial values: of the
                   fitted values, and of typical speed [rad/s] and torque [N m] of the axis
    forms          combinations of parameters that a report states
    """

    name: str
    text: str
    term: str
    confused_with: str
    sites: tuple[str, ...]
    parameters: tuple[EffectParameter, ...]
    optional: tuple[EffectParameter, ...] = ()
    slots: tuple[Slot, ...] = ()
    terms: tuple[Term, ...] = ()
    write: Callable[[Spot, Values], None] | None = None
    starts: Starts | None = None
    further: Callable[[Values, float, float], Sequence[Values]] | None = None
    forms: tuple[Form, ...] = ()
    contains: tuple[str, tuple[int, ...]] | None = None  # simpler effect; parameters whose mean is its initial value
    channel: str = ""  # command channel without which the effect cannot be evaluated
    needs_torque_drive: bool = False  # at a motor: not on devices with servos, which impose the angle
    of_goal: bool = False  # acts on the goal of a position drive
    of_drive: bool = False  # at a motor: acts on the drive, which a rigid joint has as well (motor 1)
    of_torque: bool = False  # acts on a commanded torque: not on devices with servos or a position drive
    of_preset: bool = False  # in a serial joint it needs a spring with a preset
    adds: bool = False  # several at one location add up
    dry: bool = False  # dry friction, of which a fit allows no more than the missing torque
    lever: bool = False  # its first parameters are a mass and its distance from the axis; m l and m l^2 act
    whole_period: bool = False  # periodic, with at least one period within the travel of its axis
    measured: bool = False  # found in the measurements alone, because it does not change the motion
    touched: bool = False  # a wall: its sizes are those of a knock, its place matters to a depth of that
    one_run: bool = False  # acts at one time of one run, so it cannot be the common cause in several logs

    @property
    def all_parameters(self) -> tuple[EffectParameter, ...]:
        """Required parameters, then optional ones."""
        return (*self.parameters, *self.optional)

    def write_at(self, spot: Spot, values: Values) -> None:
        """Write parameter values into the row at a location, in place; optional ones may be missing."""
        if self.write is not None:
            self.write(spot, values)
        for parameter in self.all_parameters:
            if parameter.slot:
                value = values.get(parameter.name, parameter.neutral)
                spot[parameter.slot] = spot[parameter.slot] + value if parameter.adds else value


def harmonics(count: int, unit: str, high: float, slots: Sequence[str]) -> tuple[EffectParameter, ...]:
    """Amplitude (up to `high`), order and phase of each harmonic of a periodic effect, stored in three `slots`."""
    amplitude, order, phase = slots
    return tuple(
        parameter
        for k, of in enumerate(("", *(f"_{k}" for k in range(2, count + 1))))
        for parameter in (
            EffectParameter(f"amplitude{of}", unit, 0.0, high, 0.0, "amplitude", True, slot=(amplitude, k)),
            EffectParameter(
                f"order{of}", "1/rev", 0.5, 1e3, k + 1.0, "periods per turn; not an integer behind a gear",
                slot=(order, k),
            ),
            EffectParameter(f"phase{of}", "rad", -2.0 * pi, 2.0 * pi, 0.0, "at angle zero", slot=(phase, k)),
        )
    )  # fmt: skip
