"""Causes that are seen in the readings themselves: no motion shows them, so no simulation of it can name them.

An encoder with coarser steps than its file says reads on a grid, and the grid is measured. A torque sensor is compared
with the command over the tick that ended at the sample, tau = gain u + torque, by least squares where the drive does
not saturate. A reading that follows its command badly is left alone: then it tells of the joint, not of the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import TorqueMotor
from via_core.signals import Array
from via_sim.effects import Effect

from via_gap.logs.checks import COARSE, step_of
from via_gap.logs.log import JointLog

SURE = 8.0  # standard deviations from which a gain or a bias is taken for real
LEAST_GAIN, LEAST_BIAS = 0.02, 0.003  # [-], times the command's standard deviation: what is worth a name
FOLLOWS = 0.25  # of the variance of a torque that may be left by its command and a straight line
FULL = 0.98  # of the drive's limit from which its torque is not what was commanded
LATE = range(6)  # samples by which a reading may follow its command


@dataclass(frozen=True)
class SensorError:
    """An error of one sensor.

    sd    standard deviation of each parameter, as if the sensor's noise were white
    left  of the squared error of the reading once it is put right
    """

    effect: Effect
    sd: dict[str, float]
    left: float


def sensor_errors(logs: Sequence[JointLog]) -> tuple[SensorError, ...]:
    """Everything that the readings of these logs (of one device) alone show, the surest first."""
    return tuple(sorted((*_coarse(logs), *_scaled(logs)), key=lambda each: each.left))


def _coarse(logs: Sequence[JointLog]) -> list[SensorError]:
    device, found = logs[0].device, []
    for axis in range(1 + device.n_motors):
        told = device.sensors.link_quantum if axis == 0 else device.sensors.motor_quantum
        steps = [step_of(column) for log in logs if (column := _angle(log, axis)) is not None]
        if not told or not steps or min(steps) <= COARSE * told:
            continue
        step = float(np.median(steps))
        effect = Effect("encoder_quantisation", "sensor", {"quantum": step}, axis)
        found.append(SensorError(effect, {"quantum": 1e-3 * step}, (told / step) ** 2))
    return found


def _angle(log: JointLog, axis: int) -> Array | None:
    """(N,) [rad] of an encoder that was recorded and is believed."""
    if axis == 0:
        return log.measured["q"]
    return log.measured["theta"][:, axis - 1] if log.motors_seen[axis - 1] else None


def _scaled(logs: Sequence[JointLog]) -> list[SensorError]:
    device, found = logs[0].device, []
    if device.drive != "torque":
        return []
    for motor in range(device.n_motors):
        pairs = [each for log in logs if (each := _command_and_reading(log, motor)) is not None]
        if not pairs:
            continue
        asked, read = (np.concatenate(each) for each in zip(*pairs, strict=True))
        design = np.column_stack([asked, np.ones_like(asked)])
        covariance = np.linalg.pinv(design.T @ design)
        gain, bias = covariance @ design.T @ read
        left = float(np.mean((read - gain * asked - bias) ** 2))
        if left > FOLLOWS * float(np.var(read)):
            continue
        sd_gain, sd_bias = np.sqrt(np.diag(covariance) * left)
        before = max(float(np.mean((read - asked) ** 2)), 1e-300)
        named = []
        if abs(gain - 1.0) > max(LEAST_GAIN, SURE * sd_gain):
            named.append(("torque_gain", "gain", float(gain), float(sd_gain)))
        if abs(bias) > max(LEAST_BIAS * float(np.std(asked)), SURE * sd_bias):
            named.append(("torque_bias", "torque", float(bias), float(sd_bias)))
        for name, parameter, value, sd in named:
            effect = Effect(name, "sensor", {parameter: value}, motor + 1)
            found.append(SensorError(effect, {parameter: sd}, min(left / before, 1.0)))
    return found


def _command_and_reading(log: JointLog, motor: int) -> tuple[Array, Array] | None:
    """(n,) [N m] each, of the samples at which the drive was inside its limit; None where either was not recorded."""
    commands = log.commands
    if commands is None or "motor" not in commands or "tau" not in log.measured:
        return None
    drive = log.device.motors[motor]
    limit = drive.torque_limit if isinstance(drive, TorqueMotor) and drive.torque_limit is not None else np.inf
    tau, asked = log.measured["tau"][:, motor], commands["motor"][:, motor]
    seen = np.isfinite(tau)
    if seen.sum() < 100 or len(commands) < 2:
        return None
    time, tau = log.measured.time[seen], tau[seen]
    period = float(np.median(np.diff(log.measured.time)))
    each = []
    for late in LATE:  # the torque of a sample is that of the tick which ended there
        at = np.clip(np.searchsorted(commands.time, time - (late + 0.5) * period, side="right") - 1, 0, None)
        each.append(asked[at])
    best = max(each, key=lambda values: abs(float(np.cov(values, tau)[0, 1])) / max(float(np.std(values)), 1e-300))
    inside = np.isfinite(best) & (np.abs(best) < FULL * limit)
    return (best[inside], tau[inside]) if inside.sum() >= 100 and np.ptp(best[inside]) > 0.0 else None
