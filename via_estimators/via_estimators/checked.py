"""An estimator whose status says when signals or estimates cannot come from the device of the device file.

The last INTERVAL of samples is compared with the torque equations of the device every EVERY seconds
(via_core.plausibility). From the first impossible interval until HOLD seconds of possible ones have passed, estimates
that would be OK are IMPLAUSIBLE; then the estimator starts anew, because its memory holds impossible samples. Intervals
without motion say nothing and prolong neither. An estimate that is impossible by itself (a negative stiffness, an
inertia or a stiffness many times that of the file) is IMPLAUSIBLE at once.

Samples are kept at no more than RATE, with the mean of the torques between them, so that a state remains small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.faults import fault_of
from via_core.plausibility import (
    DAMPER_FACTOR,
    INTERVAL,
    Equation,
    Samples,
    device_factor,
    equations_of,
    worst,
)  # fmt: skip
from via_core.signals import Array
from via_core.status import IMPLAUSIBLE, OK, OUTSIDE_RANGE, Status

from via_estimators.contract import Estimator, Health, Kernel, Parameters
from via_estimators.slots import slots

EVERY = 0.25  # [s] between two comparisons
FIRST = 0.75  # [s] before the first comparison
HOLD = 3.0  # [s] of possible intervals after which a fault is over
RATE = 250.0  # [Hz] of the samples kept
KEPT = int(1.2 * INTERVAL * RATE)
SURE = 3.0  # [standard deviations] by which an estimate must miss its bounds
# Stamp of the last sample and of the last one kept; time of the next comparison; end of the suspicion; ring position
# and filling; 1 while implausible; time over which the torques are summed; number of the last output outside its
# bounds, from 1, or 0.
HEAD = slots("last", "kept", "next", "until", "slot", "filled", "implausible", "summed", "outside")


@dataclass(frozen=True)
class Checked(Estimator):
    """`inner` with a check of its samples and estimates against the device file."""

    inner: Estimator
    device: Device

    @classmethod
    def from_device(cls, device: Device) -> Checked:
        """Use `methods.estimator_for`, which knows the method."""
        raise NotImplementedError("methods.estimator_for(device, method) returns checked estimators")

    @property
    def parameters(self) -> Parameters:  # type: ignore[override]
        """Those of the estimator inside."""
        return self.inner.parameters

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.inner.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.inner.outputs

    def with_parameters(self, parameters: Parameters) -> Checked:
        return replace(self, inner=self.inner.with_parameters(parameters))

    def init(self) -> Array:
        head = np.zeros(HEAD.size)
        head[[HEAD.last, HEAD.kept, HEAD.next, HEAD.until]] = -np.inf
        columns = 1 + len(self.inputs)
        state = np.concatenate([self.inner.init(), head, np.zeros(columns), np.zeros(KEPT * columns)])
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        return self.inner.condition(state[: self._size])

    def health(self, state: Array) -> Health:
        found, head = self.inner.health(state[: self._size]), self._head(state)
        suspected = head[HEAD.implausible] or head[HEAD.outside]
        if suspected and found.status in (Status.OK, Status.OUTSIDE_RANGE):
            return found._replace(status=Status.IMPLAUSIBLE)
        return found

    def fault(self, state: Array) -> str:
        """The suspected fault with its remedy, '' while samples and estimates are plausible."""
        head = self._head(state)
        if head[HEAD.implausible]:
            fault = fault_of(self.device, self._samples(state), suspected=True)
            return (
                fault.text
                if fault
                else "torques of the last seconds do not fit the device file; no single fault explains them"
            )
        if head[HEAD.outside]:
            at = int(head[HEAD.outside]) - 1
            return (
                f"{self.outputs[at]} is impossible for '{self.device.name}', whose file allows "
                f"{self._bounds[0][at]:.3g} to {self._bounds[1][at]:.3g}: check signs, units and the device file"
            )
        return ""

    @cached_property
    def _size(self) -> int:
        return len(self.inner.init())

    @cached_property
    def _equations(self) -> tuple[Equation, ...]:
        known = set(self.inputs)
        needed = {"q", "tau_link"} if self.device.arrangement == "rigid" else {"q", "theta_1", "tau_1"}
        return equations_of(self.device) if needed <= known else ()

    @cached_property
    def _torques(self) -> Array:
        """Mask (1 + k,) of the torques in a row, which are averaged."""
        return np.array([False, *(name.startswith("tau") for name in self.inputs)])

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        """Smallest and largest plausible outputs (k,)."""
        device, given = self.device, self.device.tolerances
        spring, motor = device_factor(given.spring), device_factor(given.motor_inertia)
        stiffest = []
        for law in device.spring_laws:
            phi = np.linspace(-law.max_deflection, law.max_deflection, 129)
            stiffest.append(spring * float(np.max(law.stiffness(phi, 0.0))))
        low, high = np.zeros(len(self.outputs)), np.full(len(self.outputs), np.inf)
        for at, name in enumerate(self.outputs):
            kind, _, number = name.rpartition("_")
            if name == "gain":
                low[at], high[at] = 1.0 / spring, spring
            elif name == "damping" and device.drive == "torque" and device.arrangement == "rigid":
                high[at] = DAMPER_FACTOR * (device.link.viscous_friction + float(device.damping_of(1.0)))
            elif name == "stiffness" and device.drive == "torque":
                high[at] = sum(stiffest)
            elif kind == "stiffness" and device.drive == "torque":
                high[at] = stiffest[int(number) - 1]
            elif kind == "motor_inertia":
                inertia = getattr(device.motors[int(number) - 1], "inertia", np.inf)
                low[at], high[at] = inertia / motor, inertia * motor
        return low, high

    def _head(self, state: Array) -> Array:
        return state[self._size : self._size + HEAD.size]

    def _ring(self, state: Array) -> Array:
        """The view (KEPT, 1 + k) of the samples kept."""
        return state[state.size - KEPT * (1 + len(self.inputs)) :].reshape(KEPT, -1)

    def _samples(self, state: Array) -> Samples:
        """The samples of the last INTERVAL, oldest first."""
        head, ring = self._head(state), self._ring(state)
        slot, filled = int(head[HEAD.slot]), int(head[HEAD.filled])
        rows = np.roll(ring, -slot, axis=0)[KEPT - filled :]
        rows = rows[rows[:, 0] > head[HEAD.last] - INTERVAL]
        columns = dict(zip(("time", *self.inputs), rows.T, strict=True))
        theta = [columns[name] for name in self.inputs if name.startswith("theta_") and name[6:].isdigit()]
        torque = [columns[name] for name in self.inputs if name.startswith("tau")]
        angles = np.column_stack(theta) if theta else np.empty((len(rows), 0))
        return Samples(columns["time"], columns["q"], angles, np.column_stack(torque))

    @property
    def _advance(self) -> Kernel:
        return self._take

    def _take(self, state: Array, rows: Array, out: Array) -> int:
        """The kernel: rows up to the next comparison at a time."""
        inner, head, at = state[: self._size], self._head(state), 0
        low, high = self._bounds
        while at < len(rows):
            end = len(rows)
            if self._equations:
                sums = state[self._size + HEAD.size : self._size + HEAD.size + rows.shape[1]]
                end = _collect(head, sums, self._ring(state), rows, at, self._torques)
            self.inner._advance(inner, rows[at : abs(end)], out[at : abs(end)])
            head[HEAD.outside] = _grade(out[at : abs(end)], head[HEAD.implausible] > 0.0, low, high)
            if end < 0:
                self._compare(state)
            at = abs(end)
        return int(out[-1, 1])

    def _compare(self, state: Array) -> None:
        """Compare the last samples with the device's equations, and set whether they are implausible."""
        head, samples = self._head(state), self._samples(state)
        found = worst([each.share(samples) for each in self._equations])
        now = head[HEAD.last]
        if found.impossible or (head[HEAD.implausible] and not found.known):
            head[HEAD.implausible], head[HEAD.until] = 1.0, now + HOLD
        elif head[HEAD.implausible] and now >= head[HEAD.until]:
            head[HEAD.implausible] = 0.0
            state[: self._size] = self.inner.init()


