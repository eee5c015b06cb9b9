"""Recording of a run as in a laboratory: sensors, stamps, lost samples, and the bag or table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from via_core.bags.messages import Stream, command_messages, in_order, joint_messages
from via_core.bags.writer import BagWriter
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.signals import Array
from via_core.wire import JOINT_STATE, VSA_COMMAND

from via_validation.sealed.loop import read_angles
from via_validation.sealed.physics import Physics
from via_validation.sealed.recorder import Recorder, in_gaps
from via_validation.sealed.stepping import Drive, Run

PERFECT = Recorder()
LEVELS = ("full", "no_torque", "link_only", "encoder_and_command")
NEIGHBOUR = "neighbour_shaft_joint"
EPOCH = 1_700_000_000 * 1_000_000_000  # [ns] of the first tick of every log


@dataclass(frozen=True)
class Log:
    """Recorded signals. NaN: not measured."""

    time: Array  # (N,) [s] of the samples
    q: Array  # (N,) [rad]
    theta: Array  # (N, m) [rad]
    tau: Array  # (N, m) [N m] measured by the drive: mean over the tick that ends at the sample
    command_time: Array  # (K,) [s]
    commands: Array  # (K, m) [N m] or [rad]
    damping: Array  # (K,) [0..1]
    neighbour: Array  # (N,) [rad] of the preceding joint; NaN: there is none


def sense(
    rng: Generator, device: Device, physics: Physics, drive: Drive, run: Run, recorder: Recorder = PERFECT
) -> Log:
    """The log of a run with all signals, through its sensors.

    The log of a rigid joint is a table, with sample and command in each row.
    """
    motors, every = device.n_motors, recorder.every
    period = every / drive.rate
    ticks = np.arange(0, len(run.time), every)
    sampled = run.time[ticks]
    if not motors and every == 1:  # one loop samples, commands and writes the row
        ticks = np.append(np.flatnonzero(np.isfinite(run.commands[:, 0])), len(run.time) - 1)
        sampled = np.append(run.acted, run.time[-1])[ticks]
    count = len(ticks)
    noise = rng.standard_normal((count, motors)) * device.sensors.torque_noise
    jitter = np.clip(rng.standard_normal(count) * recorder.jitter, -0.3, 0.3) * period
    gone = np.zeros(count, dtype=np.bool_)
    for start in np.flatnonzero(rng.uniform(size=count) < recorder.lost / 2.0):
        gone[start : start + int(rng.integers(1, 4))] = True
    slips = np.cumsum(np.where(rng.uniform(size=count) < 0.25 * period, rng.choice([-1.0, 1.0], count), 0.0))
    gone[:20] = False
    sampled = sampled + jitter
    steps = (device.sensors.link_quantum or 0.0, *(device.sensors.motor_quantum or 0.0,) * motors)
    unread = rng.standard_normal((1 + motors, count)) * recorder.encoder_noise * np.array(steps)[:, None]
    q = read_angles(run.row, 0, _when(run, 0, sampled - physics.skew[0]) + physics.skipping * slips, unread[0])
    theta = np.empty((count, motors))
    for i in range(motors):
        theta[:, i] = read_angles(run.row, 1 + i, _when(run, 1 + i, sampled - physics.skew[1 + i]), unread[1 + i])
    tau = np.full((count, motors), np.nan)
    if device.drive == "torque" and motors:
        torque = _torque(run, ticks, recorder)
        tau = np.array(physics.sensed_gain[:motors]) * torque + np.array(physics.sensed_bias[:motors]) + noise
    neighbour = np.full(count, np.nan)
    if physics.neighbour_period:
        neighbour = neighbour_angle(physics.neighbour_period, sampled)
    time = sampled + np.clip(rng.standard_normal(count) * recorder.stamp_jitter, -0.2, 0.2) * period
    stamps, commands, damping = _commanded(drive, run, recorder)
    kept = np.ones(len(stamps), dtype=np.bool_)
    if recorder.gaps and recorder.gaps_in_log:
        kept = ~in_gaps(rng, recorder, stamps)
    if not motors:
        if recorder.stamped_due and every == 1:
            time = time - sampled + run.time[ticks]
        stamps, commands, damping = time, _table_commands(drive, run, recorder, ticks), np.zeros(count)
        if recorder.gaps and recorder.gaps_in_log:
            gone |= in_gaps(rng, recorder, time)
        kept = ~gone
    keep = ~gone
    return Log(
        time[keep], q[keep], theta[keep], tau[keep], stamps[kept], commands[kept], damping[kept], neighbour[keep]
    )


def _torque(run: Run, ticks: NDArray[np.int64], recorder: Recorder) -> Array:
    """(n, m) [N m] measured torque at each sample: mean over the period that ends there, or the last value before."""
    shown = np.zeros((len(ticks), run.last.shape[1]))
    if recorder.snapshot:
        shown[1:] = run.last[ticks[1:] - 1]
    else:
        shown[1:] = np.diff(np.vstack([shown[:1], np.cumsum(run.mean, axis=0)])[ticks], axis=0) / recorder.every
    return shown


def _commanded(drive: Drive, run: Run, recorder: Recorder) -> tuple[Array, Array, Array]:
    """Stamps (K,) [s], commands (K, m) and damper commands (K,) of the command topic."""
    given = np.flatnonzero(np.isfinite(run.commands[:, 0]))
    stamps = run.time[given] if recorder.stamped_due else run.acted[given]
    if recorder.snapshot and recorder.every > 1:
        first = np.searchsorted(given, np.arange(0, len(run.commands), recorder.every))
        given, stamps = given[first[first < len(given)]], stamps[first[first < len(given)]]
    return stamps, run.commands[given], drive.damping[given]


def _table_commands(drive: Drive, run: Run, recorder: Recorder, ticks: NDArray[np.int64]) -> Array:
    """(n, 1) command in each row of a rigid joint's table; the last row repeats the one before."""
    if drive.servo is not None or recorder.every == 1:
        commands = run.commands[ticks[:-1]]
    elif recorder.snapshot:
        commands = run.last[ticks[:-1]]
    else:
        ends = np.cumsum(np.vstack([np.zeros((1, 1)), run.mean]), axis=0)
        commands = np.diff(ends[ticks], axis=0) / recorder.every
    return np.vstack([commands, commands[-1:]])


