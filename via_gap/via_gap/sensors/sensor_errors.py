"""Sensor errors that the measurements themselves show: they leave the motion unchanged, so no simulation reveals them.

Coarse encoder steps are read off the grid of the measured angles. A torque sensor is compared with the command over the
tick that ended at the sample, tau = gain u + torque, by least squares where the drive does not saturate, in both
directions: which of the two contains the noise is not known. A measurement that follows its command badly is not used,
because it depends on the joint and not only on the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from via_core.device_parts import TorqueMotor
from via_core.encoder_steps import step_of
from via_core.signals import Array
from via_sim.effects import Effect

from via_gap.logs.checks import COARSE
from via_gap.logs.log import JointLog, angle_of

SURE = 8.0  # standard deviations from which a gain or bias error is significant
LEAST_GAIN, LEAST_BIAS = 0.02, 0.003  # [-], times the command's standard deviation: smallest reported errors
FOLLOWS = 0.25  # largest share of a torque's variance that the regression on its command may leave
FULL = 0.98  # of the drive's limit: above it the drive saturates
LATE = range(6)  # samples by which a measurement may lag its command


@dataclass(frozen=True)
class SensorError:
    """An error of one sensor.

    sd    standard deviation of each parameter, for white noise in the torque or in its command
    left  share of the squared measurement error that remains after the correction
    size  [N m] root mean square of the measurement error of a torque sensor that is corrected; 0: an angle
    """

    effect: Effect
    sd: dict[str, float]
    left: float
    size: float = 0.0


def sensor_errors(logs: Sequence[JointLog]) -> tuple[SensorError, ...]:
    """All sensor errors that the measurements of these logs (of one device) show, the most certain first."""
    return tuple(sorted((*_coarse(logs), *_scaled(logs)), key=lambda each: each.left))


def _coarse(logs: Sequence[JointLog]) -> list[SensorError]:
    device, found = logs[0].device, []
    for axis in range(1 + device.n_motors):
        filed = device.sensors.link_quantum if axis == 0 else device.sensors.motor_quantum
        steps = [step_of(angle_of(log, axis)) for log in logs if axis == 0 or log.motors_seen[axis - 1]]
        if not filed or not steps or min(steps) <= COARSE * filed:
            continue
        step = float(np.median(steps))
        effect = Effect("encoder_quantisation", "sensor", {"quantum": step}, axis)
        found.append(SensorError(effect, {"quantum": 1e-3 * step}, (filed / step) ** 2))
    return found


def _scaled(logs: Sequence[JointLog]) -> list[SensorError]:
    device, found = logs[0].device, []
    if device.drive != "torque":
        return []
    for motor in range(device.n_motors):
        pairs = [each for log in logs if (each := _command_and_torque(log, motor)) is not None]
        if not pairs:
            continue
        commanded, measured = (np.concatenate(each) for each in zip(*pairs, strict=True))
        gains, biases, noise = _lines(commanded, measured)
        left = float(np.mean((measured - gains[0] * commanded - biases[0]) ** 2))
        if left > FOLLOWS * float(np.var(measured)):
            continue
        before = max(float(np.mean((measured - commanded) ** 2)), 1e-300)
        for name, parameter, ends, sd, neutral, least in (
            ("torque_gain", "gain", gains, noise[0], 1.0, LEAST_GAIN),
            ("torque_bias", "torque", biases, noise[1], 0.0, LEAST_BIAS * float(np.std(commanded))),
        ):
            if max(ends.min() - neutral, neutral - ends.max()) > max(least, SURE * sd):
                effect = Effect(name, "sensor", {parameter: float(ends.mean())}, motor + 1)
                share, size = min(left / before, 1.0), float(np.sqrt(max(before - left, 0.0)))
                sd = float(np.hypot(sd, np.ptp(ends) / sqrt(12.0)))
                found.append(SensorError(effect, {parameter: sd}, share, size))
    return found


def _lines(commanded: Array, measured: Array) -> tuple[Array, Array, tuple[float, float]]:
    """Gains (2,) and biases (2,) of two regressions, with all noise in the torque or all in the command, and their sd.

    Noise in the command makes the first gain too small, noise in the torque the second one too large: commands that
    jitter between the samples of a log are no error of a sensor.
    Source: R. Frisch, Statistical confluence analysis by means of complete regression systems (1934).
    """
    (of_command, both), (_, of_torque) = np.cov(commanded, measured)
    gains = np.array([both / of_command, of_torque / both])
    centre = float(commanded.mean())
    left = max(of_torque - gains[0] * both, 0.0) / len(commanded)
    noise = float(np.sqrt(left / of_command)), float(np.sqrt(left * (1.0 + centre**2 / of_command)))
    return gains, measured.mean() - gains * centre, noise


def _command_and_torque(log: JointLog, motor: int) -> tuple[Array, Array] | None:
    """(n,) [N m] each, at samples inside the drive's limit; None where either was not recorded."""
    if log.commands is None or len(log.commands) < 2 or "tau" not in log.measured:
        return None
    drive = log.device.motors[motor]
    limit = drive.torque_limit if isinstance(drive, TorqueMotor) and drive.torque_limit is not None else np.inf
    seen = np.isfinite(log.measured["tau"][:, motor])
    each = [sent[seen, motor] for late in LATE if (sent := log.motor_commands(late)) is not None]
    if seen.sum() < 100 or not each:
        return None
    tau = log.measured["tau"][seen, motor]
    best = max(each, key=lambda values: abs(float(np.cov(values, tau)[0, 1])) / max(float(np.std(values)), 1e-300))
    inside = np.isfinite(best) & (np.abs(best) < FULL * limit)
    return (best[inside], tau[inside]) if inside.sum() >= 100 and np.ptp(best[inside]) > 0.0 else None
