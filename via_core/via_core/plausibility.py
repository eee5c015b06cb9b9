"""Whether signals can come from the device of a device file: its torque equations, with numbers that the file allows.

Motor i with a measured torque, multiplied by modulating functions (via_core.weak_form), one row per short window:

    tau_i = b theta_i'' + d theta_i' + c sign(theta_i') + sum_l c_l z_l + s(t) load_i + e - g phi_i'

with phi_i = q - theta_i, load_i = -tau_e,i(phi_i) (in a serial joint also of the preset, motor 2) and friction c_l z_l
that builds up over a travel l, dz_l = dtheta_i / l within -1..1, is solved by least squares, inertia b and load factor
s within `device_factor` of the file, friction d, c >= 0, c_l up to the declared friction with its tolerance, damping
g >= 0 of the transmission and an offset |e| <= OFFSET of the load. Springs may change during the interval: s(t) is
piecewise linear with KNOTS values, each within its bounds; more values also explain a reversed link angle. s is
constant and c_l = 0 where the link's encoder repeats one number, since a frozen encoder looks like such a change or
friction. What remains is compared with the largest part of the equation,

    unexplained = sqrt((rss - noise) / max(|tau|^2, |b theta''|^2, |s load|^2)),

once with all rows and once with their means removed, which shows a channel that is frozen at a value of the right size.
The share is 0 for a device of the file and about 1 where a channel is frozen, reversed, exchanged with another one or
in another unit: no torque within the bounds has the measured sign, size or course. `noise` is the part of rss that
noise causes, measured by third differences of the channels. Where a motor rests, dry friction takes up any torque up to
c, the declared friction or OFFSET of the largest part. Where it rests at the largest or smallest angle that it has
reached, a mechanical stop takes up any torque outward (`Share.stopped`).

The drive of a rigid link obeys the same equation, with q in place of theta and gravity as the load. People, contacts
and payloads act there too, so what it leaves is no fault (`recorded_equations`), unless one change of sign or unit
explains a whole recording, and a loaded link with the recorded signs and units does not.

The torque sensor of a damper reads what the damper dissipates: low v^2 <= tau v <= high v^2 in every row, up to dry
friction. `unexplained` is the torque outside of that, compared likewise.

A link that is driven by a servo has an equation of its own (via_core.servo_equation), which needs no torque.

`via_core.faults` names the fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from via_core.devices import Device
from via_core.modulated_rows import (
    CLEAR,
    DAMPER_FACTOR,
    FURTHEST,
    INTERVAL,
    LEAST_SAMPLES,
    OFFSET,
    ORDER,
    RESTING,
    Equation,
    Samples,
    Share,
    bounded_least_squares,
    device_factor,
    finite_columns,
    next_row,
    noise_of,
)
from via_core.motor_stops import PRESLIDING, touched
from via_core.servo_equation import servo_equation
from via_core.signals import Array
from via_core.weak_form import fill_weights

VARYING = 0.2  # [-] torques that vary less than this share of their size show no course
KNOTS = 2  # values of the load factor in an interval: a sound spring may soften or stiffen within it
TIE = 0.01  # [-] weight of their squared differences against the load of the whole interval
# Largest factors on inertia and gravity of a link by what acts beside it: a rotor behind a gear had 400 times the
# inertia of a wrist; wrong units change both by 57 or more.
LOADED = 500.0, 10.0
TRAVELS = (2e-3, 2e-2)  # [rad] l, over which friction builds up, as in `modulated_torque`
FIXED = 7  # unknowns before the knots: b, d, c, e, g and c_l of each travel
PARTS = FIXED + KNOTS


class _Known(NamedTuple):
    """What the kernels need beside samples and bounds."""

    step: float  # [rad] of the motor's encoder
    friction: float  # [N m] declared dry friction with its tolerance
    coarse: float = 0.0  # [N m] error of the load by encoder steps
    knots: int = 1  # values of the load factor
    unit: float = 1.0  # of the angle, see `LinkEquation`


@dataclass(frozen=True)
class MotorEquation(Equation):
    """The torque equation of motor `drive`, with the bounds low, high (4,) of b, d, c, s."""

    device: Device
    drive: int
    low: Array
    high: Array
    friction: float  # [N m] declared

    def share(self, samples: Samples) -> Share:
        spring, angle = self.device.springs[self.drive], samples.theta[:, self.drive]
        reach, deflection = FURTHEST * spring.max_deflection, samples.q - angle
        preset = samples.theta[:, -1] if self.device.arrangement == "serial" else angle
        if not np.isfinite(deflection + preset).any():  # a channel, as motor 2 of a serial joint, is not measured
            return Share(0.0, 0.0)
        if np.mean(np.abs(deflection) > reach) > 0.5:
            return Share(1.0, np.inf)
        clipped = np.clip(deflection, -reach, reach)
        load, stiffness = -spring.torque(clipped, preset), spring.stiffness(clipped, preset)
        sensors = self.device.sensors
        step, link = sensors.motor_quantum or 0.0, sensors.link_quantum or 0.0
        coarse = sqrt(float(np.nanmean(stiffness**2)) * (step * step + link * link) / 12.0) if len(angle) else 0.0
        columns = finite_columns(samples.time, samples.torque[:, self.drive], angle, deflection, load)
        # Where the link's encoder repeats one number, a frozen encoder is likelier than a change or built-up friction.
        knots = KNOTS if np.nanmax(samples.q) > np.nanmin(samples.q) else 1
        known = _Known(step, self.friction, coarse, knots)
        found = Share(*_motor_share(*columns, np.zeros(len(columns[0])), self.low, self.high, known))
        if samples.reach is None or not found.impossible:
            return found
        held = touched(columns[0], columns[2], *samples.reach[:, self.drive])
        free = Share(*_motor_share(*columns, held, self.low, self.high, known)) if held.any() else found
        return found if free.impossible else free._replace(stopped=float(np.sign(held.sum())))


@dataclass(frozen=True)
class LinkEquation(Equation):
    """The torque equation of a rigid link with a torque drive.

    loaded  with any rotor, payload or spring beside it
    unit    of the angles over that of the recording, when another unit is tried: steps of the encoder and the travel
            of presliding scale with it, else a motion in a smaller unit would count as rest that friction explains
    """

    device: Device
    loaded: bool = False
    unit: float = 1.0

    def relaxed(self) -> LinkEquation:
        return replace(self, loaded=True)

    def with_unit(self, unit: float) -> LinkEquation:
        return replace(self, unit=unit)

    def share(self, samples: Samples) -> Share:
        link, given = self.device.link, self.device.tolerances
        inertia, weight = device_factor(given.link_inertia), device_factor(given.gravity)
        if self.loaded:
            inertia, weight = LOADED
        low = np.array([link.inertia / inertia, 0.0, 0.0, 1.0 / weight])
        high = np.array([link.inertia * inertia, np.inf, np.inf, weight])
        load = link.gravity_torque * np.sin(samples.q - link.gravity_angle)
        friction = device_factor(given.link_friction) * link.coulomb_friction
        columns = finite_columns(samples.time, samples.torque[:, 0], samples.q, np.zeros(len(samples.q)), load)
        known = _Known(self.unit * (self.device.sensors.link_quantum or 0.0), friction, unit=float(self.unit))
        return Share(*_motor_share(*columns, np.zeros(len(columns[0])), low, high, known))


@dataclass(frozen=True)
class DamperEquation(Equation):
    """The torque of a damper with a sensor: damping between low and high [N m s/rad], dry friction [N m] besides."""

    low: float
    high: float
    friction: float

    def share(self, samples: Samples) -> Share:
        columns = finite_columns(samples.time, samples.torque[:, 0], samples.q)
        return Share(*_damper_share(*columns, self.low, self.high, self.friction))


def equations_of(device: Device) -> tuple[Equation, ...]:
    """The torque equations of a device; none where no torque is measured and no servo moves the link."""
    given, endless = device.tolerances, np.inf
    if device.drive == "servo":
        return servo_equation(device)
    if device.drive != "torque":
        return ()
    if device.arrangement == "rigid":
        if device.damper is None:
            return ()
        least, most = (float(device.damping_of(u)) + device.link.viscous_friction for u in (0.0, 1.0))
        return (DamperEquation(least / DAMPER_FACTOR, most * DAMPER_FACTOR, device.link.coulomb_friction),)
    inertia, spring = device_factor(given.motor_inertia), device_factor(given.spring)
    friction = device_factor(given.motor_friction)
    return tuple(
        MotorEquation(
            device,
            i,
            np.array([motor.inertia / inertia, 0.0, 0.0, 1.0 / spring]),
            np.array([motor.inertia * inertia, endless, endless, spring]),
            friction * motor.coulomb_friction,
        )
        for i, motor in enumerate(device.torque_motors[: device.n_transmissions])
    )


def recorded_equations(device: Device) -> tuple[Equation, ...]:
    """`equations_of` a device, or the equation of a rigid link, of which only a proven fault counts."""
    if device.arrangement == "rigid" and device.drive == "torque" and device.damper is None:
        return (LinkEquation(device),)
    return equations_of(device)


def interval_of(equations: Sequence[Equation]) -> float:
    """Length [s] of the interval of samples that all equations need."""
    return max((each.interval for each in equations), default=INTERVAL)


def worst(shares: list[Share]) -> Share:
    """The share of the equation that is violated most; Share(0, 0) if nothing is known."""
    return max((each for each in shares if each.known), default=Share(0.0, 0.0))


@njit(cache=True, error_model="numpy")
def _of_torque(weights: Array, values: Array, first: int) -> float:
    """<f, psi> of torques that act over the interval which ends at their stamp: each row is shared by both its ends."""
    total = 0.0
    for k in range(weights.size):
        at = min(first + k + 1, values.size - 1)
        total += 0.5 * weights[k] * (values[first + k] + values[at])
    return total


@njit(cache=True, error_model="numpy")
def _built_up(angle: Array, unit: float) -> Array:
    """The frictions (TRAVELS, N) that build up with travel over their limits, 0 in the beginning; angle in `unit`."""
    built = np.zeros((len(TRAVELS), angle.size))
    for j in range(len(TRAVELS)):
        for k in range(1, angle.size):
            moved = (angle[k] - angle[k - 1]) / (TRAVELS[j] * unit)
            built[j, k] = min(max(built[j, k - 1] + moved, -1.0), 1.0)
    return built


@njit(cache=True, error_model="numpy")
def _motor_share(
    time: Array, torque: Array, angle: Array, deflection: Array, load: Array, held: Array, low: Array, high: Array,
    known: _Known,
) -> tuple[float, float]:  # fmt: skip
    """Unexplained share and ratio of the largest part to its noise, (0, 0) if unknown; held: `motor_stops.touched`."""
    noises = np.array([noise_of(torque), noise_of(angle), noise_of(load)]) ** 2
    still = max(RESTING * known.step, 6.0 * sqrt(noises[1]))  # a smaller range of angle is no motion
    rows, wanted = np.zeros((time.size, PARTS)), np.zeros(time.size)
    moving, travel, outward = np.zeros(time.size, dtype=np.bool_), np.zeros(time.size), np.zeros(time.size)
    built = _built_up(angle, known.unit)
    quiet = np.zeros(3)
    count = 0
    first, last = next_row(time, 0, -1)
    while first >= 0:
        n = last - first + 1
        if n >= LEAST_SAMPLES:
            weights = np.empty((3, n))
            fill_weights(ORDER, time[first : last + 1], 0, weights)
            row, pull, reach = rows[count], 0.0, max(n // 8, 1)
            for k in range(n):
                at = first + k
                row[0] += weights[2, k] * angle[at]
                row[1] -= weights[1, k] * angle[at]
                row[2] += weights[0, k] * np.sign(angle[min(at + reach, angle.size - 1)] - angle[max(at - reach, 0)])
                row[4] += weights[1, k] * deflection[at]
                for j in range(len(TRAVELS)):
                    row[5 + j] += weights[0, k] * built[j, at]
                pull += weights[0, k] * load[at]
                outward[count] += weights[0, k] * held[at]
            row[3] = 1.0
            if known.knots > 1:
                place = (KNOTS - 1) * (0.5 * (time[first] + time[last]) - time[0]) / (time[-1] - time[0])
                knot = min(int(place), KNOTS - 2)
                row[FIXED + knot], row[FIXED + knot + 1] = (knot + 1 - place) * pull, (place - knot) * pull
            else:
                row[FIXED] = pull
            wanted[count] = _of_torque(weights[0], torque, first)
            travel[count] = np.ptp(angle[first : last + 1])
            moving[count] = travel[count] > still
            short, bend = weights[0] @ weights[0], weights[2] @ weights[2]
            quiet += noises * np.array([short, bend, short])
            quiet[2] += known.coarse * known.coarse  # slow motion repeats the error of an encoder step throughout a row
            count += 1
        first, last = next_row(time, first, last)
    if count < PARTS:
        return 0.0, 0.0
    rows, wanted, moving = rows[:count], wanted[:count], moving[:count]
    travel, outward = travel[:count], outward[:count]
    filed = np.sqrt(low * high)  # the numbers of the file, in the middle of their bounds
    springs = np.full(KNOTS, filed[3])
    whole = _largest(rows, wanted, filed[0], springs)
    size, clearness = _compare(rows, wanted, moving, travel, outward, low, high, quiet, known)
    alone = outward == 0.0
    if alone.sum() < PARTS:
        return size, clearness
    rows, wanted, moving, travel, outward = rows[alone], wanted[alone], moving[alone], travel[alone], outward[alone]
    for j in range(PARTS):
        if j != 3:
            rows[:, j] -= rows[:, j].mean()
    wanted -= wanted.mean()
    course, course_clearness = _compare(rows, wanted, moving, travel, outward, low, high, quiet, known)
    varying = _largest(rows, wanted, filed[0], springs)
    if course > size and course_clearness > CLEAR and varying > VARYING * VARYING * whole:
        return course, course_clearness
    return size, clearness


@njit(cache=True, error_model="numpy")
def _load(rows: Array) -> Array:
    """Load (n,) of the file's spring: the sum of its shares of the knots."""
    total = np.zeros(len(rows))
    for j in range(KNOTS):
        total += rows[:, FIXED + j]
    return total