def cut(log: Log, windows: Sequence[tuple[float, float]]) -> tuple[Log, ...]:
    """The parts of a log within the windows (begin, end) [s]."""
    parts = []
    for begin, end in windows:
        here = (log.time >= begin) & (log.time < end)
        commands = (log.command_time >= begin) & (log.command_time < end)
        parts.append(
            Log(
                log.time[here], log.q[here], log.theta[here], log.tau[here], log.command_time[commands],
                log.commands[commands], log.damping[commands], log.neighbour[here],
            )
        )  # fmt: skip
    return tuple(parts)


def neighbour_angle(period: float, time: Array) -> Array:
    """Angle [rad] of the preceding joint: a slow swing that starts from rest."""
    return 0.5 * np.sin(2.0 * pi * time / period) * np.minimum(time / period, 1.0)


def limited(log: Log, level: str) -> Log:
    """The log with only the signals of a signal set; the others are NaN."""
    theta = log.theta if level in ("full", "no_torque") else np.full_like(log.theta, np.nan)
    tau = log.tau if level in ("full", "link_only") else np.full_like(log.tau, np.nan)
    return replace(log, theta=theta, tau=tau)


def _when(run: Run, axis: int, time: Array) -> Array:
    """Angle [rad] of an axis between the ticks: cubic in angle and speed; at rest before the first."""
    period = run.time[1] - run.time[0]
    at = np.clip(time, run.time[0], run.time[-1])
    k = np.clip(((at - run.time[0]) / period).astype(np.int64), 0, len(run.time) - 2)
    u = (at - run.time[k]) / period
    x0, x1 = run.angle[k, axis], run.angle[k + 1, axis]
    v0, v1 = run.speed[k, axis] * period, run.speed[k + 1, axis] * period
    return x0 + u * (v0 + u * (3.0 * (x1 - x0) - 2.0 * v0 - v1 + u * (2.0 * (x0 - x1) + v0 + v1)))


def write_log(path: Path, device: Device, log: Log, positioned: bool = False) -> None:
    """Write the log as a ROS bag; for a rigid joint as a table, since no message contains its command.

    positioned  the commands are goals of a position drive
    """
    if device.motors:
        _write_bag(path, device, log)
        return
    commands = "equilibrium" if positioned else "external_torque"
    columns, names = [log.time, log.q, log.commands[:, 0]], ["time", "q", commands]
    if np.isfinite(log.neighbour).any():
        columns, names = [*columns, log.neighbour], [*names, "neighbour"]
    np.savetxt(path, np.column_stack(columns), fmt="%.12g", delimiter=",", header=",".join(names), comments="")


def _write_bag(path: Path, device: Device, log: Log) -> None:
    states = Stream("/joint_states", JOINT_STATE, *_states(device, log))
    commands = Stream(device.command_topic, VSA_COMMAND, *_commands(device, log))
    with BagWriter(path) as bag:
        for stream in (commands, states):
            bag.add_topic(stream.topic, stream.type_name)
        for topic, message, stamp in in_order(
            (states, commands)
        ):  # a command responds to the sample with the same stamp
            bag.write(topic, message, stamp)


def _states(device: Device, log: Log) -> tuple[NDArray[np.int64], list[bytes]]:
    names, unknown = [device.link_joint, *device.motor_joints], np.full(len(log.q), np.nan)
    columns = {"position": np.column_stack([log.q, log.theta]), "effort": np.column_stack([unknown, log.tau])}
    if np.isfinite(log.neighbour).any():
        names.append(NEIGHBOUR)
        columns["position"] = np.column_stack([columns["position"], log.neighbour])
        columns["effort"] = np.column_stack([columns["effort"], unknown])
    if not np.isfinite(columns["effort"]).any():
        del columns["effort"]
    stamp = _stamps(log.time)
    return stamp, joint_messages(device.name, names, stamp, columns)


def _commands(device: Device, log: Log) -> tuple[NDArray[np.int64], list[bytes]]:
    columns = {"damping": log.damping}
    if isinstance(device.motors[0], TorqueMotor):
        columns["motor"] = log.commands
    else:
        columns |= {"equilibrium": log.commands[:, 0], "preset": log.commands[:, 1]}
    stamp = _stamps(log.command_time)
    return stamp, command_messages(device.name, stamp, columns)


def _stamps(time: Array) -> NDArray[np.int64]:
    return EPOCH + np.rint(time * 1e9).astype(np.int64)
