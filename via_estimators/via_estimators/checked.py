"""An estimator whose status says when signals or estimates cannot come from the device of the device file.

The last seconds of samples are compared with the torque equations of the device, four times in the interval that these
need (via_core.plausibility). From the first impossible interval until HOLD seconds of possible ones have passed,
estimates that would be OK are IMPLAUSIBLE; then the estimator starts anew, because its memory holds impossible samples.
Intervals without motion say nothing and prolong neither. An estimate that is impossible by itself (a negative
stiffness, an inertia or a stiffness many times that of the file) is IMPLAUSIBLE at once.

The motor inertia found is also the only evidence of a wrong torque scale that the device file does not state: all
values are proportional to it. With inertia B +- tolerance b in the file, found B' +- sd, its most likely variance is
max(0, (B'/B - 1)^2 - (sd/B)^2 - b^2). A value x that was found with the scale s = B'/B is x / s in truth, so this
variance over s^2 is added to the relative variances of stiffness, inertia and damping. It must not hide what causes it:
an estimate that misses its bounds without it throughout an interval is IMPLAUSIBLE too. For a shorter time, a spring
that has just changed may do that.

A step between two samples that no joint can make, such as one wild number of a damaged message, is a bad sample: in a
window or a long memory it would act like many true ones. If the signal stays there, the window restarts as after a gap.

Samples are kept at no more than RATE, with the mean of the torques between them, so that a state remains small.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.faults import fault_of
from via_core.modulated_rows import INTERVAL, Equation, Samples
from via_core.motor_stops import UNREACHED, reach_of, stopped_text
from via_core.plausibility import equations_of, interval_of, worst
from via_core.signals import Array
from via_core.status import BAD_SAMPLE, IMPLAUSIBLE, OK, OUTSIDE_RANGE, Status

from via_estimators.contract import Health, Kernel
from via_estimators.plausible_outputs import bounds_of, deflections_of, exceeded, exceeded_text, steps_of
from via_estimators.slots import slots
from via_estimators.window import RESTARTED, SKIPPED, TAKEN, sound
from via_estimators.wrapped import Wrapped

EVERY = 0.25  # [intervals] between two comparisons
FIRST = 0.75  # [intervals] before the first comparison
HOLD = 3.0  # [s] of possible intervals after which a fault is over
RATE = 250.0  # [Hz] of the samples kept
ROOM = 1.2  # [intervals] of samples kept
NEVER = -1e300  # [s] before every stamp
LONGEST = 0.05  # [s] between samples that are compared; later, a signal that stays beyond a step is believed
SURE = 3.0  # [standard deviations] by which an estimate must miss its bounds
ALL, NONE = -1, -2  # owners of an output that is a sum over the motors, or that has no motor
# Stamp of the last sample and of the last one kept; time of the next comparison; end of the suspicion; ring position
# and filling; 1 while implausible; time over which the torques are summed; number of the last output outside its
# bounds, from 1, or 0, and its value; stamp of the last estimate within them before `_doubt`.
# Then smallest and largest angle of two motors (`reach_of`), the motor at a stop, from 1, below 0 at its lower one, and
# largest deflections [rad].
HEAD = slots(
    "last", "kept", "next", "until", "slot", "filled", "implausible", "summed", "outside", "found", "fits",
    "lowest", "lowest_2", "highest", "highest_2", "stopped", "deflection", "deflection_2",
)  # fmt: skip


@dataclass(frozen=True)
class Checked(Wrapped):
    """`inner` with a check of its samples and estimates against the device file."""

    device: Device

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Those of the estimator inside; of a serial joint also the angle that sets the preset of its spring."""
        own = self.inner.inputs
        return (*own, "theta_2") if self._serial and "theta_1" in own and "theta_2" not in own else own

    @property
    def _serial(self) -> bool:
        """Whether motor 2 sets the preset of a spring that motor 1 drives by a measured torque."""
        return self.device.arrangement == "serial" and self.device.drive == "torque"

    def init(self) -> Array:
        head = np.zeros(HEAD.size)
        head[[HEAD.last, HEAD.kept, HEAD.next, HEAD.until]] = NEVER
        head[HEAD.lowest : HEAD.highest], head[HEAD.highest : HEAD.stopped] = UNREACHED, -UNREACHED
        columns = 1 + len(self.inputs)
        before = np.full(columns, np.nan)
        bounds = np.concatenate(bounds_of(self.device, self.outputs, head[HEAD.deflection :]))
        ring = np.zeros(self._kept * columns)
        state = np.concatenate([self.inner.init(), head, np.zeros(columns), before, bounds, ring])
        state.flags.writeable = False
        return state

    def health(self, state: Array) -> Health:
        found, head = self.inner.health(state[: self._size]), self._head(state)
        suspected = head[HEAD.implausible] or head[HEAD.outside]
        if suspected and found.status in (Status.OK, Status.OUTSIDE_RANGE):
            return found._replace(status=Status.IMPLAUSIBLE)
        return found

    def load(self) -> None:
        self.inner.load()
        super().load()
        time, m = np.arange(100) / RATE, max(self.device.n_motors, 1)
        command = np.zeros((len(time), 2))
        angles, torques = np.zeros((len(time), self.device.n_motors)), np.zeros((len(time), m))
        still = Samples(time, 0.0 * time, angles, torques, command)
        for each in self._equations:
            each.share(still)

    def fault(self, state: Array) -> str:
        """The suspected fault with its remedy, '' while samples and estimates are plausible."""
        head = self._head(state)
        beyond = exceeded_text(self.device, head[HEAD.deflection :])
        if head[HEAD.stopped]:
            motor, upper = int(abs(head[HEAD.stopped])), head[HEAD.stopped] > 0.0
            return stopped_text(motor, head[(HEAD.highest if upper else HEAD.lowest) + motor - 1], upper)
        if head[HEAD.implausible]:
            fault = fault_of(self.device, self._samples(state), suspected=True)
            unknown = "signals of the last seconds do not fit the device file; no single fault explains them"
            if fault and fault.proven:
                return fault.text
            return "; ".join(filter(None, (fault.text if fault else unknown, beyond)))
        if head[HEAD.outside]:
            at, found = int(head[HEAD.outside]) - 1, head[HEAD.found]
            low, high = self._bounds(state)
            filed = {int(motor[0]): motor[1] for motor in self._motors}
            ratio = f" = {found / filed[at]:.2g} x the file" if at in filed else ""
            return (
                f"{self.outputs[at]} found is {found:.3g}{ratio}, impossible for '{self.device.name}', whose file "
                f"allows {low[at]:.3g} to {high[at]:.3g}: check signs, units and the device file"
            )
        return beyond or self.inner.fault(state[: self._size])

    @cached_property
    def _equations(self) -> tuple[Equation, ...]:
        known = set(self.inputs)
        needed = {"q", "tau_link"} if self.device.arrangement == "rigid" else {"q", "theta_1", "tau_1"}
        if self._serial:
            needed |= {"theta_2"}
        if self.device.drive == "servo":
            needed = {"q", "equilibrium", "preset"}
        return equations_of(self.device) if needed <= known else ()

    @cached_property
    def _interval(self) -> float:
        return interval_of(self._equations)

    @cached_property
    def _kept(self) -> int:
        return int(ROOM * self._interval * RATE)

    @cached_property
    def _constants(self) -> tuple[Array, Array, Array, Array, float]:
        """Masks (1 + k,) of needed columns and of averaged ones, `_motors`, `_owners`, interval [s]."""
        logged = {"theta_1"} if self.device.drive == "servo" else set()  # not part of the equation, often missing
        logged |= {"theta_2"} if self._serial else set()  # where it is missing, the preset stays
        needed = np.array([True, *(name not in logged for name in self.inputs)])
        torques = np.array([False, *(name.startswith("tau") for name in self.inputs)])
        return (needed, torques, self._motors, self._owners, self._interval)

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        return steps_of(self.device, self.inputs)

    @cached_property
    def _motors(self) -> Array:
        """Output of the inertia, inertia of the file [kg m^2] and its squared tolerance, for each motor (m, 3)."""
        found = [name for name in self.outputs if name.startswith("motor_inertia_")]
        inertia = [getattr(self.device.motors[int(name[14:]) - 1], "inertia", np.nan) for name in found]
        square = self.device.tolerances.motor_inertia**2
        rows = [(self.outputs.index(name), B, square) for name, B in zip(found, inertia, strict=True)]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    @cached_property
    def _owners(self) -> Array:
        """The motor, from 0, of every output (k,) proportional to its torque; ALL for a sum, NONE for others."""
        numbers = [name.rpartition("_") for name in self.outputs]
        own = {"stiffness", "motor_inertia", "motor_damping"}
        return np.array(
            [ALL if name == "stiffness" else int(number) - 1 if kind in own else NONE
             for name, (kind, _, number) in zip(self.outputs, numbers, strict=True)]
        )  # fmt: skip

    def _head(self, state: Array) -> Array:
        return state[self._size : self._size + HEAD.size]

    def _bounds(self, state: Array) -> Array:
        """The view (2, k) of `bounds_of`."""
        begin, k = self._size + HEAD.size + 2 * (1 + len(self.inputs)), len(self.outputs)
        return state[begin : begin + 2 * k].reshape(2, k)

    def _ring(self, state: Array) -> Array:
        """The view (kept, 1 + k) of the samples kept."""
        return state[state.size - self._kept * (1 + len(self.inputs)) :].reshape(self._kept, -1)

    def _samples(self, state: Array) -> Samples:
        """The samples of the last interval, oldest first."""
        head, ring = self._head(state), self._ring(state)
        slot, filled = int(head[HEAD.slot]), int(head[HEAD.filled])
        rows = np.roll(ring, -slot, axis=0)[self._kept - filled :]
        rows = rows[rows[:, 0] > head[HEAD.last] - self._interval]
        columns = dict(zip(("time", *self.inputs), rows.T, strict=True))
        theta = [columns[name] for name in self.inputs if name.startswith("theta_") and name[6:].isdigit()]
        torque = [columns[name] for name in self.inputs if name.startswith("tau")]
        angles = np.column_stack(theta) if theta else np.empty((len(rows), 0))
        command = np.column_stack([columns["equilibrium"], columns["preset"]]) if self.device.drive == "servo" else None
        torques = np.column_stack(torque) if torque else np.empty((len(rows), 0))
        reach, m = None, angles.shape[1]
        if self.device.drive == "torque":
            low, high = reach_of(columns["time"], angles)
            reach = np.array([np.minimum(head[HEAD.lowest :][:m], low), np.maximum(head[HEAD.highest :][:m], high)])
        return Samples(columns["time"], columns["q"], angles, torques, command, reach)

    @property
    def _advance(self) -> Kernel:
        return self._take

    def _take(self, state: Array, rows: Array, out: Array) -> int:
        """The kernel: rows up to the next comparison at a time."""
        size, at, count, own = self._size, 0, len(rows), 1 + len(self.inner.inputs)
        inner, advance, constants = state[:size], self.inner._advance, self._constants
        _refuse_steps(state, size, rows, *self._steps)
        while at < count:
            end = _until(state, size, rows, at, constants[0], self._interval) if count > 1 else 1
            whole = end - at == count
            part, answers = (rows, out) if whole else (rows[at:end], out[at:end])
            advance(inner, part if own == part.shape[1] else np.ascontiguousarray(part[:, :own]), answers)
            if _finish(state, size, part, answers, *constants) and self._equations:
                self._compare(state)
            at = end
        return int(out[-1, 1])

    def _compare(self, state: Array) -> None:
        """Compare the last samples with the device's equations, and set whether they are implausible."""
        head, samples = self._head(state), self._samples(state)
        if samples.reach is not None:
            for at, reached in zip((HEAD.lowest, HEAD.highest), samples.reach, strict=True):
                head[at : at + len(reached)] = reached
            latest = deflections_of(self.device, samples)
            seen = head[HEAD.deflection :][: len(latest)]
            grown = exceeded(self.device, latest) & (latest > seen)
            seen[:] = np.maximum(seen, latest)
            if grown.any():
                self._bounds(state)[:] = bounds_of(self.device, self.outputs, seen)
        shares = [each.share(samples) for each in self._equations]
        found, now = worst(shares), head[HEAD.last]
        stopped = [(1 + i) * each.stopped for i, each in enumerate(shares) if each.known and each.stopped]
        head[HEAD.stopped] = stopped[0] if stopped and not found.impossible else 0.0
        spoilt = head[HEAD.stopped] and not self.inner.skips_stops
        if found.impossible or spoilt or (head[HEAD.implausible] and not found.known):
            head[HEAD.implausible], head[HEAD.until] = 1.0, now + HOLD
        elif head[HEAD.implausible] and now >= head[HEAD.until]:
            head[HEAD.implausible] = 0.0
            state[: self._size] = self.inner.init()


