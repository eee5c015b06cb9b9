"""Basis functions of a flexible torque model: functions of the measured motion, of commands and of time.

Quadratic polynomials of angle, speed, deflection, motor speed and command, and their cubes; hat functions of each;
softened signs of speeds at several widths, alone and times load; speed and its sign times hats of the link angle; play
operators of several widths, for hysteresis; the lag of a drive behind commands; the fading integral of the error of a
position drive; time. Linear combinations of them approximate most torques, whether or not the catalogue contains the
effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from via_core.signals import Array
from via_sim.joint.layout import GOAL, POWER

from via_gap.residual.segments import Segments

STEP = 0.004  # [s] over which the functions are constant
SOFT = (0.02, 0.1, 0.5)  # [rad/s] widths of softened signs
WAYS = (0.02, 0.1, 0.4)  # standard deviations: widths of plays
LAGS = (0.01, 0.05)  # [s]
MEMORIES = (0.3, 1.0, 3.0)  # [s] over which integrals of the error of a position drive fade
KNOTS = 7  # of the hats over a quantity
FINE = 25  # of those over the link angle, where a kink or a narrow bump is
TIME_KNOTS = 10
FAR = 3.0  # standard deviations to which quantities are limited


@dataclass(frozen=True)
class Wave:
    """Sine and cosine of `order` times the angle of a measured axis, times the sign of its speed if `signed`."""

    place: int  # index of the axis in `Segments.axes`
    order: int  # per turn
    signed: bool


@dataclass(frozen=True, eq=False)
class Basis:
    """Functions of a motion, scaled by the mean and standard deviation of each quantity in some logs.

    mean, scale  (n,) of each quantity
    knots        (n, KNOTS) of the hats
    places       (p,) [rad] of the hats over the link angle
    duration     [s] of the longest log
    moving       columns of the commands that are not constant
    waves        further functions
    """

    mean: Array
    scale: Array
    knots: Array
    places: Array
    duration: float
    moving: tuple[int, ...]
    waves: tuple[Wave, ...] = ()

    @staticmethod
    def of(segments: Sequence[Segments], commanded: bool = True, places: int = KNOTS) -> Basis:
        """Functions of the motion, and of the commands if `commanded`, with hats at so many places of the link."""
        commands = np.concatenate([each.commands for each in segments])
        moving = tuple(int(column) for column in np.flatnonzero(np.ptp(commands, axis=0) > 0.0)) if commanded else ()
        values = np.concatenate([_quantities(each, moving)[0] for each in segments])
        scale = np.maximum(values.std(axis=0), 1e-9)
        knots = _knots(values, scale, KNOTS)
        duration = max(len(each.start) / each.rate for each in segments)
        return Basis(values.mean(axis=0), scale, knots, _knots(values, scale, places)[0], duration, moving)

    def values(self, segments: Segments) -> Array:
        """(steps, K) along a log, each constant over `ticks_of` ticks."""
        raw, speeds, angles, drives = _quantities(segments, self.moving)
        z = np.clip((raw - self.mean) / self.scale, -FAR, FAR)
        count, step = z.shape[1], ticks_of(segments) / segments.rate
        first, second = np.triu_indices(count)
        columns = [np.ones((len(z), 1)), z, z[:, first] * z[:, second], z**3]
        columns += [_hats(raw[:, i], self.knots[i]) for i in range(1, count)]
        for i in speeds:
            signs = np.tanh(raw[:, [i]] / np.array(SOFT))
            columns += [signs, raw[:, [i]] * np.abs(raw[:, [i]]) / self.scale[i] ** 2]
            columns += [signs[:, [1]] * np.abs(z[:, [j]]) for j in (*angles, *drives)]
        here = _hats(raw[:, 0], self.places)  # friction and damping that differ along the way of the link
        columns += [here, here * z[:, [1]], here * np.tanh(raw[:, [1]] / SOFT[1])]
        columns.append(_plays(z[:, angles]))
        for i in drives:
            for lag in LAGS:
                columns.append((z[:, i] - _faded(z[:, i], step / lag))[:, None])
        if GOAL in self.moving and segments.log.device.drive == "position":
            error = _error(segments) / self.scale[0]
            columns += [_faded(error, step / memory)[:, None] for memory in MEMORIES]
        time = np.arange(len(z)) * ticks_of(segments) / segments.rate / self.duration
        columns += [_hats(time, np.linspace(0.0, 1.0, TIME_KNOTS)), time[:, None] * z]
        columns += [time[:, None] * np.tanh(raw[:, [i]] / SOFT[1]) for i in speeds]  # friction that warms up
        columns += [wave_values(segments, wave) for wave in self.waves]
        return np.hstack(columns)


def _faded(values: Array, share: float) -> Array:
    """(N,) values behind a lag; `share` of its time constant passes between two of them."""
    keep = np.exp(-share)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])[0])


def _error(segments: Segments) -> Array:
    """(steps,) [rad] error of the goal of a position drive; 0 while it is off."""
    every = ticks_of(segments)
    state, command = segments.start[::every], segments.commands[::every]
    return np.where(command[:, POWER] > 0.0, command[:, GOAL] - state[:, 0], 0.0)


def wave_values(segments: Segments, wave: Wave) -> Array:
    """(steps, 2) along a log, each constant over `ticks_of` ticks."""
    state, axis = segments.start[:: ticks_of(segments)], segments.axes[wave.place]
    phase = wave.order * state[:, axis]
    sign = np.tanh(state[:, 3 + axis] / SOFT[1]) if wave.signed else np.ones(len(state))
    return np.stack([np.cos(phase) * sign, np.sin(phase) * sign], axis=1)


def ticks_of(segments: Segments) -> int:
    """Ticks over which the functions are constant."""
    return max(1, round(STEP * segments.rate))


def _quantities(segments: Segments, moving: Sequence[int]) -> tuple[Array, list[int], list[int], list[int]]:
    """(steps, n) angle, speed, deflections, motor speeds, commands; columns of speeds, of angles, of commands."""
    every = ticks_of(segments)
    state, command = segments.start[::every], segments.commands[::every]
    columns, speeds, angles, drives = [state[:, 0], state[:, 3]], [1], [0], []
    for axis in segments.axes[1:]:
        angles.append(len(columns))
        speeds.append(len(columns) + 1)
        columns += [state[:, 0] - state[:, axis], state[:, 3 + axis]]
    for column in moving:
        drives.append(len(columns))
        columns.append(command[:, column])
    return np.stack(columns, axis=1), speeds, angles, drives


def _knots(values: Array, scale: Array, count: int) -> Array:
    """(n, count) quantiles of the quantities (N, n), distinct even for a constant quantity."""
    return np.quantile(values, np.linspace(0.02, 0.98, count), axis=0).T + 1e-9 * scale[:, None] * np.arange(count)


def _hats(values: Array, knots: Array) -> Array:
    """(N, k) piecewise linear functions, 1 at one knot and 0 at all others."""
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=1)


def _plays(values: Array) -> Array:
    """(N, a w) distance of each of (N, a) from a play operator of each of WAYS, over its width."""
    widths = np.tile(WAYS, values.shape[1])
    ways = np.repeat(values, len(WAYS), axis=1)
    low, high, at = ways - widths, ways + widths, ways[0]
    out = np.empty_like(ways)
    for k in range(len(ways)):
        out[k] = at = np.minimum(np.maximum(at, low[k]), high[k])
    return (ways - out) / widths