@njit(cache=True, error_model="numpy")
def _largest(rows: Array, wanted: Array, inertia: float, spring: Array) -> float:
    """Square of the largest part of the equation: measured torque, inertia, load."""
    load = np.zeros(len(rows))
    for j in range(KNOTS):
        load += spring[j] * rows[:, FIXED + j]
    return max(float(wanted @ wanted), inertia * inertia * float(np.sum(rows[:, 0] ** 2)), float(load @ load))


@njit(cache=True, error_model="numpy")
def _compare(
    rows: Array, wanted: Array, moving: Array, travel: Array, outward: Array, low: Array, high: Array, quiet: Array,
    known: _Known,
) -> tuple[float, float]:  # fmt: skip
    """Unexplained share of rows (n, PARTS) and torques (n,), and ratio of the largest part to its noise.

    outward  (n,) > 0 or < 0 where a motor touches its upper or lower stop, which carries any torque outward
    """
    x, below, above = np.zeros(PARTS), np.zeros(PARTS), np.zeros(PARTS)
    below[:3], above[:3] = low[:3], high[:3]
    below[FIXED:], above[FIXED:] = low[3], high[3]
    above[3] = OFFSET * low[3] * sqrt(np.mean(_load(rows) ** 2))
    below[3] = -above[3]
    above[4] = np.inf
    above[5:FIXED] = known.friction if known.knots > 1 else 0.0  # more would be a spring of the motor
    free = moving & (outward == 0.0)
    used, y = rows[free], wanted[free]
    if len(used) > FIXED:
        gram, tie = used.T @ used, TIE * float(np.sum(_load(used) ** 2))
        # ties the load factor of a time without motion to that of its neighbours
        for j in range(FIXED, FIXED + known.knots - 1):
            gram[j, j] += tie
            gram[j + 1, j + 1] += tie
            gram[j, j + 1] -= tie
            gram[j + 1, j] -= tie
        bounded_least_squares(gram, used.T @ y, below, above, x)
        x[FIXED + known.knots :] = x[FIXED]
    else:  # at rest: springs and friction alone; a few rows of motion show neither inertia nor viscous friction
        x[0], x[FIXED:] = low[0], 1.0
        at = np.flatnonzero(moving == 0)
        rows, wanted, travel, moving, outward = rows[at], wanted[at], travel[at], moving[at], outward[at]
        if len(wanted) < PARTS:
            return 0.0, 0.0
    left = wanted - rows @ x
    largest = _largest(rows, wanted, x[0], x[FIXED:])
    most = max(known.friction, x[2] + x[5:FIXED].sum() + abs(x[3]), OFFSET * sqrt(largest / len(rows)))
    for k in range(len(left)):
        held = most if not moving[k] else known.friction if travel[k] < PRESLIDING * known.unit else 0.0
        left[k] = np.sign(left[k]) * max(abs(left[k]) - held, 0.0) if left[k] * outward[k] <= 0.0 else 0.0
    noise = quiet[0] + x[0] * x[0] * quiet[1] + np.mean(x[FIXED:] ** 2) * quiet[2]
    if largest <= 0.0:
        return 0.0, 0.0
    return sqrt(max(left @ left - noise, 0.0) / largest), sqrt(largest / max(noise, 1e-300))


