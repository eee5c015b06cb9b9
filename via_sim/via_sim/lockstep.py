"""Many parameter rows of one joint under the same commands, in lockstep: LANES runs side by side in vector registers.

Between events the right-hand side is smooth (torques.py), and most ticks of most runs have none. So a block of runs
takes the same Krogstad step together, every operation a loop over lanes that the compiler turns into vector
instructions: the angle of lane l stands in z[Z.start + l]. A lane in which an axis stands, comes to a stop or crosses a
flank of its gap takes this tick again on its own (`kernel.advance_tick`), and so does one with terms that are not
written out here (rare ones, lags, fractions of a tick of dead time, servos). Results differ from those of `kernel.run`
by rounding only: sine and exponential are polynomials here, right to 1e-13, because a call of the library's would break
the vector loop.
"""

from __future__ import annotations

from collections import namedtuple
from math import floor
from typing import Any

import numpy as np
from via_core.dampers import damper_value
from via_core.signals import Array
from via_core.springs import N_COEFFICIENTS, ODD_POLYNOMIAL

from via_sim.actuation import saturated
from via_sim.kernel import N_WEIGHTS, PER_AXIS, advance_tick, begin, weigh
from via_sim.parameters import AT_TRANSMISSION, DYNAMIC, NO_DAMPER, P
from via_sim.readings import record, sense
from via_sim.torques import (
    EXTERNAL,
    LAGS,
    N_INPUTS,
    N_MODES,
    NEIGHBOUR,
    QUEUED,
    RARE,
    X,
    bare,
    compiled,
    deflection,
    has_friction,
    preset_of,
    spring_factor,
    transmission_torque,
)

LANES = 16

# Rows of the block's memory Z, LANES numbers each; names in capitals are those of one lane in the scalar kernel.
#   START 6: state at the beginning of a step; AT 6: where torques are evaluated; N, A, B, D 3 each: torques of the
#   stages; INPUT 3: torque on link, motor 1, motor 2; DAMP 1; FACTOR 2: of the springs; SIGN 3: direction of slip, 0
#   without friction; BAD 1: left its modes; FLANK 2; SPRING 2: torques; PHI, INSIDE, SLOPE, LOADED 1: scratch; WEIGHT
#   60 as of `weigh`; then what the parameter rows say.
_SIZES = {
    "start": 6, "at": 6, "n": 3, "a": 3, "b": 3, "d": 3, "input": 3, "damp": 1, "factor": 2, "sign": 3, "bad": 1,
    "flank": 2, "spring": 2, "phi": 1, "inside": 1, "slope": 1, "loaded": 1, "weight": 3 * PER_AXIS, "kinetic": 3,
    "excess": 3, "inverse": 3, "asymmetry": 3, "viscous": 3, "load": 3, "gravity": 1, "angle": 1,
    "coefficient": 2 * N_COEFFICIENTS, "stop": 2, "hardening": 2, "offset": 2, "half": 2,
}  # fmt: skip
_Rows = namedtuple("_Rows", list(_SIZES))  # type: ignore[misc]
Z: Any = _Rows(*(int(LANES * s) for s in np.cumsum((0, *list(_SIZES.values())[:-1]))))
N_CELLS = int(LANES * sum(_SIZES.values()))


@bare
def _sine(x: float) -> float:
    """sin(x) within 2e-16 of a turn's worth of x, without a branch: Taylor about the nearest multiple of pi."""
    turns = np.floor(x * 0.3183098861837907 + 0.5)
    r = (x - turns * 3.141592653589793) - turns * 1.2246467991473532e-16
    s = r * r
    t = 1.0 - s * (1.0 / 342.0)
    t = 1.0 - s * (1.0 / 272.0) * t
    t = 1.0 - s * (1.0 / 210.0) * t
    t = 1.0 - s * (1.0 / 156.0) * t
    t = 1.0 - s * (1.0 / 110.0) * t
    t = 1.0 - s * (1.0 / 72.0) * t
    t = 1.0 - s * (1.0 / 42.0) * t
    t = 1.0 - s * (1.0 / 20.0) * t
    t = 1.0 - s * (1.0 / 6.0) * t
    odd = turns - 2.0 * np.floor(0.5 * turns)
    return (1.0 - 2.0 * odd) * r * t


