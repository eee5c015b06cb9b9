"""Size of an effect in a log: residuals of the true joint's equations over short windows, with and without the effect.

The equations are integrated against a bump function of WINDOW seconds and its derivatives, so that no measurement is
differentiated. 'Gap over noise' is the RMS residual with the effect over the RMS residual of the same motion without
it, for the true parameters and the equation with the largest ratio. Errors of the nominal file do not contribute.
"""

from __future__ import annotations

from math import isfinite, pi

import numpy as np
from scipy.optimize import lsq_linear
from via_core.device_parts import ServoMotor
from via_core.devices import Device
from via_core.signals import Array

from via_validation.sealed.recording import Log
from via_validation.sealed.stepping import Servo

WINDOW = 0.06  # [s], at least 12 samples
FINE = 1e-3  # [s] time step for a position drive's goal
SLOW = 0.03  # [rad/s] below this speed dry friction is unknown, and the window is left out


def residuals(device: Device, log: Log, speed: Array, servo: Servo | None = None) -> Array:
    """(1+m, N) residual of link [N m] and motors [N m; servos: rad/s^2], NaN at the ends and where friction sticks.

    log    evenly sampled, all signals
    speed  (N, 1+m) [rad/s] true speeds, for the direction of dry friction
    servo  position drive; the commands are its goals
    """
    period = float(log.time[1] - log.time[0])
    length = max(round(WINDOW / period), 12)
    u = (np.arange(length + 1)) / length
    span = length * period
    bump = (8.0 / 3.0) * np.sin(pi * u) ** 4 / span
    first = (8.0 / 3.0) * 4.0 * pi * np.sin(pi * u) ** 3 * np.cos(pi * u) / span**2
    second = (8.0 / 3.0) * 4.0 * pi**2 * (3.0 * (np.sin(pi * u) * np.cos(pi * u)) ** 2 - np.sin(pi * u) ** 4) / span**3

    def over(weights: Array, signal: Array) -> Array:
        return np.convolve(signal, weights[::-1], mode="valid") * period

    link = device.link
    stretched = device.torque_each(log.q, log.theta)
    damping = device.damping_of(_held(log.damping, log))
    static = stretched.sum(axis=1) + link.gravity_torque * np.sin(log.q - link.gravity_angle)
    static = static + link.coulomb_friction * np.sign(speed[:, 0]) + damping * speed[:, 0]
    if servo is not None:
        static = static - servo_torque(servo, log, speed[:, 0])
    elif not device.motors:
        static = static - _middle(log.commands[:-1, 0])
    rows = [link.inertia * over(second, log.q) - link.viscous_friction * over(first, log.q) + over(bump, static)]
    dry = [link.coulomb_friction]
    for i, motor in enumerate(device.motors):
        angle = log.theta[:, i]
        if isinstance(motor, ServoMotor):
            w = motor.bandwidth
            command = _held_mean(log.commands[:, i], log, period)
            rows.append(over(second, angle) - 2.0 * w * over(first, angle) + w * w * over(bump, angle - command))
            dry.append(0.0)
            continue
        torque = 0.5 * (
            log.tau[:, i] + np.concatenate([log.tau[1:, i], log.tau[-1:, i]])
        )  # zero-order hold over each tick
        static = motor.coulomb_friction * np.sign(speed[:, 1 + i]) - stretched[:, i] - torque
        rows.append(
            motor.inertia * over(second, angle) - motor.viscous_friction * over(first, angle) + over(bump, static)
        )
        dry.append(motor.coulomb_friction)
    out = np.array(rows)
    for axis, size in enumerate(dry):
        if size > 0.0:
            slow = np.convolve(np.abs(speed[:, axis]) < SLOW, np.ones(length + 1), mode="valid") > 0.5
            out[axis, slow] = np.nan
    return out


def _middle(commands: Array) -> Array:
    """(N+1,) mean of the commands (N,) before and after each sample."""
    return 0.5 * (np.concatenate([commands[:1], commands]) + np.concatenate([commands, commands[-1:]]))


def _held(commands: Array, log: Log) -> Array:
    """(N,) command in force at each sample, from commands (K,) with stamps of their own (zero-order hold)."""
    return commands[np.clip(np.searchsorted(log.command_time, log.time, side="right") - 1, 0, None)]


def _held_mean(commands: Array, log: Log, period: float) -> Array:
    """(N,) mean over one period about each sample of commands (K,) with zero-order hold."""
    ends = np.append(log.command_time, max(log.time[-1], log.command_time[-1]) + period)
    area = np.concatenate([[0.0], np.cumsum(commands * np.diff(ends))])
    return np.asarray(
        np.interp(log.time + 0.5 * period, ends, area) - np.interp(log.time - 0.5 * period, ends, area)
    ) / np.clip(
        np.minimum(log.time + 0.5 * period, ends[-1]) - np.maximum(log.time - 0.5 * period, ends[0]), 1e-9, None
    )


def servo_torque(servo: Servo, log: Log, speed: Array) -> Array:
    """(N,) torque [N m] of a position drive, from its goals and the measured angles."""
    fine = np.arange(log.time[0], log.time[-1], FINE)
    command = log.commands[np.clip(np.searchsorted(log.time, fine - servo.delay, side="right") - 1, 0, None), 0]
    goal, reach = command.copy(), servo.speed_limit * FINE
    for k in range(1, len(goal)) if isfinite(reach) else ():
        goal[k] = goal[k - 1] + min(max(command[k] - goal[k - 1], -reach), reach)
    pull = servo.kp * (np.interp(log.time, fine, goal) - log.q)
    return np.clip(pull, -servo.torque_limit, servo.torque_limit) - servo.kd * speed


def ratio(with_effect: Array, without: Array) -> float:
    """Gap over noise of two residuals (1+m, N)."""
    seen = np.isfinite(with_effect).any(axis=1) & np.isfinite(without).any(axis=1)  # friction may stick throughout
    if not seen.any():
        return 1.0
    sizes = [np.sqrt(np.nanmean(np.square(each[seen]), axis=1)) for each in (with_effect, without)]
    return float(np.max(sizes[0] / sizes[1]))


def ratio_after_fit(with_effect: Array, without: Array, slopes: Array, low: Array, high: Array) -> float:
    """Gap over noise [-] that remains after a fit of the joint's parameters.

    slopes     (J, 1+m, N) derivative of `with_effect` with respect to each parameter
    low, high  (J,) bounds of the parameters
    """
    sizes = np.sqrt(np.nanmean(np.square(without), axis=1))[:, None]
    seen = np.isfinite(with_effect) & np.isfinite(slopes).all(axis=0)
    columns = (slopes / sizes)[:, seen].T
    basis, triangle = np.linalg.qr(columns)
    best = lsq_linear(triangle, -basis.T @ (with_effect / sizes)[seen], (low, high)).x
    return ratio(with_effect + np.tensordot(best, slopes, 1), without)
