"""Modulated rows of an interval of samples, and what an equation in such rows leaves unexplained.

See `via_core.plausibility` for the equations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from via_core.devices import Device
from via_core.motor_stops import SPAN, reach_of
from via_core.signals import Array, Signals

INTERVAL = 1.0  # [s] over which a share is computed: some periods of motion, yet shorter than a fault may last
ROWS_PER_SPAN = 4  # rows overlap, so that no course of a signal falls between them
LEAST_SAMPLES = 8  # of a row
ORDER = 3  # of the modulating function
OFFSET = 0.2  # [-] largest constant torque that no term explains, over the typical load
IMPOSSIBLE = 0.3  # [-] unexplained share from which signals do not belong to the device
CLEAR = 3.0  # [-] the largest part must exceed its noise by this factor, or nothing can be said
DAMPER_FACTOR = 10.0  # [-] damping varies by command and speed; its number in the file is an order of magnitude
FURTHEST = 2.0  # [max_deflection] no spring deflects further, and a spring law may overflow there
RESTING = 3.0  # [encoder steps] in a row, less is no motion with a direction
MEASURED = 0.9  # [-] of the samples: a torque that was measured
SWEEPS = 200  # of coordinate descent, more than five unknowns need


def device_factor(tolerance: float) -> float:
    """Largest plausible ratio of a number to that in the device file: 2 times three of its standard deviations."""
    return 2.0 * exp(3.0 * tolerance)


class Samples(NamedTuple):
    """Samples of one joint: time (N,) [s], q (N,), theta (N, m) [rad], torque (N, m) of its motors or (N, 1) [N m].

    command  (N, 2) equilibrium and preset [rad] of a joint driven by servos, whose torques are not measured
    reach    (2, m) smallest and largest motor angle [rad] so far (`reach_of`); None where stops do not matter
    """

    time: Array
    q: Array
    theta: Array
    torque: Array
    command: Array | None = None
    reach: Array | None = None

    @classmethod
    def of_signals(cls, measured: Signals, device: Device, commands: Signals | None = None) -> Samples | None:
        """The samples of a recording with channels as in `bags.joints`; None without torques, or commands of servos."""
        if device.drive == "servo":
            return cls._of_servos(measured, device, commands)
        torque = _link_torque(measured, device, commands) if not device.n_motors else measured.channels.get("tau")
        theta = measured.channels.get("theta", np.empty((len(measured), 0)))
        if "q" not in measured or torque is None or theta.shape[1] != device.n_motors:
            return None
        reach = reach_of(measured.time, theta)
        return cls(measured.time, measured["q"], theta, torque.reshape(len(measured), -1), reach=reach)

    @classmethod
    def _of_servos(cls, measured: Signals, device: Device, commands: Signals | None) -> Samples | None:
        if "q" not in measured or commands is None or "equilibrium" not in commands or not len(commands):
            return None
        at = np.searchsorted(commands.time, measured.time, side="right") - 1
        command = np.full((len(measured), 2), np.nan)
        for column, name in enumerate(("equilibrium", "preset")):
            values = commands.channels.get(name, np.zeros(len(commands)))
            command[at >= 0, column] = values[at[at >= 0]]
        theta = measured.channels.get("theta", np.full((len(measured), device.n_motors), np.nan))
        return cls(measured.time, measured["q"], theta, np.empty((len(measured), 0)), command)

    def between(self, begin: float, end: float) -> Samples:
        """The samples after `begin` up to `end` [s]."""
        first, last = np.searchsorted(self.time, (begin, end), side="right")
        at = slice(first, last)
        command = None if self.command is None else self.command[at]
        return Samples(self.time[at], self.q[at], self.theta[at], self.torque[at], command, self.reach)


def _link_torque(measured: Signals, device: Device, commands: Signals | None) -> Array | None:
    """(N,) or (N, 1) [N m] torque on a rigid link: of its damper, or of its drive as measured or else as commanded."""
    if device.damper is not None:
        return measured.channels.get("tau_link")
    sent: Mapping[str, Array] = {}
    if commands is not None and len(commands):
        names = [name for name in ("external_torque", "arm_torque") if name in commands]
        sent = commands.select(names).resample(measured.time).channels if names else {}
    if "tau" in measured and np.mean(np.isfinite(measured["tau"])) >= MEASURED:
        torque = measured["tau"].reshape(len(measured))
    elif device.drive == "torque" and "external_torque" in sent:
        torque = sent["external_torque"]
    else:
        return None
    return torque + sent.get("arm_torque", 0.0)


class Share(NamedTuple):
    """Share of the torques in an interval that no device of the file explains, and their ratio to their noise.

    stopped  -1 or 1 if the lower or upper mechanical stop of the motor explains the rest of them, else 0
    """

    unexplained: float
    clearness: float
    limit: float = IMPOSSIBLE
    stopped: float = 0.0

    @property
    def known(self) -> bool:
        return self.clearness > CLEAR

    @property
    def impossible(self) -> bool:
        return self.known and self.unexplained > self.limit


class Equation(ABC):
    """A torque equation of a device."""

    interval = INTERVAL  # [s] of samples that `share` needs

    @abstractmethod
    def share(self, samples: Samples) -> Share:
        """Unexplained share of the torques in the interval of the samples."""

    def relaxed(self) -> Equation:
        """The equation of the device with everything that may act beside it."""
        return self

    def with_unit(self, unit: float) -> Equation:
        """The equation for a link's angle in another unit: a step of its encoder is `unit` times that of the file."""
        return self


def finite_columns(*columns: Array) -> list[Array]:
    """The columns at the samples where all are finite, contiguous and writable as compiled code requires."""
    good = np.logical_and.reduce([np.isfinite(each) for each in columns])
    return [np.array(each[good], dtype=np.float64) for each in columns]


@njit(cache=True, error_model="numpy")
def noise_of(values: Array) -> float:
    """Standard deviation of white noise, from third differences, to which smooth motion contributes little."""
    total = 0.0
    for k in range(3, values.size):
        third = values[k] - 3.0 * values[k - 1] + 3.0 * values[k - 2] - values[k - 3]
        total += third * third
    return sqrt(total / (20.0 * max(values.size - 3, 1)))


@njit(cache=True, error_model="numpy")
def next_row(time: Array, first: int, last: int) -> tuple[int, int]:
    """First and last sample of the next row after that from `first` to `last`; last < 0 begins, first < 0 ends."""
    if last >= 0:
        begin = time[first]
        while first < time.size - 1 and time[first] - begin < SPAN / ROWS_PER_SPAN:
            first += 1
    last = max(first, last)
    while last < time.size - 1 and time[last] - time[first] < SPAN:
        last += 1
    return (first, last) if last < time.size and time[last] - time[first] >= SPAN else (-1, -1)


@njit(cache=True, error_model="numpy")
def bounded_least_squares(gram: Array, right: Array, low: Array, high: Array, x: Array) -> None:
    """Least squares within bounds by coordinate descent: the minimum of x'Gx/2 - r'x, low <= x <= high, into x."""
    for j in range(x.size):
        x[j] = min(max(0.0, low[j]), high[j])
    for _ in range(SWEEPS):
        moved = 0.0
        for j in range(x.size):
            if gram[j, j] > 0.0:
                step = right[j]
                for k in range(x.size):
                    step -= gram[j, k] * x[k]
                new = min(max(x[j] + step / gram[j, j], low[j]), high[j])
                moved = max(moved, gram[j, j] * (new - x[j]) ** 2)
                x[j] = new
        if moved <= 1e-12 * abs(right @ x):
            break