@bare
def _decay(x: float) -> float:
    """exp(-x) for x >= 0, without a branch: Taylor of exp(-x/1024), squared ten times."""
    y = -min(x, 700.0) * (1.0 / 1024.0)
    t = 1.0 + y * (1.0 / 11.0)
    t = 1.0 + y * (1.0 / 10.0) * t
    t = 1.0 + y * (1.0 / 9.0) * t
    t = 1.0 + y * (1.0 / 8.0) * t
    t = 1.0 + y * (1.0 / 7.0) * t
    t = 1.0 + y * (1.0 / 6.0) * t
    t = 1.0 + y * (1.0 / 5.0) * t
    t = 1.0 + y * (1.0 / 4.0) * t
    t = 1.0 + y * (1.0 / 3.0) * t
    t = 1.0 + y * (1.0 / 2.0) * t
    t = 1.0 + y * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    return t * t


@bare
def _springs(z: Array, rows: Array, first: int, terms: int) -> None:
    """Torque of each transmission at z's angles AT -> SPRING; `terms` of the polynomials are not zero."""
    p = rows[first]
    for i in range(int(p[P.transmissions])):
        at, motor, spring, factor = Z.at, Z.at + (1 + i) * LANES, Z.spring + i * LANES, Z.factor + i * LANES
        flank, half, stop = Z.flank + i * LANES, Z.half + i * LANES, Z.stop + i * LANES
        hardening, offset = Z.hardening + i * LANES, Z.offset + i * LANES
        if int(p[P.spring_kind + i]) != ODD_POLYNOMIAL:
            for lane in range(LANES):
                row = rows[min(first + lane, len(rows) - 1)]
                start = P.spring + i * N_COEFFICIENTS
                q, m1, m2 = z[at + lane], z[at + LANES + lane], z[at + 2 * LANES + lane]
                phi, preset = deflection(row, i, q, z[motor + lane]), preset_of(row, i, m1, m2)
                law = row[start : start + N_COEFFICIENTS]
                z[spring + lane] = transmission_torque(row, law, i, phi, preset, int(z[flank + lane]), z[factor + lane])
            continue
        for lane in range(LANES):
            phi = z[at + lane] - z[motor + lane] - z[offset + lane] - z[flank + lane] * z[half + lane]
            z[Z.phi + lane] = phi
            z[Z.inside + lane] = min(max(phi, -z[stop + lane]), z[stop + lane])
            z[spring + lane] = z[Z.slope + lane] = 0.0
        for k in range(terms - 1, -1, -1):
            law, odd = Z.coefficient + (i * N_COEFFICIENTS + k) * LANES, 2.0 * k + 1.0
            for lane in range(LANES):
                square = z[Z.inside + lane] * z[Z.inside + lane]
                z[spring + lane] = z[spring + lane] * square + z[law + lane]
                z[Z.slope + lane] = z[Z.slope + lane] * square + odd * z[law + lane]
        for lane in range(LANES):
            phi, inside = z[Z.phi + lane], z[Z.inside + lane]
            torque = z[spring + lane] * inside + max(z[Z.slope + lane], 0.0) * (phi - inside)
            share = max(1.0 + z[hardening + lane] * phi * phi, 0.0)
            within = z[half + lane] > 0.0 and z[flank + lane] == 0.0
            z[spring + lane] = 0.0 if within else z[factor + lane] * share * torque


@bare
def _torques(
    z: Array, rows: Array, first: int, out: int, terms: int, gravity: bool, friction: bool, falls: bool
) -> None:
    """Torque on each axis but for its viscous friction, at angles and velocities AT -> three rows from `out` on."""
    p = rows[first]
    for lane in range(LANES):
        z[out + lane] = z[Z.input + lane]
        z[out + LANES + lane] = z[Z.input + LANES + lane]
        z[out + 2 * LANES + lane] = z[Z.input + 2 * LANES + lane]
    if gravity:
        for lane in range(LANES):
            z[out + lane] -= z[Z.gravity + lane] * _sine(z[Z.at + lane] - z[Z.angle + lane])
    if p[P.damper_site] == AT_TRANSMISSION:
        for lane in range(LANES):
            z[out + lane] += z[Z.damp + lane] * z[Z.at + 4 * LANES + lane]
            z[out + LANES + lane] += z[Z.damp + lane] * z[Z.at + 3 * LANES + lane]
    _springs(z, rows, first, terms)
    count = int(p[P.transmissions])
    for i in range(count):
        for lane in range(LANES):
            z[out + lane] -= z[Z.spring + i * LANES + lane]
            z[out + (1 + i) * LANES + lane] += z[Z.spring + i * LANES + lane]
    if not friction:
        return
    for axis in range(3):
        here = axis * LANES
        if count == 0:
            for lane in range(LANES):
                z[Z.loaded + lane] = abs(z[Z.input + lane])
        elif axis == 0:
            for lane in range(LANES):
                z[Z.loaded + lane] = abs(z[Z.spring + lane] + z[Z.spring + LANES + lane])
        else:
            for lane in range(LANES):
                z[Z.loaded + lane] = abs(z[Z.spring + here - LANES + lane])
        for lane in range(LANES):
            sign, v = z[Z.sign + here + lane], z[Z.at + 3 * LANES + here + lane]
            size = z[Z.kinetic + here + lane] + z[Z.load + here + lane] * z[Z.loaded + lane]
            size += sign * (z[Z.asymmetry + here + lane] + z[Z.viscous + here + lane] * sign * v)
            z[out + here + lane] -= sign * size
        if falls:
            for lane in range(LANES):
                ratio = z[Z.at + 3 * LANES + here + lane] * z[Z.inverse + here + lane]
                excess = z[Z.excess + here + lane] * _decay(ratio * ratio)
                z[out + here + lane] -= z[Z.sign + here + lane] * excess


