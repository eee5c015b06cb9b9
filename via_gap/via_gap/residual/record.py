"""A log of one joint as input of its equations: angles, velocities, and the commands or torques of its drives."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import ArrayLike
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Array, Signals, locked
from via_sim.joint.torques import M1, N_COMMANDS
from via_sim.simulate import command_rows

from via_gap.residual.zero_order_hold import ZeroOrderHold

STILL = 0.02  # [rad/s] default speed below which an axis counts as at standstill


@dataclass(frozen=True, eq=False)
class Record:
    """A log of one joint as input of its equations.

    time          (N,) [s] strictly increasing
    angle         (N, 3) [rad] link, motor 1, motor 2 as measured; NaN where not measured
    velocity      (N, 3) [rad/s] likewise, measured or estimated
    command_time  (K,) [s] strictly increasing; the first command also acts before it
    commands      (K, N_COMMANDS) as zero-order hold, columns as of the simulator
    sensed        whether the motor torques among them were measured; then errors of their sensors are undone
    still         (3,) [rad/s] speed below which each axis counts as at standstill
    hold          the same commands as means over samples

    Arrays are copied and locked. Raises SignalError where shapes or values do not fit.
    """

    time: Array
    angle: Array
    velocity: Array
    command_time: Array
    commands: Array
    sensed: bool = False
    still: ArrayLike = STILL
    hold: ZeroOrderHold = field(init=False, repr=False)

    def __post_init__(self) -> None:
        still = np.broadcast_to(np.asarray(self.still, dtype=np.float64), (3,))
        object.__setattr__(self, "still", locked(still, "still"))
        for name in ("time", "angle", "velocity", "command_time", "commands"):
            object.__setattr__(self, name, locked(getattr(self, name), name))
        shapes: dict[str, tuple[int, ...]] = {"angle": (len(self), 3), "velocity": (len(self), 3)}
        shapes |= {"time": (len(self),), "command_time": (len(self.commands),)}
        shapes["commands"] = (len(self.command_time), N_COMMANDS)
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise SignalError(f"'{name}' of a record must have shape {shape}, got {getattr(self, name).shape}")
        for name in ("time", "command_time"):
            if len(getattr(self, name)) < 1 or not np.all(np.diff(getattr(self, name)) > 0.0):
                raise SignalError(f"'{name}' of a record must increase and have at least one entry")
        if not np.all(np.isfinite(self.commands)):
            raise SignalError("commands of a record must be finite")
        hold = ZeroOrderHold(self.time, self.command_time, self.commands, self.sensed)
        object.__setattr__(self, "hold", hold)

    def __len__(self) -> int:
        return len(self.time)

    @staticmethod
    def of_commands(device: Device, measured: Signals, velocity: ArrayLike, commands: Signals, still: ArrayLike = STILL
    ) -> Record:  # fmt: skip
        """A record driven by commands, with the channels of `via_sim.simulate.command_rows`."""
        rows = command_rows(device, commands, commands.time)
        return Record(measured.time, _angles(device, measured), np.asarray(velocity), commands.time, rows, False, still)

    @staticmethod
    def of_torques(
        device: Device, measured: Signals, velocity: ArrayLike, commands: Signals | None, still: ArrayLike = STILL
    ) -> Record:
        """A record driven by the measured motor torques `tau`; `tau` of sample k acted since sample k-1.

        commands  may hold damping, external torque, neighbour and arm torque; other channels are ignored
        """
        if device.drive == "position":
            raise SignalError(f"'{device.name}' has a position drive: its record needs commands, not measured torques")
        tau = measured["tau"].reshape(len(measured), -1)
        seen = np.isfinite(tau).all(axis=1)
        if not seen.any():
            raise SignalError("no motor torque was measured")
        ends, torques = measured.time[seen], tau[seen]
        begins = np.concatenate(([ends[0] - 1.0], ends[:-1])) if len(ends) else ends
        times, rows = begins, np.zeros((len(begins), N_COMMANDS))
        beside = {"damping", "external_torque", "neighbour", "arm_torque"}
        others = None if commands is None else beside & commands.channels.keys()
        if commands is not None and others:
            times = np.union1d(begins, commands.time)
            rows = command_rows(device, commands.select(sorted(others)), times)
        last = np.clip(np.searchsorted(begins, times, side="right") - 1, 0, len(begins) - 1)
        rows[:, M1 : M1 + tau.shape[1]] = torques[last]
        return Record(measured.time, _angles(device, measured), np.asarray(velocity), times, rows, True, still)


def _angles(device: Device, measured: Signals) -> Array:
    angle = np.full((len(measured), 3), nan)
    angle[:, 0] = measured["q"]
    if device.n_motors and "theta" in measured:
        angle[:, 1 : 1 + device.n_motors] = measured["theta"].reshape(len(measured), -1)
    return angle
