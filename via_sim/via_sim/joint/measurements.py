"""Measurements of a state: encoder error first, then noise, then quantisation; torques likewise.

An encoder measures  angle(t - skew) + offset + sum_k amplitude_k sin(order_k angle + phase_k).  The angle `skew` ago is
interpolated by a cubic between past samples, which the state keeps in a ring buffer (one in every `stride` ticks). The
interpolation error is below 1e-9 rad for motion up to 100 Hz.
"""

from __future__ import annotations

from collections import namedtuple
from math import ceil, cos, log, nan, pi, sin, sqrt
from typing import Any

import numpy as np
from via_core.signals import Array

from via_sim.catalogue.sensor.channel_skew import MAX_SKEW
from via_sim.joint.compiled import bare, inlined
from via_sim.joint.encoders import read_motion
from via_sim.joint.friction import breakaway, dry_friction, feels_both_sides
from via_sim.joint.layout import HISTORY, X
from via_sim.joint.parameters import DYNAMIC, P
from via_sim.joint.torques import (
    contact_torque,
    deflection,
    preset_of,
    spring_factor,
    transmission_stiffness,
    transmission_torque,
)

# Columns of the measured row and the truth row of one tick.
_Measured = namedtuple(
    "_Measured", "q theta_1 theta_2 tau_1 tau_2 q_velocity theta_velocity_1 theta_velocity_2 tau_link"
)
_Truth = namedtuple(
    "_Truth",
    "q theta_1 theta_2 q_velocity theta_velocity_1 theta_velocity_2 stiffness stiffness_1 stiffness_2 damping "
    "deflection_1 deflection_2 motor_torque_1 motor_torque_2 transmission_torque_1 transmission_torque_2",
)
MEASURED: Any = _Measured(*range(9))
TRUTH: Any = _Truth(*range(16))

# Sensor row: a noise of NaN means not measured, a quantum of 0 not quantised.
SensorSlots = namedtuple(
    "SensorSlots", "link_quantum motor_quantum link_noise motor_noise velocity_noise torque_noise link_torque_noise"
)
S: Any = SensorSlots(*range(7))


@bare
def _uniform(seed: np.uint64, tick: np.uint64, channel: np.uint64) -> float:
    """Uniform number in (0, 1), a pure function of three counters (splitmix64 finaliser, twice)."""
    z = seed * np.uint64(0xD1342543DE82EF95) + tick * np.uint64(32) + channel
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return (float(z >> np.uint64(11)) + 0.5) / 9007199254740992.0


@bare
def noise(x: Array, channel: int) -> float:
    """Standard normal number of a channel at the tick of state x: Box-Muller on counters, without hidden state."""
    seed, tick = np.uint64(x[X.seed]), np.uint64(x[X.tick])
    one = _uniform(seed, tick, np.uint64(2 * channel))
    two = _uniform(seed, tick, np.uint64(2 * channel + 1))
    return sqrt(-2.0 * log(one)) * cos(2.0 * pi * two)


@bare
def stride(period: float) -> int:
    """Ticks of `period` [s] between two samples in the ring buffer."""
    return max(1, ceil(MAX_SKEW / period / (HISTORY - 2)))


