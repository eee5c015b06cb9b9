"""Excitation as in a laboratory: multisines, moves with holds, slow ramps, fast swings, small reversals.

Every piece starts and ends at rest at zero; order, lengths and parameters are random.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, pi

import numpy as np
from numpy.random import Generator
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.signals import Array

from via_validation.sealed.stepping import Drive, Servo

Piece = Callable[[Generator, Array], Array]  # of local time (n,) [s], values about -1 to 1
SETTLING = 0.6  # [s] at rest between pieces
PIECE = 8.0  # [s] of a piece, on average


def excite(
    rng: Generator, device: Device, duration: float, size: float, rate: float = 0.0, position_drive: Servo | None = None
) -> Drive:
    """A drive with random references over `duration` [s]; `size` is 1 for full motion.

    rate            [Hz] of ticks; 0: rate of the device file
    position_drive  drive whose goals the references are; None: motors with torque or servo drive
    """
    rate = rate or device.sensors.rate
    time = np.arange(round(duration * rate)) / rate
    servo = device.drive == "servo"
    equilibrium = size * rng.uniform(0.5, 0.8) * _pieces(rng, time)
    preset = _preset(rng, device, time)
    if servo:
        references = device.motor_angles(equilibrium, preset)
        levels = rng.choice([0.0, 0.0, 0.25, 0.5, 1.0], size=len(time))
        damping = levels[(np.searchsorted(_changes(rng, time), time, side="right"))]
        gains = (0.0, 0.0)
        zero = np.zeros_like(references)
        return Drive(references, zero, zero, damping, gains, gains, rate)
    if position_drive is not None:
        zero, none = np.zeros((len(time), 1)), (0.0,)
        return Drive(equilibrium[:, None], zero, zero, zero[:, 0], none, none, rate, (), position_drive)
    references = device.motor_angles(equilibrium, preset) if device.motors else equilibrium[:, None]
    rates = np.gradient(references, axis=0) * rate
    forward = np.zeros_like(references)
    proportional, derivative = [], []
    for i in range(references.shape[1]):
        carried, viscous = device.link.inertia / max(device.n_motors, 1), 0.0
        if device.motors:
            motor = device.motors[i]
            assert isinstance(motor, TorqueMotor)
            carried, viscous = carried + motor.inertia, motor.viscous_friction
        w = rng.uniform(10.0, 15.0)
        proportional.append(carried * w * w)
        derivative.append(max(1.2 * carried * w - viscous, 0.2 * carried * w))
        shake = _multisine(rng, time, 2.0, 12.0)
        forward[:, i] = size * rng.uniform(0.1, 0.25) * shake * carried * w * w * 0.5 * _fade(time)
    return Drive(references, rates, forward, np.zeros(len(time)), tuple(proportional), tuple(derivative), rate)


def turn(rng: Generator, device: Device, duration: float, rate: float) -> Drive:
    """A light motor under velocity or position control that turns at piecewise constant speeds.

    A PI speed controller equals a PD angle controller whose reference turns at the wanted speed; position control adds
    an integral term.
    """
    time = np.arange(round(duration * rate)) / rate
    edges = np.concatenate([[0.0], _changes(rng, time)])
    turns = np.cumprod(rng.choice([-1.0, -1.0, -1.0, 1.0], len(edges)))  # direction changes most of the time
    speeds = turns * np.exp(rng.uniform(np.log(0.2), np.log(6.0), len(edges)))
    level = speeds[np.clip(np.searchsorted(edges, time, side="right") - 1, 0, None)]
    half = max(int(0.15 * rate), 1)
    window = np.hanning(2 * half + 1)
    speed = np.convolve(np.pad(level, half, mode="edge"), window / window.sum(), mode="valid") * _fade(time)
    references = np.cumsum(speed) / rate
    w = float(rng.uniform(15.0, 35.0))
    stiffness, damping = device.link.inertia * w * w, 1.4 * device.link.inertia * w
    integral = stiffness * float(rng.uniform(1.0, 4.0)) if rng.uniform() < 0.4 else 0.0
    zero = np.zeros((len(time), 1))
    return Drive(
        references[:, None], speed[:, None], zero, zero[:, 0], (stiffness,), (damping,), rate, (integral,)
    )  # fmt: skip


def start_of(device: Device, drive: Drive) -> Array:
    """Angles (1+m,) [rad] at rest under the first references; springs and gravity balance at the link."""
    motors = drive.references[0]
    if not device.motors:
        return motors.copy()
    grid = np.linspace(-1.0, 1.0, 4001) + float(np.mean(motors[:1] if device.arrangement == "serial" else motors))
    torque = device.torque_each(grid, np.tile(motors, (len(grid), 1))).sum(axis=1)
    torque = torque + device.link.gravity_torque * np.sin(grid - device.link.gravity_angle)
    rising = np.flatnonzero((torque[:-1] <= 0.0) & (torque[1:] > 0.0))
    middle = rising[np.argmin(np.abs(grid[rising] - grid[2000]))] if rising.size else 2000
    share = torque[middle] / (torque[middle] - torque[middle + 1]) if rising.size else 0.0
    return np.array([grid[middle] + share * (grid[1] - grid[0]), *motors])


def _pieces(rng: Generator, time: Array) -> Array:
    """Pieces of about PIECE seconds in sequence; every kind occurs once, in random order, before any repeats."""
    whole = float(time[-1])
    count = max(round(whole / PIECE), 1)
    rounds = [rng.permutation(len(_PIECES)) for _ in range(ceil(count / len(_PIECES)))]
    kinds = [_PIECES[kind] for kind in np.concatenate(rounds)[:count]]
    shares = rng.uniform(0.7, 1.3, count) * np.array([length for _, length in kinds])
    lengths = shares * (whole - SETTLING * (count + 1)) / shares.sum()
    out, begin = np.zeros_like(time), SETTLING
    for (piece, _), length in zip(kinds, lengths):
        here = (time >= begin) & (time < begin + length)
        out[here] = piece(rng, time[here] - begin)
        begin += length + SETTLING
    return out


def _fade(time: Array, span: float = 0.8) -> Array:
    """Window (N,) that is 1 and falls smoothly to 0 at both ends."""
    ends = np.minimum(time - time[0], time[-1] - time) / span
    return 0.5 - 0.5 * np.cos(pi * np.clip(ends, 0.0, 1.0))


def _multisine(rng: Generator, time: Array, low: float, high: float) -> Array:
    frequencies = np.geomspace(low, high, 8) * rng.uniform(0.93, 1.07, 8)
    phases = rng.uniform(0.0, 2.0 * pi, 8)
    weights = (frequencies / low) ** -0.7
    return 1.4 * np.sin(2.0 * pi * np.outer(time, frequencies) + phases) @ weights / np.sqrt(np.sum(weights**2)) / 2.0


def _shaken(rng: Generator, time: Array) -> Array:
    return _multisine(rng, time, 0.2, 5.0) * _fade(time)


def _moves(rng: Generator, time: Array) -> Array:
    """Smooth moves (fifth-order polynomials) between random targets, with a hold at each."""
    out, at, begin = np.zeros_like(time), 0.0, 0.0
    while begin < time[-1] - 1.2:
        span, hold = rng.uniform(0.25, 0.9), rng.uniform(0.3, 0.9)
        last = begin + span + hold > time[-1] - 1.5
        goal = 0.0 if last else float(rng.uniform(-1.0, 1.0))
        out += (goal - at) * _smooth((time - begin) / span)
        at, begin = goal, begin + span + hold
        if last:
            break
    return out


def _slow(rng: Generator, time: Array) -> Array:
    """Slow ramps at constant speed with rounded corners."""
    span = time[-1] / 4.0
    level = float(rng.uniform(0.5, 0.9)) * min(1.0, 0.6 * span)
    corners = np.array([0.0, 1.0, 2.0, 3.0, 4.0]) * span
    ramp = np.interp(time, corners, [0.0, level, 0.0, -level, 0.0])
    half = max(int(0.06 / (time[1] - time[0])), 1)
    window = np.hanning(2 * half + 1)
    return np.convolve(np.pad(ramp, half, mode="edge"), window / window.sum(), mode="valid")


def _fast(rng: Generator, time: Array) -> Array:
    """Chirp with rising frequency and falling amplitude."""
    low, high = rng.uniform(0.6, 1.0), rng.uniform(2.5, 4.5)
    climb = np.log(high / low) / time[-1]
    phase = 2.0 * pi * low * (np.exp(climb * time) - 1.0) / climb
    return np.sin(phase) * _fade(time) * np.exp(-0.6 * climb * time)


def _small(rng: Generator, time: Array) -> Array:
    """Small slow reversals about several angles."""
    count = max(ceil(time[-1] / 1.6), 2)
    place = rng.uniform(-0.8, 0.8, count)
    place[-1] = 0.0
    span = time[-1] / count
    out = sum(
        (p - before) * _smooth((time - i * span) / 0.5) for i, (before, p) in enumerate(zip([0.0, *place[:-1]], place))
    )
    return np.asarray(out) + rng.uniform(0.02, 0.08) * np.sin(2.0 * pi * rng.uniform(0.8, 1.6) * time) * _fade(time)


_PIECES: tuple[tuple[Piece, float], ...] = ((_shaken, 9.0), (_moves, 11.0), (_slow, 9.0), (_fast, 7.0), (_small, 5.0))


def _smooth(u: Array) -> Array:
    """Rise from 0 to 1 with zero speed and acceleration at both ends."""
    x = np.clip(u, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def _changes(rng: Generator, time: Array) -> Array:
    """Times [s] of changes, 1.5 to 4 s apart."""
    return np.cumsum(rng.uniform(1.5, 4.0, size=ceil(time[-1] / 1.5) + 1))


def _preset(rng: Generator, device: Device, time: Array) -> Array:
    """Stiffness preset (N,): levels joined by smooth moves of 0.5 s; 0 for joints without a preset."""
    if device.arrangement not in ("antagonistic", "serial"):
        return np.zeros_like(time)
    low, high = (0.25, 0.55) if device.arrangement == "antagonistic" else (0.3, 2.0)
    changes = _changes(rng, time)
    levels = rng.uniform(low, high, len(changes) + 1)
    out = np.full_like(time, levels[0])
    for when, before, after in zip(changes, levels[:-1], levels[1:]):
        out += (after - before) * _smooth((time - when) / 0.5)
    return out