@bare
def _stage(z: Array, base: int, one: int, torque_one: int, two: int, torque_two: int, out: int) -> None:
    """Angles and velocities -> six rows from `out` on: linear part `base`, weights `one`, `two` times two torques."""
    for axis in range(3):
        w = Z.weight + PER_AXIS * axis * LANES
        x, v, to = Z.start + axis * LANES, Z.start + (3 + axis) * LANES, out + axis * LANES
        n, m = torque_one + axis * LANES, torque_two + axis * LANES
        for lane in range(LANES):
            first, second, speed = z[n + lane], z[m + lane], z[v + lane]
            z[to + lane] = (
                z[x + lane]
                + z[w + (base + 1) * LANES + lane] * speed
                + z[w + (one + 1) * LANES + lane] * first
                + z[w + (two + 1) * LANES + lane] * second
            )
            z[to + 3 * LANES + lane] = (
                z[w + base * LANES + lane] * speed
                + z[w + one * LANES + lane] * first
                + z[w + two * LANES + lane] * second
            )


@bare
def _check(z: Array, velocity: int, transmissions: int, gaps: bool) -> None:
    """BAD where a slipping axis has stopped or runs backwards (three rows `velocity`), or a flank is crossed (AT)."""
    for axis in range(3):
        for lane in range(LANES):
            sign = z[Z.sign + axis * LANES + lane]
            stopped = sign != 0.0 and sign * z[velocity + axis * LANES + lane] <= 0.0
            z[Z.bad + lane] = 1.0 if stopped else z[Z.bad + lane]
    if gaps:
        for i in range(transmissions):
            motor, offset = Z.at + (1 + i) * LANES, Z.offset + i * LANES
            for lane in range(LANES):
                half, flank = z[Z.half + i * LANES + lane], z[Z.flank + i * LANES + lane]
                phi = z[Z.at + lane] - z[motor + lane] - z[offset + lane]
                outside = abs(phi) > half if flank == 0.0 else flank * phi < half
                z[Z.bad + lane] = 1.0 if half > 0.0 and outside else z[Z.bad + lane]


@bare
def _step(
    z: Array, rows: Array, first: int, terms: int, gravity: bool, friction: bool, falls: bool, gaps: bool
) -> None:
    """One Krogstad step of the block, as `kernel._step`: START moves on, BAD says which lanes may not."""
    transmissions = int(rows[first, P.transmissions])
    for cell in range(6 * LANES):
        z[Z.at + cell] = z[Z.start + cell]
    _torques(z, rows, first, Z.n, terms, gravity, friction, falls)
    for cell in range(3 * LANES):
        z[Z.a + cell] = 0.0
    _stage(z, 0, 4, Z.n, 8, Z.a, Z.at)
    for cell in range(3 * LANES):
        z[Z.d + cell] = z[Z.at + 3 * LANES + cell]
    _torques(z, rows, first, Z.a, terms, gravity, friction, falls)
    _stage(z, 0, 6, Z.n, 8, Z.a, Z.at)
    if friction:
        for cell in range(3 * LANES):  # the speed at the midpoint
            z[Z.d + cell] += z[Z.at + 3 * LANES + cell]
        _check(z, Z.d, transmissions, False)
    _torques(z, rows, first, Z.b, terms, gravity, friction, falls)
    _stage(z, 2, 10, Z.n, 12, Z.b, Z.at)
    _torques(z, rows, first, Z.d, terms, gravity, friction, falls)
    for cell in range(3 * LANES):
        z[Z.a + cell] += z[Z.b + cell]
    _stage(z, 2, 14, Z.n, 16, Z.a, Z.at)
    for axis in range(3):
        w, d = Z.weight + PER_AXIS * axis * LANES, Z.d + axis * LANES
        angle, velocity = Z.at + axis * LANES, Z.at + (3 + axis) * LANES
        for lane in range(LANES):
            z[angle + lane] += z[w + 19 * LANES + lane] * z[d + lane]
            z[velocity + lane] += z[w + 18 * LANES + lane] * z[d + lane]
    if friction or gaps:
        _check(z, Z.at + 3 * LANES, transmissions, gaps)
    for cell in range(6 * LANES):
        z[Z.start + cell] = z[Z.at + cell]