@njit(cache=True, error_model="numpy")
def _refuse_steps(state: Array, size: int, rows: Array, step: Array, rate: Array) -> None:
    """Write NaN in place of numbers that differ by more than `step + rate dt` (1 + k,) from the last valid ones."""
    width = rows.shape[1]
    before = state[size + HEAD.size + width : size + HEAD.size + 2 * width]
    for k in range(rows.shape[0]):
        row = rows[k]
        if not np.isfinite(row[0]):
            continue
        since = row[0] - before[0]
        compared = 0.0 < since <= LONGEST  # not before the first sample, whose time is NaN
        refused = False
        for j in range(1, row.size):
            if compared and abs(row[j] - before[j]) > step[j] + rate[j] * since:
                row[j], refused = np.nan, True
        if not refused and (compared or not -LONGEST <= since <= 0.0):
            before[0] = row[0]
            for j in range(1, row.size):
                if sound(row[j]):
                    before[j] = row[j]


@njit(cache=True, error_model="numpy", inline="always")
def _kind(row: Array, needed: Array, last: float) -> int:
    """SKIPPED, TAKEN or RESTARTED (the first sample, after a gap, or of a log played again), as `window.admit`."""
    if not np.isfinite(row[0]):
        return SKIPPED
    for j in range(1, row.size):
        if needed[j] and not sound(row[j]):
            return SKIPPED
    step = row[0] - last
    if 0.0 < step < INTERVAL:
        return TAKEN
    return SKIPPED if -INTERVAL < step <= 0.0 else RESTARTED


