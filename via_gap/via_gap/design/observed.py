"""What a log, or the default motion of a device, determines: `via_estimators.observability` for each signal set."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Array, Signals
from via_estimators.joint_equations import largest_torque
from via_estimators.joint_record import Record, columns_of, commands_of
from via_estimators.observability import Information, information_of

from via_gap.design.default_motion import DefaultMotion, default_motion
from via_gap.design.remedies import remedies
from via_gap.logs.log import JointLog
from via_gap.logs.noise import channel_noise, log_noise

FINEST = 1e-7  # [rad] noise of an angle whose sensor has no step
SPEED_NOISE = 0.02  # [rad/s] assumed of velocity sensors, which device files do not describe
TORQUE_SHARE = 1e-3  # of the largest torque of motors and springs: torque noise where the device file has none
EXACT = 1e-6  # [N m] noise of a torque that is commanded and taken as such
SEEN = 0.5  # least share of finite samples of a channel that counts as measured


@dataclass(frozen=True, eq=False)
class Observed:
    """One signal set along one motion.

    title     of the signal set
    channels  measured
    remedies  one sentence for each combination that is not determined, or for a missing signal
    """

    title: str
    channels: tuple[str, ...]
    information: Information
    remedies: tuple[str, ...]


def torque_noise_of(device: Device) -> float:
    """[N m] standard deviation of a measured motor torque: by the device file, else a share of the largest torque."""
    if device.sensors.torque_noise > 0.0:
        return device.sensors.torque_noise
    return max(TORQUE_SHARE * largest_torque(device), EXACT)


def declared_noise(device: Device, torque_noise: float | None = None) -> dict[str, float]:
    """Standard deviation of one sample of each channel by the device file; `torque_noise` [N m] replaces the file's."""
    sensors = device.sensors
    link = (sensors.link_quantum or 0.0) / sqrt(12.0) or FINEST
    motor = (sensors.motor_quantum or 0.0) / sqrt(12.0) or FINEST
    torque = torque_noise or torque_noise_of(device)
    noise = {"q": link, "q_velocity": SPEED_NOISE, "tau_link": sensors.link_torque_noise or torque}
    for i in range(1, device.n_drives + 1):
        noise |= {f"theta_{i}": motor, f"theta_velocity_{i}": SPEED_NOISE, f"tau_{i}": torque}
    return noise


def signal_sets(device: Device) -> dict[str, tuple[str, ...]]:
    """The signal sets that a user of this kind of joint may have, by their names."""
    if device.n_motors and device.drive == "torque":
        return {
            "angles and motor torques": ("q", "theta", "tau"),
            "angles": ("q", "theta"),
            "angles and joint torque": ("q", "theta", "tau_link"),
            "angles, velocities, all torques": ("q", "theta", "tau", "tau_link", "q_velocity", "theta_velocity"),
        }
    if device.n_motors:
        return {"angles": ("q", "theta"), "angles and joint torque": ("q", "theta", "tau_link")}
    sets: dict[str, tuple[str, ...]] = {"link angle": ("q",)} if device.drive == "position" else {}
    sets["link angle and drive torque"] = ("q", "tau")
    if device.damper is not None:
        sets["link angle and joint torque"] = ("q", "tau_link")
    return sets


def observe_default(device: Device, torque_noise: float | None = None) -> tuple[DefaultMotion, list[Observed]]:
    """The default motion of a device and what it determines with each signal set.

    Raises ParameterError where no motion fits the device.
    """
    motion = default_motion(device)
    measured = motion.simulation.measured
    columns = columns_of(measured, device)
    if not device.n_motors:
        columns |= {"tau_1": _drive_torque(device, motion)}
    noise, commands = declared_noise(device, torque_noise), commands_of(motion.commands, device, measured.time)
    record = Record(measured.time, columns, commands, noise)
    found = []
    for title, channels in signal_sets(device).items():
        chosen = record.with_channels(channels)
        information = information_of(device, chosen, noisy=False)
        found.append(Observed(title, tuple(chosen.channels), information, remedies(device, chosen, information)))
    return motion, found


def observe_log(log: JointLog) -> Observed:
    """What a log determines, with its motion, sampling, missing channels and noise.

    Raises SignalError where no samples are left.
    """
    record = record_of(log)
    information = information_of(log.device, record, noisy=True)
    title = ", ".join(record.channels)
    return Observed(title, tuple(record.channels), information, remedies(log.device, record, information))


def record_of(log: JointLog) -> Record:
    """The samples of a log in which all measured channels are finite, with the noise that the log itself shows."""
    device, time = log.device, log.measured.time
    columns = columns_of(log.measured, device)
    if not device.n_motors and device.drive == "torque" and "tau_1" not in columns and log.commands is not None:
        period = float(np.median(np.diff(time)))  # a sample has the torque of the interval that it ends
        if "external_torque" in log.commands:
            held = Signals(
                log.commands.time, log.commands.channels, log.commands.units, frozenset(log.commands.channels)
            )
            columns["tau_1"] = held.resample(time - 0.5 * period)["external_torque"]
    seen = {name: x for name, x in columns.items() if np.isfinite(x).mean() >= SEEN and np.ptp(x[np.isfinite(x)]) > 0.0}
    there = np.ones(len(time), dtype=np.bool_)
    for values in seen.values():
        there &= np.isfinite(values)
    if not there.any():
        raise SignalError(f"{log.name}: no sample has all of {', '.join(seen) or 'its channels'}")
    shown, noise = log_noise(log).channels, declared_noise(device)
    for name, values in seen.items():
        found = shown[name] if name in shown else channel_noise(time, values)
        commanded = name == "tau_1" and "tau" not in log.measured
        noise[name] = EXACT if commanded else max(found.sd, FINEST)
    commands = {name: values[there] for name, values in commands_of(log.commands, device, time).items()}
    finite = {name: x for name, x in commands.items() if name == "goal" or np.all(np.isfinite(x))}
    return Record(time[there], {name: x[there] for name, x in seen.items()}, finite, noise)


def _drive_torque(device: Device, motion: DefaultMotion) -> Array:
    """Torque (N,) [N m] of a rigid joint's drive in a simulated motion."""
    measured = motion.simulation.measured
    if device.servo is None:
        return motion.commands.resample(measured.time)["external_torque"]
    goal = commands_of(motion.commands, device, measured.time)["goal"]
    torque = device.servo.torque(goal - measured["q"], measured["q_velocity"])
    return np.where(np.isfinite(goal), torque, 0.0)
