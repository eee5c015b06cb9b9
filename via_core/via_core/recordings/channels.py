"""Signals of one joint from a recording that another tool wrote, by the columns that its device file names.

Columns with the names of VIA's channels (`time`, `q`, `theta_1`, `tau_1`, `equilibrium` ...) need no entry in the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from via_core.bags.joints import JointRecording, StampReport
from via_core.device_parts import WireColumn
from via_core.devices import Device
from via_core.errors import ParameterError, SignalError, ViaError
from via_core.recordings.guess import guess_time
from via_core.recordings.tables import Tables, is_bag, numbers, read_tables
from via_core.signals import Array, Indices, Signals
from via_core.stamps import ordered
from via_core.wire import LINK, MOTOR, UNITS

if TYPE_CHECKING:
    from pandas import DataFrame

CHANNEL_UNITS = {**UNITS, "motor": "", "external_torque": "N m", "neighbour": "rad"}
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
    columns = _columns(tables, device, file, bag)
    if ("q", 0) not in columns:
        own = _available(tables, bag)
        raise SignalError(
            f"{file}: no column for the link's angle q of '{device.name}'; there are: {own}{_hint(file, device)}"
        )
    origin: float | None = None
    reports: list[StampReport] = []
    signals: dict[bool, Signals] = {}
    for is_command in (False, True):
        mine = {name: each for name, each in columns.items() if (name[0] not in MEASURED) == is_command}
        for table in dict.fromkeys(each[0] for each in mine.values()):
            time, rows, report = _time(tables[table], device, file, table, bag, origin)
            if not (is_command or len(rows)):
                raise SignalError(f"{file}: no row has a time; write one row a sample")
            origin = report[0] if origin is None else origin
            reports.append(StampReport(table, 0, len(tables[table]), 0, report[1], report[2], len(rows)))
            named = {n: e for n, (t, e) in mine.items() if t == table}
            part = _signals(time, tables[table].iloc[rows], named, device, file, is_command)
            signals[is_command] = part if is_command not in signals else signals[is_command].joined(part)
    if True not in signals:
        reports[0] = replace(reports[0], unread=_unread(tables, columns))
    turns = {name: entry.turn for name, (_, entry) in columns.items()}
    return JointRecording(signals[False], signals.get(True), tuple(reports)).made_continuous(turns)


Channel = tuple[str, int]  # name and number of the motor, 0: none


def _columns(tables: Tables, device: Device, file: str, bag: bool) -> dict[Channel, tuple[str, WireColumn]]:
    """Table and column of every channel, the link's angle first. An entry of the file takes its column away."""
    entries = device.wire.columns
    wanted = {entry.column for entry in entries.values()}
    found: dict[Channel, tuple[str, WireColumn]] = {}
    for table, frame in tables.items():
        for name in map(str, frame.columns):
            parts = _CHANNEL.fullmatch(name)
            if parts and name not in wanted and not (bag and "." not in name):
                found.setdefault(_channel(parts), (table, WireColumn(column=name)))
    missing = []
    for channel, entry in entries.items():
        parts = _CHANNEL.fullmatch(channel)
        if parts is None:
            continue
        there = [t for t, frame in tables.items() if entry.column in frame.columns and entry.topic in (None, t)]
        if there:
            found[_channel(parts)] = (there[0], entry)
        elif channel == "q":
            missing.append(f"'{entry.column}'" + (f" on {entry.topic}" if entry.topic else ""))
    if missing and ("q", 0) not in found:
        raise SignalError(
            f"{file}: no column {missing[0]}, which wire.columns of '{device.name}' names as q; there are: "
            f"{_available(tables, bag)}{_hint(file, device)}"
        )
    count = max(device.n_motors, 1)
    kept = {channel: each for channel, each in found.items() if channel[1] <= count}
    return dict(sorted(kept.items(), key=lambda each: each[0] != ("q", 0)))


def _channel(parts: re.Match[str]) -> Channel:
    return parts[1] or parts[2], int(parts[3] or 0)


def _time(
    frame: DataFrame, device: Device, file: str, table: str, bag: bool, origin: float | None
) -> tuple[Array, Indices, tuple[float, int, int]]:
    """Stamps [s] since the origin, rows with increasing stamps, and origin, repeated and backward stamps."""
    entry = device.wire.columns.get("time")
    if entry is None or entry.column not in frame.columns:
        if "time" in frame.columns:
            entry = WireColumn(column="time", unit="ns" if bag else None)
        else:
            guess = guess_time(frame)
            if guess is None or not guess.reason.startswith(("named", "unit")):
                own = ", ".join(map(str, frame.columns))
                raise SignalError(f"{file}: no column 'time'; there are: {own or 'none'}{_hint(file, device)}")
            entry = WireColumn(column=guess.column, unit=guess.unit)
    begin: float
    stamps = frame[entry.column].to_numpy()
    first: Any = 0
    if stamps.dtype.kind in "iu":  # epoch times in ns: subtract before they become floats
        first = int(stamps[0]) if origin is None and len(stamps) else int(origin or 0)
        seconds = (stamps - first).astype(np.float64) * entry.factor
        begin = first
    else:
        raw = _numbers(frame, entry.column, file) * entry.factor + entry.offset
        there = raw[np.isfinite(raw)]
        begin = there[0] if origin is None and len(there) else origin or 0.0
        seconds = raw - begin
    kept, repeated, backward = ordered(seconds)
    rows = np.flatnonzero(kept)
    return seconds[rows], rows, (begin, repeated, backward)


def _signals(
    time: Array, frame: DataFrame, columns: Mapping[Channel, WireColumn], device: Device, file: str, held: bool
) -> Signals:
    channels: dict[str, Array] = {}
    for (name, number), entry in columns.items():
        try:
            scale = entry.factor
        except ParameterError as error:
            raise SignalError(f"{file}: column '{entry.column}': {error}") from None
        values = _numbers(frame, entry.column, file)
        if (scale, entry.offset) != (1.0, 0.0):
            values = scale * values + entry.offset
        if entry.enable in frame.columns:
            values = np.where(_numbers(frame, str(entry.enable), file) != 0.0, values, np.nan)
        if number == 0:
            channels[name] = values
        else:
            at = channels.setdefault(name, np.full((len(time), max(device.n_motors, 1)), np.nan))
            at[:, number - 1] = values
    try:
        return Signals(time, channels, CHANNEL_UNITS, frozenset(channels) if held else frozenset())
    except ViaError as error:
        raise SignalError(f"{file}: {error}") from None


def _numbers(frame: DataFrame, column: str, file: str) -> Array:
    try:
        return numbers(frame, column)
    except SignalError as error:
        raise SignalError(f"{file}: {error}") from None


def _unread(tables: Tables, columns: Mapping[Channel, tuple[str, WireColumn]]) -> tuple[str, ...]:
    """Names of the columns that neither a channel nor the time uses."""
    used = {(table, name) for table, entry in columns.values() for name in (entry.column, entry.enable)}
    times = {(table, guess.column) for table, frame in tables.items() if (guess := guess_time(frame)) is not None}
    every = ((table, str(name)) for table, frame in tables.items() for name in frame.columns)
    return tuple(name for table, name in every if (table, name) not in used | times)


def _available(tables: Tables, bag: bool) -> str:
    names = [
        f"{column} on {table}" if table else str(column) for table, frame in tables.items() for column in frame.columns
    ]
    return ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "") or "none"


def _hint(file: str, device: Device) -> str:
    return f"; `via bag map {file}` shows what they may hold and writes the entries for wire.columns"