@njit(cache=True, error_model="numpy")
def _until(state: Array, size: int, rows: Array, at: int, needed: Array, interval: float) -> int:
    """Number of the row after the one behind which the next comparison is due, or of all rows."""
    last, due = state[size + HEAD.last], state[size + HEAD.next]
    for k in range(at, rows.shape[0]):
        kind = _kind(rows[k], needed, last)
        if kind != SKIPPED:
            last = rows[k, 0]
            if kind == RESTARTED:
                due = last + FIRST * interval
            if last >= due:
                return k + 1
    return rows.shape[0]


@njit(cache=True, error_model="numpy")
def _finish(
    state: Array, size: int, rows: Array, out: Array, needed: Array, torques: Array, motors: Array, owners: Array,
    interval: float,
) -> bool:  # fmt: skip
    """Keep the samples of the rows and grade their estimates; returns whether a comparison is due.

    size        of the inner estimator's state, which the HEAD follows
    needed, torques  (1 + k,) columns of a row without which it is skipped, and those that are averaged
    motors      (m, 3), as `Checked._motors`
    owners      (k,), as `Checked._owners`
    interval    [s] of a comparison
    """
    width = rows.shape[1]
    head = state[size : size + HEAD.size]
    sums = state[size + HEAD.size : size + HEAD.size + width]
    begin, count = size + HEAD.size + 2 * width, owners.size
    low, high = state[begin : begin + count], state[begin + count : begin + 2 * count]
    ring = state[begin + 2 * count :].reshape(-1, width)
    kept = ring.shape[0]
    due, outside = False, 0
    for k in range(rows.shape[0]):
        missed = _outside(out[k], low, high)
        if missed == 0 and out[k, 1] != BAD_SAMPLE:
            head[HEAD.fits] = head[HEAD.last]
        _doubt(out[k], motors, owners)
        outside = _outside(out[k], low, high)
        if head[HEAD.last] - head[HEAD.fits] > interval:
            outside = max(outside, missed)
        head[HEAD.found] = out[k, 1 + outside]
        if (outside > 0 or head[HEAD.implausible] > 0.0) and _usable(out[k]):
            out[k, 1] = IMPLAUSIBLE
        kind = _kind(rows[k], needed, head[HEAD.last])
        if kind == SKIPPED:
            continue
        time, step = rows[k, 0], rows[k, 0] - head[HEAD.last]
        if kind == RESTARTED:
            head[HEAD.slot] = head[HEAD.filled] = head[HEAD.summed] = 0.0
            head[HEAD.kept], head[HEAD.next], step = NEVER, time + FIRST * interval, 0.0
            sums[:] = 0.0
        head[HEAD.last] = time
        head[HEAD.summed] += step
        for j in range(width):
            sums[j] += step * rows[k, j]
        if time - head[HEAD.kept] >= (1.0 - 1e-6) / RATE:
            slot, summed = int(head[HEAD.slot]), head[HEAD.summed]
            for j in range(width):
                ring[slot, j] = sums[j] / summed if torques[j] and summed > 0.0 else rows[k, j]
                sums[j] = 0.0
            head[HEAD.slot] = slot + 1 if slot + 1 < kept else 0
            head[HEAD.filled] = min(head[HEAD.filled] + 1.0, kept)
            head[HEAD.kept], head[HEAD.summed] = time, 0.0
        if time >= head[HEAD.next]:
            head[HEAD.next], due = time + EVERY * interval, True
    head[HEAD.outside] = outside
    return due


