"""Initial parameter values of effects for fits.

A start is one or more directions: parameter sets that can be scaled and added, as far as the effect is linear in them.
Nonlinear parameters (a speed, an order, the place of a wall) have a small grid of starts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

from via_core.devices import Device
from via_core.signals import Array

Values = dict[str, float]


@dataclass(frozen=True)
class Start:
    """directions  sets of all parameters of the effect
    scaled      names whose distance from neutral is proportional to the amount; others keep the first direction's value
    wave        whether the directions are sine and cosine of `phase` with one `amplitude`
    through     names whose value is proportional to the amount, whatever the neutral value
    about       torque [N m] of the device that the first direction (`torque`) increases and the second (`angle`) turns,
                which is linear in its parts along both; 0: no such torque
    """

    directions: tuple[Values, ...]
    scaled: tuple[str, ...]
    wave: bool = False
    through: tuple[str, ...] = ()
    about: float = 0.0


@dataclass(frozen=True, eq=False)
class Typical:
    """Typical sizes in the logs of a device at the location of an effect, to which starts are relative.

    torque, speed  [N m], [rad/s] of the axis
    peak           [N m] or [rad] largest command of the motor
    slew           [rad/s] largest speed of a servo or of the link of a position drive
    angle          [rad] standard deviation of the link angle
    range          (6,) [rad] its least value, its 2, 10, 90 and 98 percent quantiles, and its largest value
    deflection     [rad] standard deviation of the deflection of a spring
    stretch        [rad] its root mean square, which is larger under pretension
    duration       [s]
    busy           intervals [s] in which an effect that begins and ends explains most
    orders         strongest orders [periods per turn] of the missing torque of the axis
    """

    device: Device
    torque: float
    speed: float
    peak: float
    slew: float
    angle: float
    range: Array
    deflection: float
    stretch: float
    duration: float
    busy: tuple[tuple[float, float], ...]
    orders: tuple[float, ...]


@dataclass(frozen=True)
class Starts:
    """Starts of one effect, and the names of its size parameters: at their neutral values it is absent.

    limit      whether the size is a limit: absent if it is beyond all torques or speeds
    of_peak    whether sizes are typically the largest command
    """

    sizes: tuple[str, ...]
    made: Callable[[Typical], list[Start]]
    limit: bool = False
    of_peak: bool = False


def one(**values: Callable[[Typical], float]) -> Starts:
    """One direction, of these size parameters together."""
    return grid(*values, at=lambda here: [{name: value(here) for name, value in values.items()}])


def each(**values: Callable[[Typical], float]) -> Starts:
    """A direction for each of these size parameters."""
    names = tuple(values)
    return Starts(names, lambda here: [Start(tuple({name: value(here)} for name, value in values.items()), names)])


def grid(*sizes: str, at: Callable[[Typical], list[Values]], through: tuple[str, ...] = ()) -> Starts:
    """Starts with one direction each, proportional to the size parameters `sizes`."""
    return Starts(sizes, lambda here: [Start((values,), sizes, through=through) for values in at(here)])


def limits(at: Callable[[Typical], list[float]], of_peak: bool = False) -> Starts:
    """Limits on which nothing depends linearly."""
    return Starts(("limit",), lambda here: [Start(({"limit": x},), ()) for x in at(here)], limit=True, of_peak=of_peak)


def thresholds(size: str, largest: Callable[[Typical], float]) -> Starts:
    """Thresholds below which a drive does nothing, as shares of its largest input."""
    shares = (0.02, 0.05, 0.1, 0.2, 0.4)
    return Starts((size,), lambda here: [Start(({size: share * largest(here)},), ()) for share in shares], of_peak=True)


def waves(at: Callable[[Typical], list[Values]]) -> Starts:
    """Sines and cosines with these amplitudes and orders."""
    both = (0.0, 0.5 * pi)
    return Starts(
        ("amplitude",),
        lambda here: [Start(tuple({**wave, "phase": phase} for phase in both), (), True) for wave in at(here)],
    )


def sliding(ways: Callable[[Typical], list[float]]) -> Starts:
    """An element that slips after `ways` [rad]; torque and stiffness are scaled together, so that way is constant."""

    def values(here: Typical) -> list[Values]:
        return [{"torque": 0.1 * here.torque, "stiffness": 0.1 * here.torque / way} for way in ways(here)]

    return grid("torque", at=values, through=("stiffness",))


def tenth(here: Typical) -> float:
    """A tenth of the typical torque [N m]."""
    return 0.1 * here.torque


def tenth_viscous(here: Typical) -> float:
    """Viscous friction [N m s/rad] with a tenth of the typical torque at the typical speed."""
    return 0.1 * here.torque / here.speed