@bare
def _written_out(p: Array, modes: Array) -> bool:
    """Whether this file has all the terms that a prepared row asks for."""
    whole = floor(p[P.delay] / p[P.tick] + 1e-9)
    fraction = p[P.delay] - whole * p[P.tick] >= 1e-9 * p[P.tick]
    known = modes[RARE] == 0 and modes[LAGS] == 0 and not fraction
    for axis in range(1, 3):
        known &= p[P.axis_kind + axis] <= DYNAMIC
    return known and p[P.skew] <= 0.0 and p[P.skew + 1] <= 0.0 and p[P.skew + 2] <= 0.0


@bare
def _enter(p: Array, z: Array, lane: int) -> None:
    """A parameter row into its lane."""
    for axis in range(3):
        here = axis * LANES + lane
        slips = has_friction(p, axis)
        z[Z.kinetic + here] = p[P.kinetic_friction + axis] if slips else 0.0
        z[Z.excess + here] = p[P.breakaway_friction + axis] - p[P.kinetic_friction + axis] if slips else 0.0
        z[Z.inverse + here] = 1.0 / p[P.stribeck_velocity + axis]
        z[Z.asymmetry + here], z[Z.viscous + here] = p[P.friction_asymmetry + axis], p[P.viscous_asymmetry + axis]
        z[Z.load + here] = p[P.load_friction + axis]
    z[Z.gravity + lane], z[Z.angle + lane] = p[P.gravity_torque], p[P.gravity_angle]
    for k in range(2 * N_COEFFICIENTS):
        z[Z.coefficient + k * LANES + lane] = p[P.spring + k]
    for i in range(2):
        here = i * LANES + lane
        z[Z.stop + here], z[Z.hardening + here] = p[P.stop + i], p[P.spring_hardening + i]
        z[Z.offset + here] = p[P.pretension_offset + i] if p[P.serial] == 0.0 else 0.0
        z[Z.half + here] = 0.5 * p[P.backlash + i]


@bare
def _drive(p: Array, x: Array, command: Array, tick: int, slot: int, z: Array, lane: int) -> None:
    """Inputs of a lane over a tick -> z and the bookkeeping of its state x; `slot`: where its queue stands."""
    period, length = p[P.tick], (x.size - X.queue) // QUEUED
    age = p[P.origin] + tick * period
    held = slot - int(p[P.delay] / period + 1e-9)
    held = X.queue + QUEUED * (held if held >= 0 else held + length)
    for i in range(QUEUED):
        x[X.queue + QUEUED * slot + i] = command[i]
    neighbour = command[NEIGHBOUR] if command.size > NEIGHBOUR else 0.0
    link = command[EXTERNAL] if p[P.link_drive] == 0.0 else 0.0
    if p[P.link_drive] != 0.0:
        asked = saturated(p, 0, x[held + EXTERNAL])
        x[X.lag] = asked
        link = p[P.torque_gain] * asked + p[P.torque_bias]
    link += (p[P.coupling] + p[P.coupling + 1] + p[P.coupling + 2]) * neighbour
    if p[P.pulse_torque] != 0.0:
        overlap = min(age + period, p[P.pulse_stop]) - max(age, p[P.pulse_start])
        link += p[P.pulse_torque] * max(overlap, 0.0) / period
    z[Z.input + lane] = x[X.external] = link
    for i in range(2):
        limit, torque = p[P.torque_limit + i], 0.0
        x[X.reported_torque + i] = min(max(command[i], -limit), limit)
        if p[P.axis_kind + 1 + i] == DYNAMIC:
            asked = saturated(p, 1 + i, min(max(x[held + i], -limit), limit))
            x[X.lag + 1 + i] = asked
            torque = p[P.torque_gain + 1 + i] * asked + p[P.torque_bias + 1 + i] - p[P.coupling + 1 + i] * neighbour
        z[Z.input + (1 + i) * LANES + lane] = x[X.motor_torque + i] = torque
        z[Z.factor + i * LANES + lane] = spring_factor(p, i, age + 0.5 * period)
    damping = 0.0
    if p[P.damper_site] != NO_DAMPER:
        damping = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[held + 2])
    z[Z.damp + lane] = x[X.damping] = damping


