"""Estimator interface: frozen parameters, returned state, and one compiled kernel for live use and replay.

    estimator = ModulatedTorque(ModulatedTorqueParameters(...))
    state = estimator.init()
    state, estimate = estimator.step(state, sample)      # live: sample (1 + k,) is time [s], then the columns `inputs`
    estimates = estimator.run(signals)                   # replay: the same kernel, the same bits
    live = Live(estimator); live.take(row)               # live without copies: again the same bits

Time is a float64 counted from the first stamp, subtracted in whole nanoseconds and rounded once, so errors do not
accumulate: at t [s] the error is 2^-53 t at most, 1e-11 s after a day and 3e-10 s after 30 days. For an estimator, this
is jitter: the relative error of a step h [s] is 2^-52 t/h, 6e-7 at 1 kHz after 30 days.

Programming errors raise ParameterError or SignalError; bad data is reported in the Status: samples that are not finite
or whose stamp does not increase are skipped, counted and marked BAD_SAMPLE; a gap restarts the window. No estimate is
NaN.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from math import isfinite
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from via_core.devices import Device
from via_core.errors import ParameterError, SignalError
from via_core.signals import Array, Signals
from via_core.status import Status

from via_estimators.window import HEADER

STATUSES = tuple(Status)  # by number: Status(number) would be slow


def parameter(default: float | int, description: str, unit: str, low: float, high: float) -> Any:
    """A dataclass field with the description, unit and closed range of a ROS parameter."""
    return field(default=default, metadata={"description": description, "unit": unit, "range": (low, high)})


def choice(default: str, description: str, choices: tuple[str, ...]) -> Any:
    """A dataclass field with a choice of words."""
    return field(default=default, metadata={"description": description, "choices": choices})


@dataclass(frozen=True)
class Parameters:
    """Base of every estimator's parameters; raises ParameterError for values outside a field's range or choices."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if "choices" in item.metadata:
                if value not in item.metadata["choices"]:
                    allowed = ", ".join(item.metadata["choices"])
                    raise ParameterError(f"{type(self).__name__}.{item.name} must be one of {allowed}, got {value!r}")
                continue
            low, high = item.metadata["range"]
            if isinstance(item.default, int) and not (isinstance(value, int) and not isinstance(value, bool)):
                raise ParameterError(f"{type(self).__name__}.{item.name} must be a whole number, got {value!r}")
            if not isinstance(value, int | float) or not isfinite(value) or not low <= value <= high:
                raise ParameterError(
                    f"{type(self).__name__}.{item.name} must lie in [{low:g}, {high:g}] {item.metadata['unit']}, "
                    f"got {value!r}"
                )


P = TypeVar("P", bound=Parameters)
# A compiled kernel with its constants: kernel(state, rows, out) processes rows (N, 1 + k), N >= 1, in order, updates
# the state, writes out (N, 2 + 2 k), time, status, values and standard deviations, and returns the last status.
Kernel = Callable[[Array, Array, Array], int]


class Estimate(NamedTuple):
    """One estimate: stamp of its sample [s], status, values (k,) and standard deviations (k,), both finite."""

    time: float
    status: Status
    value: Array
    standard_deviation: Array


def expect(parameters: Parameters, kind: type[P]) -> P:
    """`parameters` if they are of that kind; else raises ParameterError."""
    if not isinstance(parameters, kind):
        raise ParameterError(f"parameters must be {kind.__name__}, got {type(parameters).__name__}")
    return parameters


@dataclass(frozen=True)
class Estimates:
    """A run's estimates: time (N,) [s], status (N,) uint8, value and standard_deviation (N, k), outputs (k,)."""

    time: Array
    status: np.ndarray
    value: Array
    standard_deviation: Array
    outputs: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.time)

    def column(self, name: str) -> tuple[Array, Array]:
        """Value (N,) and standard deviation (N,) of the output `name`; raises SignalError for an unknown name."""
        if name not in self.outputs:
            raise SignalError(f"no output '{name}'; there are: {', '.join(self.outputs)}")
        at = self.outputs.index(name)
        return self.value[:, at], self.standard_deviation[:, at]


class Health(NamedTuple):
    """Counters and excitation of a state, for diagnostics."""

    samples: int  # taken
    bad: int  # skipped
    gaps: int  # window restarts
    motion: float  # [rad] smallest range of deflection inside the present window
    condition: float  # [-] largest condition number of the scaled normal equations
    status: Status


