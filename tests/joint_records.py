"""Records of one joint from simulated measurements, driven by commands or by measured motor torques."""

import numpy as np
from via_core.errors import SignalError
from via_gap.residual.record import Record
from via_sim.joint.layout import M1, N_COMMANDS
from via_sim.simulate import command_rows

STILL = np.full(3, 0.02)  # [rad/s] error of the speeds that the tests give
BESIDE = {"damping", "external_torque", "neighbour", "arm_torque"}


def of_commands(device, measured, velocity, commands) -> Record:
    """A record driven by commands, with the channels of `via_sim.simulate.command_rows`."""
    rows = command_rows(device, commands, commands.time)
    return Record(measured.time, _angles(device, measured), np.asarray(velocity), commands.time, rows, still=STILL)


def of_torques(device, measured, velocity, commands) -> Record:
    """A record driven by the measured motor torques `tau`; `tau` of sample k acted since sample k-1.

    commands  may hold damping, external torque, neighbour and arm torque; other channels are ignored
    """
    tau = measured["tau"].reshape(len(measured), -1)
    seen = np.isfinite(tau).all(axis=1)
    if not seen.any():
        raise SignalError("no motor torque was measured")
    ends, torques = measured.time[seen], tau[seen]
    times = begins = np.concatenate(([ends[0] - 1.0], ends[:-1]))
    rows = np.zeros((len(begins), N_COMMANDS))
    others = BESIDE & commands.channels.keys() if commands is not None else ()
    if others:
        times = np.union1d(begins, commands.time)
        rows = command_rows(device, commands.select(sorted(others)), times)
    last = np.clip(np.searchsorted(begins, times, side="right") - 1, 0, len(begins) - 1)
    rows[:, M1 : M1 + tau.shape[1]] = torques[last]
    return Record(measured.time, _angles(device, measured), np.asarray(velocity), times, rows, True, STILL)


def _angles(device, measured) -> np.ndarray:
    angle = np.full((len(measured), 3), np.nan)
    angle[:, 0] = measured["q"]
    if device.n_motors and "theta" in measured:
        angle[:, 1 : 1 + device.n_motors] = measured["theta"].reshape(len(measured), -1)
    return angle
