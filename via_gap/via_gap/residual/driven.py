"""Commands that drive the simulation of a log: recorded ones, or measured torques in their place."""

from __future__ import annotations

import numpy as np
from via_core.signals import Array
from via_sim.joint.layout import EXTERNAL, N_COMMANDS
from via_sim.simulate import command_rows

from via_gap.logs.between import acting, along
from via_gap.logs.log import JointLog

BESIDE_MOTORS = ("damping", "external_torque", "neighbour", "arm_torque")  # commands that do not drive motors


def drive_rows(log: JointLog, grid: Array) -> Array:
    """Command rows (T, 4): recorded commands; without commands of the motors, the measured torque over each tick."""
    rows = np.zeros((len(grid), N_COMMANDS))
    whole = acting(log, grid)
    if whole is not None and not log.motors_commanded:
        whole = whole.select([name for name in whole.channels if name in BESIDE_MOTORS])
    if whole is not None and len(whole) and whole.channels:
        rows = command_rows(log.device, whole, grid)
    if columns := measured_columns(log):
        rows[:, columns] = _torque_after(log, grid)[:, : len(columns)]
    return rows


def measured_columns(log: JointLog) -> list[int]:
    """Columns of the commands for which measured torques stand in."""
    if log.device.n_motors:
        return [] if log.motors_commanded else list(range(log.device.n_motors))
    commanded = log.commands is not None and "external_torque" in log.commands and not log.command_measured
    return [EXTERNAL] if log.device.drive == "torque" and not commanded and log.torque is not None else []


def measured_torque(log: JointLog) -> tuple[Array, Array]:
    """Times (N,) [s] of measured torques (N, m) [N m] that drive the simulation."""
    if "tau" in log.measured:
        time, tau = log.measured.time, log.measured["tau"]
    else:  # a column of torques that is read as command
        assert log.commands is not None
        time, tau = log.commands.time, log.commands["external_torque"][:, None]
    seen = np.isfinite(tau).all(axis=1)
    return time[seen], tau[seen]


def _torque_after(log: JointLog, grid: Array) -> Array:
    """Measured torque (T, m) over the tick that begins at each of `grid`.

    The torque of a sample is that of the tick before it, or an instantaneous value if torques are interpolated.
    """
    time, tau = measured_torque(log)
    middle = grid + 0.5 * (grid[1] - grid[0])
    if log.lined is not None:
        return along(middle - log.lined, time, tau)
    return tau[np.clip(np.searchsorted(time, middle), 0, len(time) - 1)]