@njit(cache=True, error_model="numpy", inline="always")
def _doubt(row: Array, motors: Array, owners: Array) -> None:
    """Add to the standard deviations what the motor inertias found show of a wrong torque scale."""
    k, total = owners.size, 0.0
    for i in range(motors.shape[0]):
        at, inertia, tolerance = int(motors[i, 0]), motors[i, 1], motors[i, 2]
        scale, sd = row[2 + at] / inertia, row[2 + k + at] / inertia
        excess = ((scale - 1.0) ** 2 - sd * sd - tolerance) / (scale * scale)
        if excess > 0.0:
            for j in range(k):
                if owners[j] == i:
                    row[2 + k + j] = sqrt(row[2 + k + j] ** 2 + excess * row[2 + j] ** 2)
            total += sqrt(excess) * abs(row[3 + i])
    if total > 0.0:
        row[2 + k] = sqrt(row[2 + k] ** 2 + total * total)


@njit(cache=True, error_model="numpy", inline="always")
def _usable(row: Array) -> bool:
    return row[1] == OK or row[1] == OUTSIDE_RANGE


@njit(cache=True, error_model="numpy", inline="always")
def _outside(row: Array, low: Array, high: Array) -> int:
    """Number of the first output of a usable estimate that misses its bounds, from 1, or 0."""
    if _usable(row):
        for j in range(low.size):
            margin = SURE * row[2 + low.size + j]
            if row[2 + j] + margin < low[j] or row[2 + j] - margin > high[j]:
                return j + 1
    return 0