@bare
def _place(p: Array, x: Array, z: Array, lane: int) -> bool:
    """State x into its lane, and whether it moves on from here without standing anywhere."""
    free = True
    for i in range(6):
        z[Z.start + i * LANES + lane] = x[i]
    for axis in range(3):
        sign = 0.0
        if has_friction(p, axis):
            free &= x[3 + axis] != 0.0
            sign = 1.0 if x[3 + axis] > 0.0 else -1.0
        z[Z.sign + axis * LANES + lane] = sign
    for i in range(2):
        phi, half = deflection(p, i, x[0], x[1 + i]), 0.5 * p[P.backlash + i]
        z[Z.flank + i * LANES + lane] = 0.0 if half <= 0.0 or abs(phi) < half else (1.0 if phi > 0.0 else -1.0)
    return free


@compiled
def run_many(rows: Array, states: Array, commands: Array, out: Array) -> None:
    """One run per row (K, N_PARAMETERS), states (K, n) in place, commands (N, 5) shared -> motion out (K, N+1, 6).

    Rows are of one joint (same arrangement), states of one length. Motion is what ideal sensors read: angles with the
    errors that effects give their encoders.
    """
    z, u, y = np.zeros(N_CELLS), np.zeros(N_INPUTS), np.zeros(9)
    modes, weights = np.zeros((LANES, N_MODES), np.int64), np.zeros((LANES, 3, N_WEIGHTS))
    joins = np.zeros(LANES, np.int64)
    for first in range(0, len(rows), LANES):
        _run_block(rows, states, commands, out, first, z, u, y, modes, weights, joins)


@bare
def _run_block(
    rows: Array, states: Array, commands: Array, out: Array, first: int, z: Array, u: Array, y: Array, modes: Array,
    weights: Array, joins: Array,
) -> None:  # fmt: skip
    """The runs from row `first` on, LANES at most; scratch as `run_many` makes it, joins: who goes in lockstep."""
    count, lead = min(LANES, len(rows) - first), rows[first]
    z[:] = 0.0
    gravity = friction = falls = gaps = False
    terms, together, heads = 0, 0, 0
    for lane in range(count):
        p, x = rows[first + lane], states[first + lane]
        begin(p, x, u, modes[lane], weights[lane])
        sense(p, x, out[first + lane, 0])
        _enter(p, z, lane)
        joins[lane] = _written_out(p, modes[lane]) and p[P.substeps] == lead[P.substeps] and p[P.tick] == lead[P.tick]
        together += joins[lane]
        gravity |= p[P.gravity_torque] != 0.0
        for axis in range(3):
            friction |= has_friction(p, axis)
            falls |= p[P.breakaway_friction + axis] != p[P.kinetic_friction + axis]
        for i in range(2):
            gaps |= p[P.backlash + i] > 0.0
            for k in range(N_COEFFICIENTS):
                if p[P.spring + i * N_COEFFICIENTS + k] != 0.0:
                    terms = max(terms, k + 1)
    steps = max(1, int(lead[P.substeps]))
    h = lead[P.tick] / steps
    for tick in range(len(commands)):
        heads = 0
        if together > 1:
            for lane in range(count):
                z[Z.bad + lane] = 1.0
                p, x = rows[first + lane], states[first + lane]
                if joins[lane] != 0 and _place(p, x, z, lane):
                    number, length = int(x[X.tick]), (x.size - X.queue) // QUEUED
                    record(p, x)
                    _drive(p, x, commands[tick], number, number % length, z, lane)
                    own = weights[lane, 2]
                    if own[N_WEIGHTS - 2] != h or own[N_WEIGHTS - 1] != z[Z.damp + lane]:
                        weigh(p, h, z[Z.damp + lane], own)
                        for k in range(3 * PER_AXIS):
                            z[Z.weight + k * LANES + lane] = own[k]
                    z[Z.bad + lane] = 0.0
                    heads += 1
            if heads > 0:
                for _ in range(steps):
                    _step(z, rows, first, terms, gravity, friction, falls, gaps)
        for lane in range(count):
            p, x = rows[first + lane], states[first + lane]
            if heads > 0 and z[Z.bad + lane] == 0.0:
                for i in range(6):
                    x[i] = z[Z.start + i * LANES + lane]
                x[X.tick] += 1.0
            else:
                advance_tick(p, x, commands[tick], u, modes[lane], weights[lane], y)
            sense(p, x, out[first + lane, tick + 1])
