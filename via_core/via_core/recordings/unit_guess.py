"""Units of angles, speeds and currents whose names state none, by what their numbers show.

Of rad and deg, an angle has the unit in which its changes fit its speed, in which it stays within the limits of its
joint, in which it starts again after a whole turn, or in which the steps of its encoder divide a turn. Size alone shows
little: a joint without end stops turns far beyond what one with end stops moves in degrees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from via_core.encoder_steps import step_of
from via_core.recordings.units import COUNTS, factor, is_linear
from via_core.signals import Array

FULL = {"rad": 2.0 * np.pi, "deg": 360.0}  # one turn
SPEEDS = {False: ("rad/s", "deg/s", "rpm", "turn/s"), True: ("m/s", "mm/s")}  # by whether a joint slides
SPEED_ERROR = 0.2  # relative difference between a speed and the change of the position: their units differ more
OVER = 1.1  # times a limit of the joint, up to which positions are within it
TURNS = 3.0  # turns beyond which angles are no longer taken as rad where nothing but their size is known
COUNTS_FROM = 720.0  # integers beyond are counts rather than degrees
AMPERES = 100.0  # [A] that motors of joints take
WRAP, WRAP_ERROR = 0.8, 0.05  # jumps of an angle over its range; relative difference between that and a turn
BITS, BITS_ERROR = (8, 24), 0.002  # of encoders; difference of a resolution from a whole number of bits
ALIKE = 7.5  # ratio of two sizes: nearer to 1 than to the 57.3 between rad and deg


class UnitGuess(NamedTuple):
    """A unit, why, and the one that fits as well if nothing but the size of the numbers shows it."""

    unit: str
    reason: str
    instead: str = ""


def slope_of(time: Array, position: Array, velocity: Array, rate: float) -> float | None:
    """Change of a position (N,) over the integral of its speed (N,), in their own units; None at rest. `rate` [Hz]."""
    there = np.isfinite(time) & np.isfinite(position) & np.isfinite(velocity)
    t, q, v = time[there], position[there], velocity[there]
    # Travel over half a second: encoder steps and the delay of a filtered speed do not matter.
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    apart = max(1, round(0.5 * rate))
    moved, summed = q[apart:] - q[:-apart], travelled[apart:] - travelled[:-apart]
    power = float(summed @ summed)
    return float(moved @ summed) / power if power > 0.0 else None


def unit_of_velocity(unit: str, reason: str, of_position: str | None, slope: float | None) -> UnitGuess:
    """The unit in which a speed is the change of its position, whose unit is `of_position`; else `unit`."""
    if of_position is None or slope is None or COUNTS.fullmatch(of_position):
        return UnitGuess(unit, reason)
    ratio = slope * factor(of_position)  # SI speed per unit of the column
    nearest = min(SPEEDS[is_linear(of_position)], key=lambda each: abs(np.log(max(ratio, 1e-12) / factor(each))))
    if abs(ratio / factor(nearest) - 1.0) > SPEED_ERROR:
        return UnitGuess(unit, f"{reason}; the position changes {ratio:.3g} times as fast; check")
    return UnitGuess(nearest, f"{reason}, unit by the change of the position")


def unit_of_current(values: Array, reason: str) -> UnitGuess:
    """Amperes, in doubt where they are more than the motor of a joint takes."""
    size = float(np.nanmax(np.abs(values)))
    return UnitGuess("A", reason) if size <= AMPERES else UnitGuess("A", f"up to {size:.3g}, taken as A; check", "mA")


def unit_of_position(
    values: Array, limits: tuple[float, float] | None, slope: float | None = None, speed: str = ""
) -> UnitGuess:
    """The unit of the positions (N,) of a joint.

    limits  lowest and highest position [rad], infinite where it turns on and on; None: not known
    slope   of the positions over the integral of their speed, whose unit is `speed`, '': not stated
    """
    there = values[np.isfinite(values)]
    size = float(np.abs(there).max())
    seen = _by_slope(slope, speed) or _by_limits(size, limits) or _by_turn(there) or _by_step(there)
    return seen or _by_size(there, size, endless=limits is not None and bool(np.all(np.isinf(limits))))


def are_alike(one: Array, other: Array) -> bool:
    """Whether two columns (N,) of a joint are as large as each other, which rad and deg are not."""
    sizes = [float(np.nanmax(np.abs(each))) for each in (one, other)]
    return max(sizes) < ALIKE * min(sizes)


def _by_slope(slope: float | None, speed: str) -> UnitGuess | None:
    if slope is None or (speed and is_linear(speed)):
        return None
    fits = {
        unit
        for unit in FULL
        for each in ([speed] if speed else SPEEDS[False])
        if abs(slope * factor(unit) / factor(each) - 1.0) <= SPEED_ERROR
    }
    return UnitGuess(fits.pop(), "unit by its speed, of which it is the integral") if len(fits) == 1 else None


def _by_limits(size: float, limits: tuple[float, float] | None) -> UnitGuess | None:
    if limits is None or not np.all(np.isfinite(limits)) or limits[1] <= limits[0]:
        return None
    most = OVER * max(abs(limits[0]), abs(limits[1]))
    if size > np.degrees(most):
        return UnitGuess("counts", "beyond the limits of the joint in degrees: counts; check")
    unit, why = ("rad", "within") if size <= most else ("deg", "beyond")
    return UnitGuess(unit, f"{why} the limits of the joint in rad")


def _by_turn(values: Array) -> UnitGuess | None:
    reach = float(np.ptp(values))
    if not np.any(np.abs(np.diff(values)) > WRAP * reach):
        return None
    fits = [unit for unit, turn in FULL.items() if abs(reach / turn - 1.0) < WRAP_ERROR]
    return UnitGuess(fits[0], f"starts again after {reach:.4g}, a turn in {fits[0]}") if fits else None


def _by_step(values: Array) -> UnitGuess | None:
    step = step_of(values)
    for unit, turn in FULL.items():
        bits = np.log2(turn / step) if step > 0.0 else 0.0
        if BITS[0] <= round(bits) <= BITS[1] and abs(bits - round(bits)) < BITS_ERROR:
            return UnitGuess(unit, f"steps of {step:.4g}, as {2 ** round(bits)} on a turn in {unit}")
    return None


def _by_size(values: Array, size: float, endless: bool) -> UnitGuess:
    if size <= TURNS * FULL["rad"]:
        return UnitGuess("rad", f"at most {size:.3g}, taken as rad; check")
    if np.all(values == np.rint(values)) and size > COUNTS_FROM:
        return UnitGuess("counts", f"integers up to {size:.0f}, taken as counts; check")
    if endless:
        return UnitGuess("rad", f"up to {size:.3g} of a joint that turns on and on, taken as rad; check", "deg")
    return UnitGuess("deg", f"up to {size:.3g}, taken as deg by its size alone; check", "rad")