@njit(cache=True, error_model="numpy")
def _damper_share(
    time: Array, torque: Array, angle: Array, least: float, most: float, friction: float
) -> tuple[float, float]:  # fmt: skip
    """Share of the torque that no damping from `least` to `most` dissipates, and ratio of the torque to its noise."""
    noise_torque, noise_angle = noise_of(torque) ** 2, noise_of(angle) ** 2
    left = largest_torque = largest_damping = noise = 0.0
    first, last = next_row(time, 0, -1)
    while first >= 0:
        n = last - first + 1
        if n >= LEAST_SAMPLES:
            weights = np.empty((3, n))
            fill_weights(ORDER, time[first : last + 1], 0, weights)
            speed = -(weights[1] @ angle[first : last + 1])
            wanted = weights[0] @ torque[first : last + 1]
            room = 2.0 * sqrt(
                noise_torque * (weights[0] @ weights[0]) + least * least * noise_angle * (weights[1] @ weights[1])
            )
            low, high = (least * speed, most * speed) if speed > 0.0 else (most * speed, least * speed)
            outside = max(low - friction - room - wanted, wanted - high - friction - room, 0.0)
            left += outside * outside
            largest_torque += wanted * wanted
            largest_damping += (least * speed) ** 2
            noise += room * room
        first, last = next_row(time, first, last)
    largest = max(largest_torque, largest_damping)
    if largest <= 0.0:
        return 0.0, 0.0
    return sqrt(left / largest), sqrt(largest / max(noise, 1e-300))
