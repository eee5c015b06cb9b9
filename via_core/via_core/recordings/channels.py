"""Signals of one joint from a recording that another tool wrote, by the columns that its device file names.

Columns with the names of VIA's channels (`time`, `q`, `theta_1`, `tau_1`, `equilibrium` ...) need no entry in the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from via_core.bags.joints import JointRecording, StampReport
from via_core.device_parts import WireColumn
from via_core.devices import Device
from via_core.errors import ParameterError, SignalError, ViaError
from via_core.recordings.guess import guess_time
from via_core.recordings.tables import Tables, is_bag, numbers, read_tables
from via_core.recordings.units import split_unit
from via_core.recordings.unnamed import require_names
from via_core.signals import Array, Indices, Signals
from via_core.stamps import ordered
from via_core.wire import LINK, MOTOR, UNITS

if TYPE_CHECKING:
    from pandas import DataFrame

CHANNEL_UNITS = {**UNITS, "motor": ""}
_CHANNEL = re.compile(rf"({'|'.join(CHANNEL_UNITS)})|({'|'.join([*MOTOR, 'motor'])})_([12])")
MEASURED = {*LINK, *MOTOR}


def read_joint(path: str | Path, device: Device) -> JointRecording:
    """Measurements and commands of `device` in a file. Raises ViaError in one line with the remedy."""
    path = Path(path)
    return joint_of(read_tables(path), device, str(path), is_bag(path))


def joint_of(tables: Tables, device: Device, file: str, bag: bool = False) -> JointRecording:
    """Measurements and commands of `device` in tables; `file` is the name in errors. Raises SignalError.

    The table with the link's angle is the time base of the measurements, that with the first command the time base of
    the commands. Other tables are interpolated, or their commands held.
    """
    source = _Source(tables, device, file, bag)
    columns = source.columns()
    origin: float | None = None
    reports: list[StampReport] = []
    signals: dict[bool, Signals] = {}
    for is_command in (False, True):
        mine = {name: each for name, each in columns.items() if (name[0] not in MEASURED) == is_command}
        for table in dict.fromkeys(each[0] for each in mine.values()):
            stamps = source.stamps(table, origin)
            if not (is_command or len(stamps.rows)):
                raise SignalError(f"{file}: no row has a time; write one row a sample")
            origin = stamps.begin if origin is None else origin
            counts = (len(tables[table]), 0, stamps.repeated, stamps.backward, len(stamps.rows))
            reports.append(StampReport(table, 0, *counts))
            part = source.signals(stamps, table, {name: entry for name, (t, entry) in mine.items() if t == table})
            signals[is_command] = part if is_command not in signals else signals[is_command].joined(part)
    if True not in signals:
        reports[0] = replace(reports[0], unread=_unread(tables, columns))
    turns = {name: entry.turn for name, (_, entry) in columns.items()}
    return JointRecording(signals[False], signals.get(True), tuple(reports)).made_continuous(turns)


Channel = tuple[str, int]  # name and number of the motor, 0: none


class _Stamps(NamedTuple):
    """Rows of a table in the order of their stamps."""

    time: Array  # (n,) [s] since the origin
    rows: Indices  # (n,)
    begin: float  # the first stamp, as the table has it
    repeated: int
    backward: int


@dataclass(frozen=True)
class _Source:
    """Tables of a recording, a device, and the name of the file in errors."""

    tables: Tables
    device: Device
    file: str
    bag: bool

    def columns(self) -> dict[Channel, tuple[str, WireColumn]]:
        """Table and column of every channel, the link's angle first. An entry of the file takes its column away."""
        entries = self.device.wire.columns
        wanted = {entry.column for entry in entries.values()}
        found: dict[Channel, tuple[str, WireColumn]] = {}
        for table, frame in self.tables.items():
            for name in map(str, frame.columns):
                parts = _CHANNEL.fullmatch(split_unit(name)[0])
                if parts and name not in wanted and not (self.bag and "." not in name):
                    found.setdefault(_channel(parts), (table, WireColumn(column=name)))
        lacking = f"for the link's angle q of '{self.device.name}'"
        for channel, entry in entries.items():
            parts = _CHANNEL.fullmatch(channel)
            if parts is None:
                continue
            there = [t for t, each in self.tables.items() if entry.column in each.columns and entry.topic in (None, t)]
            if there:
                found[_channel(parts)] = (there[0], entry)
            elif channel == "q":
                topic = f" on {entry.topic}" if entry.topic else ""
                lacking = f"'{entry.column}'{topic}, which wire.columns of '{self.device.name}' names as q"
        if ("q", 0) not in found:
            raise self._lacking(lacking, self.tables)
        count = max(self.device.n_motors, 1)
        kept = {channel: each for channel, each in found.items() if channel[1] <= count}
        return dict(sorted(kept.items(), key=lambda each: each[0] != ("q", 0)))

    def stamps(self, table: str, origin: float | None) -> _Stamps:
        """Rows of a table with increasing stamps; `origin` is where time is 0, None: at the first of them."""
        frame = self.tables[table]
        entry = self.device.wire.columns.get("time")
        if entry is None or entry.column not in frame.columns:
            if "time" in frame.columns:
                entry = WireColumn(column="time", unit="ns" if self.bag else None)
            else:
                guess = guess_time(frame)
                if guess is None or not guess.reason.startswith(("named", "unit")):
                    raise self._lacking("'time'", {"": frame})
                entry = WireColumn(column=guess.column, unit=guess.unit)
        stamps, begin = frame[entry.column].to_numpy(), origin or 0.0
        if stamps.dtype.kind in "iu":  # epoch times in ns: subtract before they become floats
            begin = int(stamps[0]) if origin is None and len(stamps) else int(begin)
            seconds = (stamps - begin).astype(np.float64) * entry.factor
        else:
            raw = entry.in_si(self._numbers(frame, entry.column))
            there = raw[np.isfinite(raw)]
            begin = there[0] if origin is None and len(there) else begin
            seconds = raw - begin
        kept, repeated, backward = ordered(seconds)
        rows = np.flatnonzero(kept)
        return _Stamps(seconds[rows], rows, begin, repeated, backward)

    def signals(self, stamps: _Stamps, table: str, columns: Mapping[Channel, WireColumn]) -> Signals:
        """The channels of a table, each at its stamps; a command stays until the next one."""
        frame, channels = self.tables[table].iloc[stamps.rows], dict[str, Array]()
        for (name, number), entry in columns.items():
            try:
                values = entry.in_si(self._numbers(frame, entry.column))
            except ParameterError as error:
                raise SignalError(f"{self.file}: column '{entry.column}': {error}") from None
            if entry.enable in frame.columns:
                values = np.where(self._numbers(frame, str(entry.enable)) != 0.0, values, np.nan)
            if number == 0:
                channels[name] = values
            else:
                empty = np.full((len(stamps.time), max(self.device.n_motors, 1)), np.nan)
                channels.setdefault(name, empty)[:, number - 1] = values
        try:
            return Signals(stamps.time, channels, CHANNEL_UNITS, frozenset(channels.keys() - MEASURED))
        except ViaError as error:
            raise SignalError(f"{self.file}: {error}") from None

    def _numbers(self, frame: DataFrame, column: str) -> Array:
        try:
            return numbers(frame, column)
        except SignalError as error:
            raise SignalError(f"{self.file}: {error}") from None

    def _lacking(self, what: str, tables: Tables) -> SignalError:
        """The error for a column that none of these tables has, with the remedy."""
        require_names(self.file, tables)
        every = ((table, column) for table, frame in tables.items() for column in frame.columns)
        names = [f"{column} on {table}" if table else str(column) for table, column in every]
        there = ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
        remedy = f"`via bag map {self.file}` shows what they may hold; name them under wire.columns of the device file"
        return SignalError(f"{self.file}: no column {what}; there are: {there or 'none'}; {remedy}")


def _channel(parts: re.Match[str]) -> Channel:
    """Name and number of a channel; one of the motors without a number is that of the first."""
    name = parts[1] or parts[2]
    return name, int(parts[3] or (name in (*MOTOR, "motor")))


def _unread(tables: Tables, columns: Mapping[Channel, tuple[str, WireColumn]]) -> tuple[str, ...]:
    """Names of the columns that neither a channel nor the time uses."""
    used = {(table, name) for table, entry in columns.values() for name in (entry.column, entry.enable)}
    times = {(table, guess.column) for table, frame in tables.items() if (guess := guess_time(frame)) is not None}
    every = ((table, str(name)) for table, frame in tables.items() for name in frame.columns)
    return tuple(name for table, name in every if (table, name) not in used | times)
