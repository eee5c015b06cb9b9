"""Nuisance parameters: the device parameters, which are known only within tolerances.

Every candidate cause is fitted together with them, so that an error of 5 % in an inertia is neither mistaken for an
effect nor compensated by one. They are bounded for two reasons: simulation and inverse dynamics have a trivial minimum
in which all terms vanish, and a parameter far from its filed value is an effect that has to be named. The repaired
model is the device with its fitted parameters and the named effects.

Three more parameters belong to the recording. The repaired model does not contain them.

- The torque of the integral of a position drive when the recording began.
- The delay of goals. The log shows a goal in one sample, but the goal may act up to one sample earlier or later.
- The delay of measured torques. A sensor logs the torque of the tick before an angle; a controller logs the torque that
  it computes from the angle, which acts in the tick after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from via_core.device_parts import Tolerances
from via_core.devices import Device
from via_core.signals import Array
from via_sim.effects.device_numbers import DeviceNumber, numbers_of
from via_sim.joint.parameters import POSITION_DRIVE, P
from via_sim.plants import JointPlant

from via_gap.logs.between import LATE_SD, STEPS_SD, period_of
from via_gap.logs.log import JointLog
from via_gap.residual.driven import measured_columns, measured_torque

_SPRINGS = {"linear": ("stiffness",), "cubic": ("coefficient",), "odd_polynomial": ("odd_coefficients",)}
_SHAPES = {"odd_polynomial": ("odd_coefficients",), "sinh": ("a",)}
LARGE_ERROR = 1.0  # [rad] whose torque an integral without a limit may have at most
# Of the delay of goals, as of a device parameter known to 5 %: a finite difference is .2 sd then. One of .01 sd is far
# below a tick and shows which goal acts in it rather than the slope.
DELAY_KNOWN = 0.05
BOUND = 1.3  # [standard deviations of the tolerance] largest offset


@dataclass(frozen=True)
class Nuisance(DeviceNumber):
    """One parameter with its value in the device file.

    tolerance  relative standard deviation, by which finite differences are divided (`residual_model.STEP`)
    start      standard deviation, in its unit, of what differs between recordings; 0 for device parameters
    lowest     smallest offset
    """

    tolerance: float
    start: float = 0.0
    lowest: float = -BOUND

    def apply(self, row: Array, offset: float) -> None:
        """Move it in a row in place, by an offset in standard deviations."""
        if self.start > 0.0:
            row[list(self.slots)] += self.start * offset
        else:
            row[list(self.slots)] *= 1.0 + self.tolerance * offset


def nuisances(plant: JointPlant) -> tuple[Nuisance, ...]:
    """The parameters of a nominal plant that are not zero: inertias, frictions, springs, gravity, servos, damper.

    The scale of torques is one if the device file states its tolerance. A spring whose torque at a deflection is known
    to 5 % may stiffen otherwise than filed by as much: its shape is one beside its torque.
    """
    known = plant.device.tolerances
    found = (
        (each, _tolerance(known, each.name) / each.lever) for each in numbers_of(plant.parameters) if each.value != 0.0
    )
    numbers = tuple(Nuisance(**vars(each), tolerance=tolerance) for each, tolerance in found if tolerance > 0.0)
    return (*numbers, *_integral_start(plant.parameters))


def _integral_start(row: Array) -> tuple[Nuisance, ...]:
    """Torque of the integral of a position drive at the beginning of a recording: anything within its limit."""
    if row[P.link_drive] != POSITION_DRIVE or row[P.integral_rate] <= 0.0:
        return ()
    most = min(row[P.integral_limit], row[P.drive_torque_limit], row[P.drive_stiffness] * LARGE_ERROR)
    return (Nuisance("servo integral at the start", "N m", 0.0, (P.integral_start,), 1.0, 1.0, float(most) / BOUND),)


def delay_between_samples(log: JointLog) -> tuple[Nuisance, ...]:
    """Delay of what drives a joint, by what its log leaves open between samples."""
    return _goal_delay(log) or _torque_delay(log)


def _goal_delay(log: JointLog) -> tuple[Nuisance, ...]:
    """Delay of the goals of a position drive beside that of its device file.

    The drive itself may be faster than its file states, but never acts before its command.
    """
    servo = log.device.servo
    if servo is None:
        return ()
    sd = (STEPS_SD if log.lined is None else LATE_SD) * period_of(log)
    lowest = -min(BOUND, servo.delay / sd)
    return (Nuisance("goal delay between samples", "s", 0.0, (P.delay,), 1.0, DELAY_KNOWN, sd, lowest),)


def _torque_delay(log: JointLog) -> tuple[Nuisance, ...]:
    """Delay of measured torques that drive the simulation: 0 for those of the tick before a sample, one tick after it.

    Interpolated ones have a delay of their own.
    """
    if log.lined is not None or not measured_columns(log):
        return ()
    period = float(np.median(np.diff(measured_torque(log)[0])))
    return (Nuisance("torque delay between samples", "s", 0.0, (P.delay,), 1.0, DELAY_KNOWN, period, 0.0),)


def lowest_offsets(each: tuple[Nuisance, ...]) -> Array:
    """(J,) smallest offsets; the largest are BOUND."""
    return np.array([nuisance.lowest for nuisance in each])


def _tolerance(known: Tolerances, name: str) -> float:
    """Tolerance in the device file of the parameter that `numbers_of` calls `name`."""
    part, _, what = name.partition(" ")
    if part == "torque":
        return known.torque_scale
    if part == "servo":  # of a position drive: kp, kd, torque limit
        return float(getattr(known, what.replace(" ", "_")))
    kind = next(key for key in ("bandwidth", "inertia", "friction", "") if key in what)
    if kind in ("inertia", "friction"):
        return float(getattr(known, f"{part}_{kind}"))
    return float(getattr(known, kind or part))


def apply_all(row: Array, each: tuple[Nuisance, ...], offsets: Array) -> None:
    """Apply every nuisance to a row in place; offsets (J,) in standard deviations of the tolerance."""
    for nuisance, offset in zip(each, offsets.tolist(), strict=True):
        if offset != 0.0:
            nuisance.apply(row, offset)


def repaired_device(device: Device, each: tuple[Nuisance, ...], offsets: Array) -> Device:
    """The device with every nuisance moved by its offset [sd]: the row of the fit but for the start of a recording."""
    content: dict[str, Any] = device.model_dump(mode="python")
    for nuisance, offset in zip(each, offsets, strict=True):
        if nuisance.start > 0.0:
            continue
        part, keys = _entries(content, nuisance.name)
        factor = 1.0 + nuisance.tolerance * float(offset)
        first = 1 if nuisance.name.endswith("shape") else 0  # of the coefficients of a polynomial
        for key in keys:
            value = part[key]
            several = isinstance(value, tuple)
            part[key] = (*value[:first], *(v * factor for v in value[first:])) if several else value * factor
    return Device.model_validate(content)


def _entries(content: dict[str, Any], name: str) -> tuple[dict[str, Any], Sequence[str]]:
    """The part of a device file that contains the parameter `name`, and the keys there that are proportional to it."""
    part, _, what = name.partition(" ")
    number, _, of_motor = what.partition(" ")
    if name == "damper":
        return content["damper"], [key for key in ("minimum", "maximum", "stage") if key in content["damper"]]
    if part == "spring":
        spring = content["springs"][int(number) - 1]
        return spring, (_SHAPES if of_motor == "shape" else _SPRINGS).get(spring["law"], ("k",))
    if part == "gravity":
        return content["link"], ("gravity_torque",)
    if part == "torque":
        return content, ("torque_scale",)
    entries, key = (content["motors"][int(number) - 1], of_motor) if part == "motor" else (content[part], what)
    return entries, (key.replace("dry", "coulomb").replace(" ", "_"),)


def descend(normal: Array, gradient: Array, start: Array, low: Array, high: Array) -> Array:
    """argmin x' N x - 2 g' x for low <= x <= high (n,), N (n, n) positive, by an active set.

    Newton steps on the free coordinates; the first that would leave its interval is fixed at that end. Once the free
    ones have converged, the fixed one with the largest inward gradient is freed.
    """
    x = np.clip(start, low, high)
    diagonal = np.diag(normal)
    ridge = 1e-10 * diagonal + 1e-14 * max(float(diagonal.max(initial=0.0)), 1e-300)
    regular, gradient = normal + np.diag(ridge), gradient + ridge * x  # those without influence stay
    slope = gradient - regular @ x
    fixed = ((x <= low) & (slope <= 0.0)) | ((x >= high) & (slope >= 0.0)) | (low >= high)
    size = np.sqrt(diagonal + 1e-300)
    for _ in range(6 * len(x) + 10):
        free = np.flatnonzero(~fixed)
        step = np.zeros_like(x)
        step[free] = np.linalg.solve(regular[np.ix_(free, free)], (gradient - regular @ x)[free])
        room = np.full(len(x), np.inf)
        up, down = step > 0.0, step < 0.0
        room[up] = (high - x)[up] / step[up]
        room[down] = (low - x)[down] / step[down]
        first = int(np.argmin(room))
        if room[first] < 1.0:
            x = np.clip(x + max(float(room[first]), 0.0) * step, low, high)
            x[first] = high[first] if up[first] else low[first]
            fixed[first] = True
            continue
        x = np.clip(x + step, low, high)
        slope = gradient - regular @ x
        inwards = np.where(fixed & (low < high), np.where(x <= low, slope, -slope), -np.inf) / size
        best = int(np.argmax(inwards))
        if inwards[best] <= 1e-9 * float(np.max(np.abs(gradient) / size, initial=1e-300)):
            break
        fixed[best] = False
    return x
