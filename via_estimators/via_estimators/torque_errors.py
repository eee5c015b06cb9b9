"""An estimator whose intervals include the uncertainty of the measured torques' scale and timing.

No motion shows either error to a method that does not estimate it. So each is propagated by a sigma point: a twin of
the estimator gets the same samples with the torques one standard deviation too large, another one with the torques one
standard deviation late. To first order the difference of its outputs is one standard deviation of theirs, and

    sd^2 <- sd^2 + sum over twins (twin - value)^2

The late twin gets torques behind a first-order lag, y' = (tau - y) / d, whose delay is d for motion slower than 1/d. A
method that models these errors itself (`Estimator.models_torque_errors`) has no twins.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array

from via_estimators.contract import Estimator, Health, Kernel
from via_estimators.window import sound
from via_estimators.wrapped import Wrapped

NEVER = -1e300  # [s] before every stamp


@dataclass(frozen=True)
class WithTorqueErrors(Wrapped):
    """`inner` with twins for a relative scale error and a delay [s] of the torques; 0: no such twin."""

    scale: float
    delay: float

    def init(self) -> Array:
        lag = np.zeros(1 + len(self._torques))  # time of the last sample [s], then the lagged torques [N m]
        lag[0] = NEVER
        state = np.concatenate([*(self.inner.init() for _ in range(1 + self._twins)), lag])
        state.flags.writeable = False
        return state

    def health(self, state: Array) -> Health:
        return self.inner.health(state[: self._size])

    def fault(self, state: Array) -> str:
        return self.inner.fault(state[: self._size])

    @cached_property
    def _torques(self) -> Array:
        """Columns of a row that are torques."""
        return np.array([1 + at for at, name in enumerate(self.inputs) if name.startswith("tau")], dtype=np.int64)

    @property
    def _twins(self) -> int:
        return (self.scale > 0.0) + (self.delay > 0.0)

    @property
    def _advance(self) -> Kernel:
        return self._take

    def _take(self, state: Array, rows: Array, out: Array) -> int:
        size, advance = self._size, self.inner._advance
        status = advance(state[:size], rows, out)
        changed, answers, extra = np.empty_like(rows), np.empty_like(out), np.zeros((len(out), len(self.outputs)))
        at = size
        if self.scale > 0.0:
            _scaled(rows, self._torques, 1.0 + self.scale, changed)
            advance(state[at : at + size], changed, answers)
            _add_squares(out, answers, extra)
            at += size
        if self.delay > 0.0:
            _lagged(rows, self._torques, self.delay, state[state.size - 1 - len(self._torques) :], changed)
            advance(state[at : at + size], changed, answers)
            _add_squares(out, answers, extra)
        _widen(out, extra)
        return status


def with_torque_errors(estimator: Estimator, device: Device) -> Estimator:
    """The estimator with the twins that the tolerances of the device file require."""
    scale, delay = device.tolerances.torque_scale, device.tolerances.torque_timing
    measured = any(name.startswith("tau") for name in estimator.inputs)
    if estimator.models_torque_errors or not measured or not (scale > 0.0 or delay > 0.0):
        return estimator
    return WithTorqueErrors(estimator, scale, delay)


@njit(cache=True, error_model="numpy")
def _scaled(rows: Array, torques: Array, factor: float, changed: Array) -> None:
    """Write the rows (N, 1 + k) with torques times `factor`."""
    changed[:] = rows
    for k in range(rows.shape[0]):
        for j in torques:
            changed[k, j] = factor * rows[k, j]


@njit(cache=True, error_model="numpy")
def _lagged(rows: Array, torques: Array, delay: float, lag: Array, changed: Array) -> None:
    """Write the rows with torques behind a lag of time constant `delay` [s], held between samples.

    lag  time of the last valid sample and the lagged torques, updated; a gap or a clock that jumps back starts anew
    """
    changed[:] = rows
    for k in range(rows.shape[0]):
        valid = np.isfinite(rows[k, 0])
        for j in range(1, rows.shape[1]):
            valid = valid and sound(rows[k, j])
        if not valid:
            continue
        step = rows[k, 0] - lag[0]
        share = 1.0 - np.exp(-step / delay) if step > 0.0 else 1.0
        lag[0] = rows[k, 0]
        for i, j in enumerate(torques):
            lag[1 + i] += share * (rows[k, j] - lag[1 + i])
            changed[k, j] = lag[1 + i]


@njit(cache=True, error_model="numpy")
def _add_squares(out: Array, twin: Array, extra: Array) -> None:
    """Add the squared differences of the values of two output arrays (N, 2 + 2 k) to `extra` (N, k)."""
    for n in range(extra.shape[0]):
        for j in range(extra.shape[1]):
            extra[n, j] += (twin[n, 2 + j] - out[n, 2 + j]) ** 2


@njit(cache=True, error_model="numpy")
def _widen(out: Array, extra: Array) -> None:
    """Add variances (N, k) to the standard deviations of output rows."""
    for n in range(extra.shape[0]):
        for j in range(extra.shape[1]):
            at = 2 + extra.shape[1] + j
            out[n, at] = sqrt(out[n, at] ** 2 + extra[n, j])