@njit(cache=True, error_model="numpy")
def _collect(head: Array, sums: Array, ring: Array, rows: Array, at: int, torques: Array) -> int:
    """Keep rows from `at` on; returns the number of the first row not taken, negative where a comparison is due."""
    for k in range(at, rows.shape[0]):
        time, step = rows[k, 0], rows[k, 0] - head[HEAD.last]
        finite = True
        for j in range(rows.shape[1]):
            finite = finite and np.isfinite(rows[k, j])
        if not finite or (step <= 0.0 and step > -INTERVAL):
            continue
        if not (0.0 < step < INTERVAL):  # the first sample, after a gap, or of a log played again
            head[HEAD.slot] = head[HEAD.filled] = head[HEAD.summed] = 0.0
            head[HEAD.kept], head[HEAD.next], step = -np.inf, time + FIRST, 0.0
            sums[:] = 0.0
        head[HEAD.last] = time
        head[HEAD.summed] += step
        sums += step * rows[k]
        if time - head[HEAD.kept] >= (1.0 - 1e-6) / RATE:
            slot = int(head[HEAD.slot])
            for j in range(rows.shape[1]):
                mean = torques[j] and head[HEAD.summed] > 0.0
                ring[slot, j] = sums[j] / head[HEAD.summed] if mean else rows[k, j]
            head[HEAD.slot] = slot + 1 if slot + 1 < ring.shape[0] else 0
            head[HEAD.filled] = min(head[HEAD.filled] + 1.0, ring.shape[0])
            head[HEAD.kept], head[HEAD.summed] = time, 0.0
            sums[:] = 0.0
        if time >= head[HEAD.next]:
            head[HEAD.next] = time + EVERY
            return -(k + 1)
    return rows.shape[0]


@njit(cache=True, error_model="numpy")
def _grade(out: Array, implausible: bool, low: Array, high: Array) -> int:
    """Mark the usable estimates of implausible samples, and those outside their bounds.

    Returns the number, from 1, of the output that is outside in the last row, or 0.
    """
    k, outside = low.size, 0
    for n in range(out.shape[0]):
        outside = 0
        if out[n, 1] != OK and out[n, 1] != OUTSIDE_RANGE:
            continue
        for j in range(k):
            margin = SURE * out[n, 2 + k + j]
            if out[n, 2 + j] + margin < low[j] or out[n, 2 + j] - margin > high[j]:
                outside = j + 1
                break
        if implausible or outside:
            out[n, 1] = IMPLAUSIBLE
    return outside