class Estimator(ABC):
    """An algorithm; `step` and `run` are final and share `_advance`."""

    parameters: Parameters

    @classmethod
    @abstractmethod
    def from_device(cls, device: Device) -> Estimator:
        """Scales and priors from a device file; raises ParameterError if the method does not suit the device."""

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Columns of a sample after its time."""

    @property
    @abstractmethod
    def outputs(self) -> tuple[str, ...]:
        """Columns of an estimate."""

    @abstractmethod
    def with_parameters(self, parameters: Parameters) -> Estimator:
        """The same estimator with other parameters; raises ParameterError for those of another class."""

    @abstractmethod
    def init(self) -> Array:
        """The state before the first sample, a locked flat array."""

    @property
    @abstractmethod
    def _advance(self) -> Kernel:
        """The kernel, for live use and replay."""

    @abstractmethod
    def condition(self, state: Array) -> float:
        """Largest condition number [-] of the scaled normal equations."""

    @property
    def models_torque_errors(self) -> bool:
        """Whether standard deviations include the tolerances of the torques' scale and timing (`torque_errors`)."""
        return False

    @property
    def skips_stops(self) -> bool:
        """Whether equations in which a mechanical stop holds a motor are left out (`mechanical_stop`)."""
        return False

    def load(self) -> None:
        """Load every compiled function, so that no sample waits for one."""
        self.run_rows(np.full((1, 1 + len(self.inputs)), np.nan))

    def fault(self, state: Array) -> str:
        """The suspected fault of signals or device file with its remedy; '' without one, or without a check."""
        return ""

    def step(self, state: Array, sample: ArrayLike) -> tuple[Array, Estimate]:
        """One sample (1 + k,), time first; the given state is not modified."""
        new, out = self._fold(state, np.array(sample, dtype=np.float64).reshape(1, -1))
        new.setflags(write=False)
        row, k = out[0], len(self.outputs)
        return new, Estimate(row.item(0), STATUSES[int(row[1])], row[2 : 2 + k], row[2 + k :])

    def run_rows(self, rows: ArrayLike, state: Array | None = None) -> tuple[Array, Estimates]:
        """Fold `step` over rows (N, 1 + k) from `state`, or from the start; returns the last state too."""
        start = self.init() if state is None else state
        new, out = self._fold(start, np.array(rows, dtype=np.float64, order="C"))
        k, status = len(self.outputs), out[:, 1].astype(np.uint8)
        for array in (new, out, status):
            array.flags.writeable = False
        return new, Estimates(out[:, 0], status, out[:, 2 : 2 + k], out[:, 2 + k :], self.outputs)

    def run(self, signals: Signals) -> Estimates:
        """Fold `step` over signals; raises SignalError if an input without which no sample is usable is missing."""
        rows = rows_of(signals, self.inputs)
        estimates = self.run_rows(rows)[1]
        missing = [name for name, column in zip(self.inputs, rows.T[1:], strict=True) if np.isnan(column).all()]
        if missing and np.all(estimates.status == Status.BAD_SAMPLE):
            raise SignalError(f"no values of {', '.join(missing)}; the signals are {', '.join(signals.channels)}")
        return estimates

    def health(self, state: Array) -> Health:
        """Counters and excitation of a state."""
        return Health(
            int(state[HEADER.samples]),
            int(state[HEADER.bad]),
            int(state[HEADER.gaps]),
            float(state[HEADER.motion]),
            self.condition(state),
            Status(int(state[HEADER.status])),
        )

    def _fold(self, state: Array, rows: Array) -> tuple[Array, Array]:
        """State and output rows (N, 2 + 2 k) after rows (N, 1 + k)."""
        # Rows are copies, since a read-only or strided array is another type and would compile again.
        if rows.ndim != 2 or rows.shape[1] != 1 + len(self.inputs):
            raise SignalError(f"a sample has time and {', '.join(self.inputs)}; got an array of shape {rows.shape}")
        new, out = state.copy(), np.empty((len(rows), 2 + 2 * len(self.outputs)))
        if len(rows):
            self._advance(new, rows, out)
        return new, out


class Live:
    """An estimator with its state, updated in place, for nodes: the kernel of `step` without its copies.

    value, standard_deviation  (k,) of the last sample: views of `numbers` (2k,), which the next one overwrites
    """

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        k = len(estimator.outputs)
        self._out = np.zeros((1, 2 + 2 * k))
        self.numbers = self._out[0, 2:]
        self.value, self.standard_deviation = self.numbers[:k], self.numbers[k:]
        self._advance = estimator._advance
        self.restart()

    def restart(self) -> None:
        """Reset the state to that before the first sample."""
        self._state = self.estimator.init().copy()

    def take(self, row: Array) -> int:
        """Process one sample, row (1, 1 + k), writable and contiguous as kernels require; returns the status."""
        return self._advance(self._state, row, self._out)

    def health(self) -> Health:
        """Counters and excitation."""
        return self.estimator.health(self._state)

    def fault(self) -> str:
        """The suspected fault with its remedy, '' without one."""
        return self.estimator.fault(self._state)


class Summary(NamedTuple):
    """Mean of one output over a run."""

    value: float
    standard_deviation: float
    weights: Array  # (N,) of the estimates, for equal averages of other signals; sum 1, or all 0


def summarise(estimates: Estimates, output: str) -> Summary:
    """Mean of `output` over the run, weighted by the information 1/sd^2 of its OK estimates.

    Estimates of one run share most of their rows, so the mean is no more accurate than the best of them: the result
    has the smallest standard deviation. Without an OK estimate it is the last one, with zero weights.
    """
    value, sd = estimates.column(output)
    if not len(value):
        raise SignalError("cannot summarise a run without estimates")
    good = estimates.status == Status.OK
    if not good.any():
        return Summary(float(value[-1]), float(sd[-1]), np.zeros(len(value)))
    weights = np.where(good, 1.0 / np.maximum(sd, 1e-300) ** 2, 0.0)
    weights /= weights.sum()
    return Summary(float(weights @ value), float(sd[good].min()), weights)


def rows_of(signals: Signals, inputs: tuple[str, ...]) -> Array:
    """Rows (N, 1 + k) for `inputs`; 'theta_2' is the second column of channel 'theta', a missing channel is NaN."""
    rows = np.full((len(signals), 1 + len(inputs)), np.nan)
    rows[:, 0] = signals.time
    for at, name in enumerate(inputs, start=1):
        if name in signals:
            rows[:, at] = signals[name]
            continue
        channel, _, number = name.rpartition("_")
        if channel in signals and number.isdigit():
            values = signals[channel]
            columns = values.reshape(len(values), -1)
            if int(number) <= columns.shape[1]:
                rows[:, at] = columns[:, int(number) - 1]
    return rows
