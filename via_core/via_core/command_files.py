"""Commands as a table of numbers, with the columns of a log.

`time` [s] and motor_1, motor_2 [N m], or equilibrium, preset [rad] and damping [-], or external_torque [N m] for a
rigid joint. Each row holds until the next. reference_1, reference_2 [rad] are the motor angles that the torques are
meant to give; a controller may correct the torques by them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from via_core.devices import Device
from via_core.errors import SignalError, ViaError
from via_core.signals import Array, Signals
from via_core.wire import REFERENCES, UNITS

COMMANDS = (*REFERENCES, "external_torque", "motor")  # channels
COMMAND_UNITS = {**UNITS, "motor": "N m"}


def read_table(path: Path) -> tuple[list[str], dict[str, Array]]:
    """Header and columns (N,) of a table of numbers, in any format of `via_core.recordings`. Raises SignalError."""
    from via_core.recordings.tables import numbers, read_tables

    frame = next(iter(read_tables(path).values()))
    try:
        return list(frame.columns), {name: numbers(frame, name) for name in frame.columns}
    except SignalError as error:
        raise SignalError(f"{path}: {error}") from None


def columns_of(signals: Signals) -> dict[str, Array]:
    """Columns by header: a channel of several motors becomes name_1, name_2."""
    columns: dict[str, Array] = {}
    for name, values in signals.channels.items():
        each = {f"_{i + 1}": column for i, column in enumerate(values.T)} if values.ndim > 1 else {"": values}
        columns |= {name + number: column for number, column in each.items()}
    return columns


def write_table(path: Path, time: Array, columns: dict[str, Array]) -> None:
    """Columns of numbers with a header. Raises SignalError where it cannot be written."""
    try:
        with path.open("w", encoding="utf-8") as file:
            file.write(",".join(["time", *columns]) + "\n")
            np.savetxt(file, np.column_stack([time, *columns.values()]), fmt="%.9g", delimiter=",")
    except OSError as error:
        raise SignalError(f"cannot write {path}: {error.strerror}") from None


def read_motion(path: Path, device: Device) -> Signals:
    """Commands of a table. Raises SignalError in one line if it is none."""
    header, columns = read_table(path)
    if "time" not in columns or not len(columns["time"]):
        raise SignalError(f"{path}: no column 'time' with numbers; there are: {', '.join(header) or 'none'}")
    motors = [columns[f"motor_{i + 1}"] for i in range(device.n_motors) if f"motor_{i + 1}" in columns]
    channels = {name: columns[name] for name in COMMANDS if name in columns}
    if motors:
        channels["motor"] = np.column_stack(motors)
    if not channels:
        raise SignalError(f"{path}: no column of commands; there are: {', '.join(header)}")
    try:
        return Signals(columns["time"], channels, COMMAND_UNITS, frozenset(channels))
    except ViaError as error:
        raise SignalError(f"{path}: {error}") from None


def read_references(path: Path, device: Device) -> Array | None:
    """Motor angles (N, m) [rad] in the rows of a table, None without them. Raises SignalError for a wrong column."""
    _, columns = read_table(path)
    names = [f"reference_{i + 1}" for i in range(device.n_motors)]
    if not any(name in columns for name in names):
        return None
    for name in names:
        if name not in columns or not np.all(np.isfinite(columns[name])):
            raise SignalError(f"{path}: column '{name}' is missing or not finite")
    return np.column_stack([columns[name] for name in names])
