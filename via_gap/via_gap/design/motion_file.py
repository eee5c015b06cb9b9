"""Commands as a file: the table of `via_core.command_files`, or a bag that can be played to simulator and robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from via_core.bags.messages import command_messages
from via_core.bags.writer import BagWriter
from via_core.command_files import columns_of, write_table
from via_core.devices import Device
from via_core.signals import Array, Signals
from via_core.wire import VSA_COMMAND


def write_motion(path: Path, device: Device, commands: Signals, reference: Array | None = None) -> None:
    """A table for `.csv`, else a new bag folder. Raises ViaError where it cannot be written.

    reference  (N, m) [rad] motor angles that the node `excitation` follows; a bag has none
    """
    if path.suffix.lower() == ".csv":
        write_table(path, commands.time, columns_of(commands) | references(reference))
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


def references(angles: Array | None) -> dict[str, Array]:
    """Columns of motor angles (N, m) as `via_core.command_files.read_references` reads them; none for None."""
    return {} if angles is None else {f"reference_{i + 1}": column for i, column in enumerate(angles.T)}
