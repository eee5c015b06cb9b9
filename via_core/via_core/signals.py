"""Signals: named channels over one time base, the result of bags, simulations and estimators."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from via_core.errors import SignalError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]


def locked(values: ArrayLike, name: str) -> Array:
    """A read-only float64 copy of `values`; frozen dataclasses do not freeze numpy arrays.

    Raises SignalError when `values` is not numeric.
    """
    try:
        given = np.asarray(values)
    except ValueError as error:  # ragged
        raise SignalError(f"'{name}' is not an array: {error}") from None
    if given.dtype.kind not in "biuf":  # numpy would convert '1.5' and None to numbers and drop imaginary parts
        raise SignalError(f"'{name}' is not real and numeric: it holds {given.dtype}")
    array = np.array(given, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)  # compared by identity: arrays have no single truth value
class Signals:
    """Named channels over one strictly increasing time base.

    time      (N,) [s], finite, strictly increasing
    channels  name -> (N,) or (N, k) float64; NaN means not measured
    units     name -> unit, e.g. 'rad', 'N m', for every channel
    held      names of command channels: constant between samples (zero-order hold)

    Arrays are copied and locked. Raises SignalError for inconsistent shapes, times or names.
    """

    time: Array
    channels: Mapping[str, Array]
    units: Mapping[str, str]
    held: frozenset[str] = field(default_factory=frozenset)

    def __post_init__(self) -> None:
        time = locked(self.time, "time")
        if time.ndim != 1:
            raise SignalError(f"time must be one-dimensional, got shape {time.shape}")
        if not np.all(np.isfinite(time)):
            first = int(np.flatnonzero(~np.isfinite(time))[0])
            raise SignalError(f"time is not finite at sample {first}: {time[first]}")
        steps = np.diff(time)
        if np.any(steps <= 0.0):
            first = int(np.flatnonzero(steps <= 0.0)[0]) + 1
            raise SignalError(
                f"time does not increase at sample {first}: {time[first]!r} s after {time[first - 1]!r} s"
            )
        channels = {name: locked(values, name) for name, values in self.channels.items()}
        for name, values in channels.items():
            if values.ndim not in (1, 2) or len(values) != len(time):
                raise SignalError(
                    f"channel '{name}' has shape {values.shape}, expected ({len(time)},) or ({len(time)}, k)"
                )
        missing = channels.keys() - self.units.keys()
        if missing:
            raise SignalError(f"channels without a unit: {', '.join(sorted(missing))}")
        unknown = set(self.held) - channels.keys()
        if unknown:
            raise SignalError(f"held names that are no channel: {', '.join(sorted(unknown))}")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        object.__setattr__(self, "units", MappingProxyType({name: self.units[name] for name in channels}))
        object.__setattr__(self, "held", frozenset(self.held))

    def __reduce__(self) -> tuple[type[Signals], tuple[Array, dict[str, Array], dict[str, str], frozenset[str]]]:
        """For pickle, which cannot handle read-only views of mappings."""
        return Signals, (self.time, dict(self.channels), dict(self.units), self.held)

    def __len__(self) -> int:
        return len(self.time)

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> Array:
        try:
            return self.channels[name]
        except KeyError:
            raise SignalError(f"no channel '{name}'; there are: {', '.join(sorted(self.channels))}") from None

    def select(self, names: Iterable[str]) -> Signals:
        """The channels `names` only."""
        chosen = {name: self[name] for name in names}
        return Signals(self.time, chosen, self.units, self.held & chosen.keys())

    def between(self, start: float, stop: float) -> Signals:
        """The samples with start <= time < stop [s]. Raises SignalError unless start <= stop."""
        if not start <= stop:
            raise SignalError(f"the interval must not end before it starts, got {start} to {stop} s")
        keep = (self.time >= start) & (self.time < stop)
        return replace(self, time=self.time[keep], channels={name: each[keep] for name, each in self.channels.items()})

    def resample(self, time: ArrayLike) -> Signals:
        """The signals at other times [s]: commands by zero-order hold, measurements by linear interpolation.

        Outside of the time base the first or last value is used. Next to a NaN a measurement is NaN.
        Raises SignalError without samples, or where `time` (n,) is not a valid time base.
        """
        if len(self) == 0:
            raise SignalError("cannot resample signals without samples")
        at = Signals(locked(time, "time"), {}, {}).time  # checks `time`
        holds = np.clip(np.searchsorted(self.time, at, side="right") - 1, 0, len(self) - 1)

        def resampled(name: str, values: Array) -> Array:
            if name in self.held:
                return values[holds]
            if values.ndim == 1:
                return np.interp(at, self.time, values)
            moved = np.empty((len(at), values.shape[1]))
            for k, column in enumerate(values.T):
                moved[:, k] = np.interp(at, self.time, column)
            return moved

        return replace(self, time=at, channels={name: resampled(name, each) for name, each in self.channels.items()})

    def joined(self, other: Signals) -> Signals:
        """These channels and those of `other`, resampled to this time base; names must differ."""
        twice = self.channels.keys() & other.channels.keys()
        if twice:
            raise SignalError(f"channels in both: {', '.join(sorted(twice))}")
        moved = other.resample(self.time)
        channels, units = {**self.channels, **moved.channels}, {**self.units, **moved.units}
        return Signals(self.time, channels, units, self.held | moved.held)