@bare
def record(x: Array, every: int) -> None:
    """Store the motion of every `every`-th tick in the ring buffer, see `stride`."""
    tick = int(x[X.tick])
    if tick % every == 0:
        here = X.history + 6 * (tick // every % HISTORY)
        for i in range(6):
            x[here + i] = x[i]


@bare
def past(p: Array, x: Array, axis: int) -> tuple[float, float]:
    """Angle [rad] and velocity [rad/s] of an axis `skew` ago."""
    skew = p[P.skew + axis]
    if skew <= 0.0:
        return x[axis], x[3 + axis]
    period, tick = p[P.tick], int(x[X.tick])
    every = stride(period)
    when = max(x[X.tick] - skew / period, 0.0)  # [ticks]; nothing is known before tick 0
    before = int(when) // every * every
    after = before + every
    here = X.history + 6 * (before // every % HISTORY) + axis
    there = X.history + 6 * (after // every % HISTORY) + axis
    if after >= tick:
        after, there = tick, axis
    if after == before:
        return x[axis], x[3 + axis]
    h = (after - before) * period
    share = (when - before) * period / h
    return hermite(x[here], x[here + 3], x[there], x[there + 3], h, share)


@bare
def hermite(a: float, va: float, b: float, vb: float, h: float, share: float) -> tuple[float, float]:
    """Value and slope at `share` (0 to 1) of an interval h [s] of the cubic with end values a, b and slopes va, vb."""
    rest = 1.0 - share
    bend_a, bend_b = h * va - (b - a), (b - a) - h * vb
    value = rest * a + share * b + share * rest * (rest * bend_a + share * bend_b)
    slope = (b - a) + (rest - share) * (rest * bend_a + share * bend_b) + share * rest * (bend_b - bend_a)
    return value, slope / h


@bare
def dissipated_torque(p: Array, x: Array) -> float:
    """Torque [N m] that damper and dry friction of a rigid joint dissipate, with the sign of d qd.

    At standstill friction balances external torque, gravity and a wall, up to breakaway.
    """
    speed, load = x[3], x[X.external] - x[X.beside]
    if speed != 0.0 and not feels_both_sides(p, 0):
        direction = 1 if speed > 0.0 else -1
        return x[X.damping] * speed + direction * dry_friction(p, 0, direction, abs(speed), load, 0.0) + x[X.bristle]
    outside = -p[P.gravity_torque] * sin(x[0] - p[P.gravity_angle])
    if p[P.contact_stiffness] > 0.0 and p[P.contact_side] * (x[0] - p[P.contact_angle]) > 0.0:
        outside += contact_torque(p, x[0], speed)
    counter = x[X.beside] + outside
    if speed != 0.0:
        direction = 1 if speed > 0.0 else -1
        dry = direction * dry_friction(p, 0, direction, abs(speed), load, counter)
        return x[X.damping] * speed + dry + x[X.bristle]
    needed = x[X.external] + outside - x[X.bristle]
    least, most = -breakaway(p, 0, -1, load, counter), breakaway(p, 0, 1, load, counter)
    return min(max(needed, least), most) + x[X.bristle]


@inlined
def _exists(p: Array, has: Any, axis: int) -> bool:
    """Whether the joint has an axis; a constant in a short kernel."""
    if has.rest is not None:
        return p[P.axis_kind + axis] != 0.0
    return axis == 0 or (has.spring is not None and axis == 1) or (has.second is not None and axis == 2)


@inlined
def _read(has: Any, true: float, sd: float, quantum: float, x: Array, channel: int) -> float:
    """Measurement of a true value with noise of standard deviation `sd`, then quantisation."""
    value = true
    if has.noise is not None:
        if sd != 0.0:
            value += sd * noise(x, channel)
        return quantum * np.rint(value / quantum) if quantum > 0.0 else value
    return value


@inlined
def observe(
    p: Array, has: Any, s: Array, x: Array, modes: Array, motion: Any, acted: Any, measured: Array, truth: Array
) -> None:  # fmt: skip
    """Measured row (9,) and truth row (16,) of state x with sensors s; NaN without the axis or its sensor.

    motion  angles and velocities (6) of state x
    acted   what acted and what the drives report (5): torques of the motors, damping, reported torques
    """
    age = p[P.origin] + x[X.tick] * p[P.tick]
    damping, reported = acted[2], acted[3:]
    sigma = link_torque = 0.0
    for i in range(3):
        there = _exists(p, has, i)
        truth[i], truth[3 + i] = motion[i] if there else nan, motion[3 + i] if there else nan
    for i in range(2):
        motored = _exists(p, has, 1 + i) and (has.rest is None or p[P.axis_kind + 1 + i] == DYNAMIC)
        torque = nan
        if motored:
            torque = p[P.sensed_gain + 1 + i] * reported[i] + p[P.sensed_bias + 1 + i]
            torque = _read(has, torque, s[S.torque_noise], 0.0, x, 3 + i)
        truth[TRUTH.motor_torque_1 + i], measured[MEASURED.tau_1 + i] = acted[i] if motored else nan, torque
        stiffness = torque = deflected = nan
        if _spans(p, has, i):
            phi, preset = deflection(p, has, i, motion[0], motion[1 + i]), preset_of(p, i, motion[1], motion[2])
            flank, factor = 0, p[P.spring_scale + i]
            if has.rest is not None:
                flank = 0 if abs(phi) < 0.5 * p[P.backlash + i] else (1 if phi > 0.0 else -1)
                factor = spring_factor(p, i, age)
            stiffness = transmission_stiffness(p, has, modes, i, phi, preset, factor)
            torque = transmission_torque(p, has, modes, i, phi, preset, flank, factor)
            deflected = motion[0] - motion[1 + i]
            sigma += stiffness
            link_torque += torque
            if has.rest is not None:
                link_torque += x[X.hysteresis + i] + p[P.spring_damping + i] * (motion[3] - motion[4 + i])
        truth[TRUTH.stiffness_1 + i], truth[TRUTH.deflection_1 + i] = stiffness, deflected
        truth[TRUTH.transmission_torque_1 + i] = torque
    truth[TRUTH.stiffness], truth[TRUTH.damping] = sigma, damping
    for i in range(3):
        angle = speed = nan
        if _exists(p, has, i):
            quantum, sd = s[S.motor_quantum], s[S.motor_noise]
            if i == 0:
                quantum, sd = s[S.link_quantum], s[S.link_noise]
            if has.rest is None:
                angle, speed = motion[i] + p[P.encoder_offset + i], motion[3 + i]
            else:
                angle, speed = past(p, x, i)
                angle, speed = read_motion(p, i, angle, speed)
            angle = _read(has, angle, sd, max(quantum, p[P.encoder_quantum + i]), x, i)
            speed = _read(has, speed, s[S.velocity_noise], 0.0, x, 5 + i)
        measured[MEASURED.q + i], measured[MEASURED.q_velocity + i] = angle, speed
    if has.spring is None or (has.rest is not None and p[P.transmissions] == 0.0):
        link_torque = dissipated_torque(p, x)
    link_torque = p[P.sensed_gain] * link_torque + p[P.sensed_bias]
    measured[MEASURED.tau_link] = _read(has, link_torque, s[S.link_torque_noise], 0.0, x, 8)


@inlined
def _spans(p: Array, has: Any, i: int) -> bool:
    """Whether the joint has transmission i."""
    if has.rest is not None:
        return p[P.transmissions] > i
    return (has.spring is not None and i == 0) or (has.second is not None and i == 1)


@bare
def sense(p: Array, x: Array, motion: Array) -> None:
    """Measured angles and velocities without noise and quantisation into motion (6,)."""
    for i in range(3):
        angle, speed = past(p, x, i)
        motion[i], motion[3 + i] = read_motion(p, i, angle, speed)
