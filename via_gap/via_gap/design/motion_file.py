"""Commands as a file: a table with the columns of a log, or a bag that can be played to simulator and robot.

A table has `time` [s] and motor_1, motor_2 [N m], or equilibrium, preset [rad] and damping [-], or external_torque
[N m] for a rigid joint. Each row holds until the next.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from via_core.bags.messages import command_messages
from via_core.bags.writer import BagWriter
from via_core.devices import Device
from via_core.errors import SignalError, ViaError
from via_core.signals import Array, Signals
from via_core.wire import VSA_COMMAND

from via_gap.logs.log import read_table

COMMAND_UNITS = {"equilibrium": "rad", "preset": "rad", "damping": "-", "external_torque": "N m", "motor": "N m"}


def columns_of(signals: Signals) -> dict[str, Array]:
    """Columns by header: a channel of several motors becomes name_1, name_2."""
    columns: dict[str, Array] = {}
    for name, values in signals.channels.items():
        each = {f"_{i + 1}": column for i, column in enumerate(values.T)} if values.ndim > 1 else {"": values}
        columns |= {name + number: column for number, column in each.items()}
    return columns


def write_motion(path: Path, device: Device, commands: Signals) -> None:
    """A table for `.csv`, else a new bag folder. Raises ViaError where it cannot be written."""
    if path.suffix.lower() == ".csv":
        write_table(path, commands.time, columns_of(commands))
        return
    columns = {name: commands[name] for name in ("equilibrium", "preset", "damping") if name in commands}
    torque = commands.channels.get("motor")
    if torque is None and not device.n_motors and "external_torque" in commands:
        torque = commands["external_torque"][:, None]
    if torque is not None:
        columns["motor"] = np.pad(torque, ((0, 0), (0, device.n_drives - torque.shape[1])))
    stamp = np.rint(commands.time * 1e9).astype(np.int64)
    with BagWriter(path) as bag:
        bag.add_topic(device.command_topic, VSA_COMMAND)
        for when, message in zip(stamp, command_messages(device.name, stamp, columns), strict=True):
            bag.write(device.command_topic, message, int(when))


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
    channels = {name: columns[name] for name in COMMAND_UNITS if name in columns}
    if motors:
        channels["motor"] = np.column_stack(motors)
    if not channels:
        raise SignalError(f"{path}: no column of commands; there are: {', '.join(header)}")
    try:
        return Signals(columns["time"], channels, COMMAND_UNITS, frozenset(channels))
    except ViaError as error:
        raise SignalError(f"{path}: {error}") from None
