"""The last seconds of one joint as a log, with the same bits as a bag of the same messages.

rolling = RollingLog(device, span=20.0)
rolling.sample(stamp, row)              # row (c,) of `columns_of(device)`
rolling.command(stamp, mode, equilibrium, preset, damping, motor)
log = rolling.log("live")               # a JointLog, or None while there are fewer than two samples
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from via_core.bags.joints import recorded
from via_core.bags.reader import Columns
from via_core.devices import Device
from via_core.signals import Array
from via_core.wire import JOINT_STATE, LINK, SECOND, VSA_COMMAND

from via_gap.logs.log import JointLog

JUMP = SECOND // 2  # [ns] by which a late sample may be older than the newest; beyond, the clock was set back
MOST = 2**20  # largest number of rows of samples or commands


def columns_of(device: Device) -> tuple[str, ...]:
    """What a sample row holds: the link's channels, then those of every motor, `theta_1`, ..., or a drive's `tau_1`."""
    return (*LINK, *(f"{name}_{i + 1}" for name in device.drive_channels for i in range(device.n_drives)))


class RollingLog:
    """Samples and commands of `device` whose stamps lie in the last `span` [s].

    restarts  how often the clock ran back and the window began anew
    """

    def __init__(self, device: Device, span: float) -> None:
        self.device = device
        self._span = round(span * SECOND)
        self._samples = _Tape(len(columns_of(device)))
        self._commands = _Tape(4 + device.n_drives)
        self.restarts = 0

    def __len__(self) -> int:
        """Samples in the window."""
        return len(self._samples.stamp)

    @property
    def newest(self) -> int | None:
        """[ns] latest stamp of a sample; None before the first."""
        return self._samples.newest

    def age(self, stamp: int) -> float:
        """[s] from a stamp [ns] to that of the newest sample."""
        return ((self.newest or 0) - stamp) / SECOND

    @property
    def duration(self) -> float:
        """[s] from the oldest to the newest sample."""
        stamps = self._samples.stamp
        return float(self._samples.newest - stamps[0]) / SECOND if self._samples.newest is not None else 0.0

    def sample(self, stamp: int, row: Array) -> None:
        """Take a sample (c,) with its stamp [ns]."""
        if self.newest is not None and stamp < self.newest - JUMP:
            self.restart()
            self.restarts += 1
        self._samples.append(stamp, row)
        self._samples.forget(self._samples.first_after((self.newest or 0) - self._span))
        # The command that holds in the oldest sample stays.
        self._commands.forget(self._commands.first_after(int(self._samples.stamp[0]) + 1) - 1)

    def command(self, stamp: int, mode: int, equilibrium: float, preset: float, damping: float, motor: Array) -> None:
        """Take a command with its stamp [ns]; `motor` (k,) is padded with NaN or cut to the device's drives."""
        padded = [*motor, *[np.nan] * self.device.n_drives][: self.device.n_drives]
        self._commands.append(stamp, np.array([mode, equilibrium, preset, damping, *padded]))

    def restart(self) -> None:
        """Drop all samples and commands."""
        self._samples.clear()
        self._commands.clear()

    def log(self, name: str, span: float | None = None) -> JointLog | None:
        """The window, or its last `span` [s]; None if it has fewer than two samples.

        Raises ViaError if the window contains no link angle, or commands that contradict one another.
        """
        if len(self) < 2:
            return None
        begin = 0 if span is None else self._samples.first_after((self.newest or 0) - round(span * SECOND))
        stamps, rows = self._samples.stamp[begin:].copy(), self._samples.rows[begin:]
        states = Columns("", JOINT_STATE, stamps, stamps, {}, True)
        channels = {channel: rows[:, i] for i, channel in enumerate(LINK)}
        drives, at = self.device.n_drives, len(LINK)
        for i, channel in enumerate(self.device.drive_channels):
            channels[channel] = rows[:, at + i * drives : at + (i + 1) * drives]
        recording = recorded(states, channels, np.ones(len(stamps), np.bool_), self._columns(stamps[0]), self.device)
        return JointLog.of(name, self.device, recording)

    def _columns(self, begin: int) -> Columns | None:
        """Commands from the one that is active at `begin` [ns] on, as from a bag."""
        first = max(self._commands.first_after(int(begin) + 1) - 1, 0)
        stamps, rows = self._commands.stamp[first:].copy(), self._commands.rows[first:]
        if not len(stamps):
            return None
        names = ("mode", "equilibrium", "preset", "damping")
        fields = {name: rows[:, i].copy() for i, name in enumerate(names)} | {"motor": rows[:, 4:].copy()}
        return Columns(self.device.command_topic, VSA_COMMAND, stamps, stamps, fields, True)


class _Tape:
    """Rows (n, c) with stamps (n,) [ns] in the order of arrival, in a buffer that is compacted when full."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._stamps, self._rows = np.empty(1024, dtype=np.int64), np.empty((1024, width))
        self._begin = self._end = 0
        self.newest: int | None = None  # [ns] largest stamp so far

    @property
    def stamp(self) -> NDArray[np.int64]:
        return self._stamps[self._begin : self._end]

    @property
    def rows(self) -> Array:
        return self._rows[self._begin : self._end]

    def append(self, stamp: int, row: Array) -> None:
        if self._end == len(self._stamps):
            self._make_room()
        self._stamps[self._end], self._rows[self._end] = stamp, row
        self._end += 1
        self.newest = stamp if self.newest is None else max(self.newest, stamp)

    def first_after(self, time: int) -> int:
        """Index of the first row stamped at `time` [ns] or later; the number of rows if there is none.

        If stamps ran backward, it is inexact by as many rows.
        """
        return int(np.searchsorted(self.stamp, time))

    def forget(self, count: int) -> None:
        """Drop the first rows."""
        self._begin += max(count, 0)

    def clear(self) -> None:
        self._begin = self._end = 0
        self.newest = None

    def _make_room(self) -> None:
        kept = slice(max(self._begin, self._end - MOST + 1), self._end)
        count = kept.stop - kept.start
        size = min(max(2 * count, 1024), MOST)
        self._stamps, self._rows = np.resize(self._stamps[kept], size), np.resize(self._rows[kept], (size, self._width))
        self._begin, self._end = 0, count
