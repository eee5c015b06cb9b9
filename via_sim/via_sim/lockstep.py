"""Many parameter rows of one joint under commands of one recording: LANES runs in lockstep, in vector registers.

Between events the right-hand side is smooth (torques.py), and most ticks of most runs have none. So a block of runs
takes the same Krogstad step together, every operation a loop over lanes that the compiler turns into vector
instructions: the link's angle of lane l stands in z[Z.start, l]. A lane in which an axis comes to a stop, breaks away,
crosses a flank of its gap, meets a wall or whose Maxwell element begins to slip takes this tick again on its own
(`kernel.advance_tick`), and so does one with what is not written out here (fractions of a tick of dead time, servos,
a position drive whose goal is limited in speed or lags, or whose encoder is off its axis).
Results differ from those of `kernel.run` by rounding only: sine and exponential are polynomials here, right to 1e-13,
because a call of the library's would break the vector loop.
"""

from __future__ import annotations

from collections import namedtuple
from math import exp, floor, inf
from typing import Any

import numpy as np
from via_core.dampers import damper_value
from via_core.signals import Array
from via_core.springs import EXPONENTIAL, N_COEFFICIENTS, ODD_POLYNOMIAL, SINH

from via_sim.actuation import saturated
from via_sim.encoders import true_motion
from via_sim.friction import feels_both_sides, has_friction
from via_sim.kernel import N_WEIGHTS, PER_AXIS, advance_tick, begin, weigh
from via_sim.parameters import (
    ABSENT,
    AT_TRANSMISSION,
    DYNAMIC,
    NO_DAMPER,
    POSITION_DRIVE,
    RIPPLE_HARMONICS,
    TORQUE_DRIVE,
    P,
)
from via_sim.position_drive import drive_torque
from via_sim.readings import record, sense, stride
from via_sim.torques import (
    ARM,
    DAMPING,
    EVERY,
    EXTERNAL,
    GOAL,
    N_INPUTS,
    N_MODES,
    NEIGHBOUR,
    POWER,
    QUEUED,
    X,
    bare,
    compiled,
    deflection,
    preset_of,
    spring_factor,
    transmission_torque,
)

LANES = 32
FEWEST = 4  # lanes together: fewer are as fast one by one
_VECTOR = 8  # lanes come in such groups: what the widest vector registers hold
_ENOUGH = 1e300  # [N m] margin of what is not watched

# Rows of the block's memory z, LANES numbers each; names in capitals are those of one lane in the scalar kernel.
#   START 6: state at the beginning of a step; AT 6: where torques are evaluated; N, A, B, D 3 each: torques of the
#   stages; MIDDLE 3: speeds; INPUT 3: torque on link, motor 1, motor 2; BESIDE 3: what of it is not a drive's;
#   DAMP 1; FACTOR 2: of the springs; SIGN 3: direction of slip, 0 without friction; HELD 3: 1 where an axis stands;
#   MARGIN 1: positive while the lane has kept its modes; FLANK 2; SPRING 2: torques; PHI, INSIDE, SLOPE 1: scratch;
#   LOADED, ADDED 1: friction from the load at any speed, what standstill adds to it; COUNTER 1: counter torque;
#   WEIGHT 60 as of `weigh`; BRISTLE 3, MAXWELL 2: torques held when the step began; SLIP 2: direction in
#   which a Maxwell element slips, 0 where it sticks; TOUCH 1: 1 where the wall is; LAG 3: drive torques behind the lag,
#   ASKED 3: before it; then what the parameter rows say (RISE, FALL, GROWTH of springs that grow exponentially; LEVEL,
#   BEND of bristles, MOST, GIVE of Maxwell elements; RUB of spring dampers; WALL, PUSH, SOFTEN, SIDE, OPEN of the wall;
#   KEPT: share of a lag that is left at the beginning, the middle and the end of a step). Of a position drive AIM 1:
#   goal less the encoder's offset, PULL 1: torque per error, REACH 1: most of it, STRENGTH, SHIFT 1: gain and bias
#   while it is on, OWN 1: its torque but for kd, BRAKE 1: kd while it is on.
_SIZES = {
    "start": 6, "at": 6, "n": 3, "a": 3, "b": 3, "d": 3, "middle": 3, "input": 3, "beside": 3, "damp": 1,
    "factor": 2, "sign": 3, "held": 3, "margin": 1, "flank": 2, "spring": 2, "phi": 1, "inside": 1, "slope": 1,
    "loaded": 1, "added": 1, "counter": 1, "weight": 3 * PER_AXIS, "bristle": 3, "maxwell": 2, "slip": 2, "touch": 1,
    "lag": 3, "asked": 3,
    "kinetic": 3, "excess": 3, "inverse": 3, "asymmetry": 3, "viscous": 3, "load": 3, "gravity": 1, "angle": 1,
    "coefficient": 2 * N_COEFFICIENTS, "stop": 2, "hardening": 2, "offset": 2, "half": 2,
    "solid": 2, "rise": 2, "fall": 2, "growth": 2, "level": 3, "bend": 3, "most": 2, "give": 2, "drag": 3,
    "rub": 2, "wall": 1, "push": 1, "soften": 1, "side": 1, "open": 1,
    "gain": 3, "bias": 3, "kept": 3, "ripple": 3 * RIPPLE_HARMONICS, "order": 3 * RIPPLE_HARMONICS,
    "phase": 3 * RIPPLE_HARMONICS, "opposed": 3, "standing": 3, "opposed_standing": 3, "squared": 3, "fading": 3,
    "aim": 1, "pull": 1, "reach": 1, "strength": 1, "shift": 1, "own": 1, "brake": 1,
}  # fmt: skip
_Rows = namedtuple("_Rows", list(_SIZES))  # type: ignore[misc]
Z: Any = _Rows(*(int(s) for s in np.cumsum((0, *list(_SIZES.values())[:-1]))))
_N_ROWS = sum(_SIZES.values())

# Bits of what some lane of a block has and most joints lack: of the first three one for each axis or transmission, of
# the last one for each axis of each harmonic.
_BRISTLE, _DRAG, _MAXWELL, _RUB, _WALL, _LAG, _LOADS, _POSITION, _RIPPLE = 0, 3, 6, 8, 9, 10, 11, 12, 13


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
    """exp(-x) for x > -30, without a branch: Taylor of exp(-x/1024), squared ten times."""
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
def _copy(z: Array, source: int, target: int, count: int) -> None:
    for row in range(count):
        for lane in range(z.shape[1]):
            z[target + row, lane] = z[source + row, lane]


@bare
def _add(z: Array, source: int, target: int, count: int) -> None:
    for row in range(count):
        for lane in range(z.shape[1]):
            z[target + row, lane] += z[source + row, lane]


@bare
def _supply(z: Array, moment: int) -> None:
    """`actuation.supply` at the beginning, the middle or the end of a step; without a lag what is asked for acts."""
    kept = Z.kept + moment
    for axis in range(3):
        here = axis
        for lane in range(z.shape[1]):
            asked = z[Z.asked + here, lane]
            torque = asked + (z[Z.lag + here, lane] - asked) * z[kept, lane]
            z[Z.input + here, lane] = (
                z[Z.beside + here, lane] + z[Z.gain + here, lane] * torque + z[Z.bias + here, lane]
            )


@bare
def _bristle(z: Array, axis: int, lane: int) -> float:
    """`torques.bristle_torque` at AT; an axis that stands keeps what it holds, one without a bristle has none."""
    sign, held = z[Z.sign + axis, lane], z[Z.bristle + axis, lane]
    end, travel = sign * z[Z.level + axis, lane], z[Z.at + axis, lane] - z[Z.start + axis, lane]
    return end + (held - end) * _decay(max(sign * travel * z[Z.bend + axis, lane], -1.0))


@bare
def _maxwell(z: Array, i: int, lane: int) -> float:
    """`torques.maxwell_torque` at AT."""
    slip, motor = z[Z.slip + i, lane], 1 + i
    travel = (z[Z.at, lane] - z[Z.at + motor, lane]) - (z[Z.start, lane] - z[Z.start + motor, lane])
    stuck = z[Z.maxwell + i, lane] + z[Z.give + i, lane] * travel
    return slip * z[Z.most + i, lane] + (1.0 - abs(slip)) * stuck


@bare
def _rare_torques(z: Array, axes: int, out: int, rare: int) -> None:
    """Terms of the bits `rare`, added to three rows from `out` on."""
    if rare >> _POSITION & 1:  # as `position_drive.drive_torque`
        for lane in range(z.shape[1]):
            reach = z[Z.reach, lane]
            torque = min(max(z[Z.pull, lane] * (z[Z.aim, lane] - z[Z.at, lane]), -reach), reach)
            z[Z.own, lane] = z[Z.strength, lane] * torque + z[Z.shift, lane]
            z[out, lane] += z[Z.own, lane]
    for axis in range(axes):
        here = axis
        if rare >> (_DRAG + axis) & 1:
            for lane in range(z.shape[1]):
                v = z[Z.at + 3 + here, lane]
                z[out + here, lane] -= z[Z.drag + here, lane] * v * abs(v)
        if rare >> _RIPPLE != 0:
            for k in range(axis, 3 * RIPPLE_HARMONICS, 3):
                if rare >> (_RIPPLE + k) & 1:
                    for lane in range(z.shape[1]):
                        turned = z[Z.order + k, lane] * z[Z.at + here, lane] + z[Z.phase + k, lane]
                        z[out + here, lane] += z[Z.ripple + k, lane] * _sine(turned)
        if rare >> (_BRISTLE + axis) & 1:
            for lane in range(z.shape[1]):
                z[out + here, lane] -= _bristle(z, here, lane)
    for i in range(2):
        motor, number = 1 + i, i
        if rare >> (_MAXWELL + i) & 1:
            for lane in range(z.shape[1]):
                torque = _maxwell(z, number, lane)
                z[out, lane] -= torque
                z[out + motor, lane] += torque
        if rare >> _RUB & 1:  # of the dampers only what couples; the diagonal part is in `weigh`
            for lane in range(z.shape[1]):
                rub = z[Z.rub + number, lane]
                z[out, lane] += rub * z[Z.at + 3 + motor, lane]
                z[out + motor, lane] += rub * z[Z.at + 3, lane]
    if rare >> _WALL & 1:
        for lane in range(z.shape[1]):
            z[out, lane] += _wall(z, lane)


@bare
def _check_rare(z: Array, rare: int) -> None:
    """MARGIN not positive where a Maxwell element begins or ceases to slip, or the wall is met or left."""
    for i in range(2):
        motor, number = 1 + i, i
        if rare >> (_MAXWELL + i) & 1:
            for lane in range(z.shape[1]):
                slip, absent = z[Z.slip + number, lane], 1.0 if z[Z.most + number, lane] == 0.0 else 0.0
                sliding = slip * (z[Z.at + 3, lane] - z[Z.at + 3 + motor, lane])
                sticking = z[Z.most + number, lane] - abs(_maxwell(z, number, lane))
                kept = abs(slip) * sliding + (1.0 - abs(slip)) * sticking + absent
                z[Z.margin, lane] = min(z[Z.margin, lane], kept)
    if rare >> _WALL & 1:
        for lane in range(z.shape[1]):
            depth = z[Z.side, lane] * (z[Z.at, lane] - z[Z.wall, lane])
            z[Z.margin, lane] = min(z[Z.margin, lane], (2.0 * z[Z.touch, lane] - 1.0) * depth + z[Z.open, lane])


@bare
def _remember(z: Array, axes: int, rare: int) -> None:
    """Elements with memory go along from START to AT, as `torques.remember`."""
    for axis in range(axes):
        here = axis
        if rare >> (_BRISTLE + axis) & 1:
            for lane in range(z.shape[1]):
                z[Z.bristle + here, lane] = _bristle(z, here, lane)
    for i in range(2):
        number = i
        if rare >> (_MAXWELL + i) & 1:
            for lane in range(z.shape[1]):
                most = z[Z.most + number, lane]
                z[Z.maxwell + number, lane] = min(max(_maxwell(z, number, lane), -most), most)
    if rare >> _LAG & 1:
        for axis in range(3):
            here = axis
            for lane in range(z.shape[1]):
                asked = z[Z.asked + here, lane]
                z[Z.lag + here, lane] = asked + (z[Z.lag + here, lane] - asked) * z[Z.kept + 2, lane]


@bare
def _springs(z: Array, rows: Array, first: int, terms: int) -> None:
    """Torque of each transmission at z's angles AT -> SPRING; `terms` of the polynomials are not zero."""
    p = rows[first]
    for i in range(int(p[P.transmissions])):
        at, motor, spring, factor = Z.at, Z.at + (1 + i), Z.spring + i, Z.factor + i
        flank, half, stop = Z.flank + i, Z.half + i, Z.stop + i
        hardening, offset = Z.hardening + i, Z.offset + i
        kind, rise, fall, growth = int(p[P.spring_kind + i]), Z.rise + i, Z.fall + i, Z.growth + i
        if kind != ODD_POLYNOMIAL and kind != SINH and kind != EXPONENTIAL:
            for lane in range(z.shape[1]):
                row = rows[min(first + lane, len(rows) - 1)]
                start = P.spring + i * N_COEFFICIENTS
                q, m1, m2 = z[at, lane], z[at + 1, lane], z[at + 2, lane]
                phi, preset = deflection(row, i, q, z[motor, lane]), preset_of(row, i, m1, m2)
                law = row[start : start + N_COEFFICIENTS]
                z[spring, lane] = transmission_torque(row, law, i, phi, preset, int(z[flank, lane]), z[factor, lane])
            continue
        for lane in range(z.shape[1]):
            phi = z[at, lane] - z[motor, lane] - z[offset, lane] - z[flank, lane] * z[half, lane]
            z[Z.phi, lane] = phi
            z[Z.inside, lane] = min(max(phi, -z[stop, lane]), z[stop, lane])
            z[spring, lane] = z[Z.slope, lane] = 0.0
        if kind == ODD_POLYNOMIAL:
            for k in range(terms - 1, -1, -1):
                law, odd = Z.coefficient + (i * N_COEFFICIENTS + k), 2.0 * k + 1.0
                for lane in range(z.shape[1]):
                    square = z[Z.inside, lane] * z[Z.inside, lane]
                    z[spring, lane] = z[spring, lane] * square + z[law, lane]
                    z[Z.slope, lane] = z[Z.slope, lane] * square + odd * z[law, lane]
            for lane in range(z.shape[1]):
                z[spring, lane] *= z[Z.inside, lane]
        else:
            for lane in range(z.shape[1]):
                grown = _decay(-z[growth, lane] * z[Z.inside, lane])
                pulled, released = z[rise, lane] * grown, z[fall, lane] / grown
                z[spring, lane] = pulled - released
                z[Z.slope, lane] = z[growth, lane] * (pulled + released)
        for lane in range(z.shape[1]):
            phi, inside = z[Z.phi, lane], z[Z.inside, lane]
            torque = z[spring, lane] + max(z[Z.slope, lane], 0.0) * (phi - inside)
            share = 1.0 + z[hardening, lane] * phi * phi
            share = share if phi == inside else max(share, 0.0)
            within = z[half, lane] > 0.0 and z[flank, lane] == 0.0
            z[spring, lane] = 0.0 if within else z[factor, lane] * share * torque


@bare
def _counter(z: Array, axis: int, count: int, gravity: bool, rare: int) -> None:
    """Counter torque of an axis with `count` transmissions in the joint -> COUNTER, as `torques.motive_torques`."""
    if axis > 0:
        for lane in range(z.shape[1]):
            z[Z.counter, lane] = z[Z.input + axis, lane] - z[Z.beside + axis, lane]
        return
    for lane in range(z.shape[1]):
        z[Z.counter, lane] = z[Z.beside, lane] if count == 0 else z[Z.input, lane]
    if gravity:
        for lane in range(z.shape[1]):
            z[Z.counter, lane] -= z[Z.gravity, lane] * _sine(z[Z.at, lane] - z[Z.angle, lane])
    if rare >> _WALL & 1:
        for lane in range(z.shape[1]):
            z[Z.counter, lane] += _wall(z, lane)


@bare
def _wall(z: Array, lane: int) -> float:
    """`torques.contact_torque` at AT, 0 where the wall is not touched."""
    side, depth = z[Z.side, lane], z[Z.at, lane] - z[Z.wall, lane]
    push = side * (z[Z.push, lane] * depth + z[Z.soften, lane] * z[Z.at + 3, lane])
    return -z[Z.touch, lane] * side * max(push, 0.0)


@bare
def _torques(
    z: Array, rows: Array, first: int, axes: int, out: int, terms: int, gravity: bool, friction: int, falls: bool,
    holds: bool, rare: int,
) -> None:  # fmt: skip
    """Torque on each axis but for its viscous friction, at angles and velocities AT -> three rows from `out` on."""
    p = rows[first]
    for lane in range(z.shape[1]):
        z[out, lane] = z[Z.input, lane]
        z[out + 1, lane] = z[Z.input + 1, lane]
        z[out + 2, lane] = z[Z.input + 2, lane]
    if gravity:
        for lane in range(z.shape[1]):
            z[out, lane] -= z[Z.gravity, lane] * _sine(z[Z.at, lane] - z[Z.angle, lane])
    if p[P.damper_site] == AT_TRANSMISSION:
        for lane in range(z.shape[1]):
            z[out, lane] += z[Z.damp, lane] * z[Z.at + 4, lane]
            z[out + 1, lane] += z[Z.damp, lane] * z[Z.at + 3, lane]
    _springs(z, rows, first, terms)
    count = int(p[P.transmissions])
    for i in range(count):
        for lane in range(z.shape[1]):
            z[out, lane] -= z[Z.spring + i, lane]
            z[out + (1 + i), lane] += z[Z.spring + i, lane]
    if rare != 0:
        _rare_torques(z, axes, out, rare)
    for axis in range(axes):
        if not friction >> axis & 1:
            continue
        here = axis
        if count == 0:
            for lane in range(z.shape[1]):
                z[Z.loaded, lane] = z[Z.input, lane] - z[Z.beside, lane]
            if rare >> _POSITION & 1:
                for lane in range(z.shape[1]):
                    z[Z.loaded, lane] = z[Z.own, lane] - z[Z.brake, lane] * z[Z.at + 3, lane]
        elif axis == 0:
            for lane in range(z.shape[1]):
                z[Z.loaded, lane] = -(z[Z.spring, lane] + z[Z.spring + 1, lane])
        else:
            for lane in range(z.shape[1]):
                z[Z.loaded, lane] = z[Z.spring + here - 1, lane]
        if rare >> _LOADS & 1:
            _counter(z, here, count, gravity, rare)
            for lane in range(z.shape[1]):
                load, counter = z[Z.loaded, lane], z[Z.counter, lane]
                squared = min(abs(load), abs(counter)) ** 2 if load * counter < 0.0 else 0.0
                added = z[Z.standing + here, lane] * load - z[Z.opposed_standing + here, lane] * counter
                z[Z.loaded, lane] = abs(z[Z.load + here, lane] * load - z[Z.opposed + here, lane] * counter)
                z[Z.added, lane] = abs(added) + z[Z.squared + here, lane] * squared
        else:
            for lane in range(z.shape[1]):
                z[Z.loaded, lane] = z[Z.load + here, lane] * abs(z[Z.loaded, lane])
        for lane in range(z.shape[1]):
            sign, v = z[Z.sign + here, lane], z[Z.at + 3 + here, lane]
            size = z[Z.kinetic + here, lane] + z[Z.loaded, lane]
            size += sign * (z[Z.asymmetry + here, lane] + z[Z.viscous + here, lane] * sign * v)
            z[out + here, lane] -= sign * size
        if falls:
            for lane in range(z.shape[1]):
                ratio = z[Z.at + 3 + here, lane] * z[Z.inverse + here, lane]
                excess = z[Z.excess + here, lane] * _decay(ratio * ratio)
                z[out + here, lane] -= z[Z.sign + here, lane] * excess
        if rare >> _LOADS & 1:
            for lane in range(z.shape[1]):
                ratio = z[Z.at + 3 + here, lane] * z[Z.fading + here, lane]
                z[out + here, lane] -= z[Z.sign + here, lane] * z[Z.added, lane] * _decay(ratio * ratio)
        if holds:  # friction takes all of the torque on an axis that stands, as long as it can
            for lane in range(z.shape[1]):
                held, torque, skewed = z[Z.held + here, lane], z[out + here, lane], z[Z.asymmetry + here, lane]
                most = z[Z.kinetic + here, lane] + z[Z.excess + here, lane] + z[Z.loaded, lane] + z[Z.added, lane]
                room = min(most + skewed - torque, most - skewed + torque) + (1.0 - held) * _ENOUGH
                z[Z.margin, lane] = min(z[Z.margin, lane], room)
                z[out + here, lane] = (1.0 - held) * torque


@bare
def _stage(z: Array, axes: int, base: int, one: int, torque_one: int, two: int, torque_two: int) -> None:
    """Angles and velocities -> AT: linear part of weights `base`, plus weights `one` and `two` times two torques."""
    for axis in range(axes):
        w, n, m = Z.weight + PER_AXIS * axis, torque_one + axis, torque_two + axis
        for lane in range(z.shape[1]):
            first, second, speed = z[n, lane], z[m, lane], z[Z.start + 3 + axis, lane]
            z[Z.at + axis, lane] = (
                z[Z.start + axis, lane]
                + z[w + base + 1, lane] * speed
                + z[w + one + 1, lane] * first
                + z[w + two + 1, lane] * second
            )
            z[Z.at + 3 + axis, lane] = z[w + base, lane] * speed + z[w + one, lane] * first + z[w + two, lane] * second


@bare
def _check(z: Array, velocity: int, axes: int, friction: int, transmissions: int) -> None:
    """MARGIN not positive where a slipping axis has stopped or runs backwards (rows `velocity`), or a flank is left."""
    for axis in range(axes):
        if friction >> axis & 1:
            for lane in range(z.shape[1]):
                sign = z[Z.sign + axis, lane]
                ahead = sign * z[velocity + axis, lane] + 1.0 - abs(sign)
                z[Z.margin, lane] = min(z[Z.margin, lane], ahead)
    for i in range(transmissions):
        for lane in range(z.shape[1]):
            half, flank = z[Z.half + i, lane], z[Z.flank + i, lane]
            phi = z[Z.at, lane] - z[Z.at + 1 + i, lane] - z[Z.offset + i, lane]
            beyond, inside = flank * phi - half, half - abs(phi)
            kept = abs(flank) * beyond + (1.0 - abs(flank)) * inside + z[Z.solid + i, lane]
            z[Z.margin, lane] = min(z[Z.margin, lane], kept)


@bare
def _step(
    z: Array, rows: Array, first: int, axes: int, terms: int, gravity: bool, friction: int, falls: bool, gaps: int,
    holds: bool, rare: int,
) -> None:  # fmt: skip
    """One Krogstad step of the block, as `kernel._step`: START moves on, MARGIN says which lanes may not.

    axes: there are; friction: bit per axis; gaps: transmissions to watch; holds: whether any axis stands; rare: bits of
    terms that most joints lack.
    """
    lags = rare >> _LAG & 1 != 0
    _copy(z, Z.start, Z.at, 6)
    if lags:
        _supply(z, 0)
    _torques(z, rows, first, axes, Z.n, terms, gravity, friction, falls, holds, rare)
    for axis in range(axes):
        for lane in range(z.shape[1]):
            z[Z.a + axis, lane] = 0.0
    _stage(z, axes, 0, 4, Z.n, 8, Z.a)
    if friction != 0:
        _copy(z, Z.at + 3, Z.middle, axes)
    if lags:
        _supply(z, 1)
    _torques(z, rows, first, axes, Z.a, terms, gravity, friction, falls, holds, rare)
    _stage(z, axes, 0, 6, Z.n, 8, Z.a)
    if friction != 0:
        _add(z, Z.at + 3, Z.middle, axes)  # twice the speed at the midpoint
        _check(z, Z.middle, axes, friction, 0)
    _torques(z, rows, first, axes, Z.b, terms, gravity, friction, falls, holds, rare)
    _stage(z, axes, 2, 10, Z.n, 12, Z.b)
    if lags:
        _supply(z, 2)
    _torques(z, rows, first, axes, Z.d, terms, gravity, friction, falls, holds, rare)
    _add(z, Z.b, Z.a, axes)
    _stage(z, axes, 2, 14, Z.n, 16, Z.a)
    for axis in range(axes):
        w = Z.weight + PER_AXIS * axis
        for lane in range(z.shape[1]):
            z[Z.at + axis, lane] += z[w + 19, lane] * z[Z.d + axis, lane]
            z[Z.at + 3 + axis, lane] += z[w + 18, lane] * z[Z.d + axis, lane]
    _check(z, Z.at + 3, axes, friction, gaps)
    if holds:
        _torques(z, rows, first, axes, Z.n, terms, gravity, friction, falls, holds, rare)
    if rare != 0:
        _check_rare(z, rare)
        _remember(z, axes, rare)
    _copy(z, Z.at, Z.start, 6)


@bare
def _written_out(p: Array) -> bool:
    """Whether this file has all the terms that a prepared row asks for."""
    whole = floor(p[P.delay] / p[P.tick] + 1e-9)
    fraction = p[P.delay] - whole * p[P.tick] >= 1e-9 * p[P.tick]
    known = not fraction
    for axis in range(1, 3):
        known &= p[P.axis_kind + axis] <= DYNAMIC
    if p[P.link_drive] == POSITION_DRIVE:
        known &= p[P.lag] <= 0.0 and p[P.drive_speed_limit] == inf and p[P.encoder_harmonics] == 0.0
    return known


@bare
def _enter(p: Array, z: Array, lane: int) -> None:
    """A parameter row into its lane."""
    for axis in range(3):
        here = axis
        slips = has_friction(p, axis)
        z[Z.kinetic + here, lane] = p[P.kinetic_friction + axis] if slips else 0.0
        z[Z.excess + here, lane] = p[P.breakaway_friction + axis] - p[P.kinetic_friction + axis] if slips else 0.0
        z[Z.inverse + here, lane] = 1.0 / p[P.stribeck_velocity + axis]
        z[Z.asymmetry + here, lane], z[Z.viscous + here, lane] = (
            p[P.friction_asymmetry + axis],
            p[P.viscous_asymmetry + axis],
        )
        z[Z.load + here, lane], z[Z.opposed + here, lane] = p[P.load_friction + axis], p[P.counter_friction + axis]
        z[Z.standing + here, lane] = p[P.load_stribeck + axis]
        z[Z.opposed_standing + here, lane] = p[P.counter_stribeck + axis]
        z[Z.squared + here, lane] = p[P.load_quadratic + axis]
        z[Z.fading + here, lane] = 1.0 / p[P.load_velocity + axis]
        level = max(p[P.bristle_torque + axis], 0.0)
        z[Z.level + here, lane] = level
        z[Z.bend + here, lane] = p[P.bristle_stiffness + axis] / level if level > 0.0 else 0.0
        z[Z.drag + here, lane] = p[P.quadratic_drag + axis]
        for k in range(axis, 3 * RIPPLE_HARMONICS, 3):
            z[Z.ripple + k, lane], z[Z.order + k, lane] = p[P.ripple_amplitude + k], p[P.ripple_order + k]
            z[Z.phase + k, lane] = p[P.ripple_phase + k]
        driven = p[P.link_drive] == TORQUE_DRIVE if axis == 0 else p[P.axis_kind + axis] == DYNAMIC
        z[Z.gain + here, lane] = p[P.torque_gain + axis] if driven else 0.0
        z[Z.bias + here, lane] = p[P.torque_bias + axis] if driven else 0.0
        share = 0.5 * axis * p[P.tick] / max(1.0, floor(p[P.substeps]))
        z[Z.kept + here, lane] = exp(-share / p[P.lag]) if p[P.lag] > 0.0 else 0.0
    z[Z.pull, lane], z[Z.reach, lane] = p[P.drive_stiffness], min(p[P.drive_torque_limit], p[P.saturation])
    z[Z.gravity, lane], z[Z.angle, lane] = p[P.gravity_torque], p[P.gravity_angle]
    for k in range(2 * N_COEFFICIENTS):
        z[Z.coefficient + k, lane] = p[P.spring + k]
    for i in range(2):
        here = i
        z[Z.stop + here, lane], z[Z.hardening + here, lane] = p[P.stop + i], p[P.spring_hardening + i]
        z[Z.offset + here, lane] = p[P.pretension_offset + i] if p[P.serial] == 0.0 else 0.0
        z[Z.half + here, lane] = 0.5 * p[P.backlash + i]
        z[Z.solid + here, lane] = 0.0 if p[P.backlash + i] > 0.0 else inf
        start, kind = P.spring + i * N_COEFFICIENTS, int(p[P.spring_kind + i])
        if kind == SINH:
            z[Z.rise + here, lane] = z[Z.fall + here, lane] = 0.5 * p[start]
            z[Z.growth + here, lane] = p[start + 1]
        elif kind == EXPONENTIAL:
            z[Z.rise + here, lane], z[Z.fall + here, lane] = p[start], p[start + 1]
            z[Z.growth + here, lane] = p[start + 2]
        z[Z.most + here, lane] = max(p[P.hysteresis_torque + i], 0.0)
        z[Z.give + here, lane] = p[P.hysteresis_stiffness + i] if p[P.hysteresis_torque + i] > 0.0 else 0.0
        z[Z.rub + here, lane] = p[P.spring_damping + i]
    there = p[P.contact_stiffness] > 0.0
    z[Z.wall, lane], z[Z.side, lane] = p[P.contact_angle], p[P.contact_side]
    z[Z.push, lane] = p[P.contact_stiffness] if there else 0.0
    z[Z.soften, lane] = p[P.contact_damping] if there else 0.0
    z[Z.open, lane] = 0.0 if there else inf


@bare
def _held(x: Array, slot: int, late: int) -> int:
    """Where in state x the command stands that acts now, `late` ticks after it came; the newest one is at `slot`."""
    turn = slot - late
    return X.queue + QUEUED * (turn if turn >= 0 else turn + (x.size - X.queue) // QUEUED)


@bare
def _drive(p: Array, x: Array, command: Array, slot: int, late: int, age: float, z: Array, lane: int) -> None:
    """Inputs of a lane over a tick -> z, and the tick's command into the queue of x, which it heads at `slot`."""
    held = _held(x, slot, late)
    for i in range(QUEUED):
        x[X.queue + QUEUED * slot + i] = command[i]
    neighbour = command[NEIGHBOUR]
    link = (p[P.coupling] + p[P.coupling + 1] + p[P.coupling + 2]) * neighbour + command[ARM]
    if p[P.link_drive] != TORQUE_DRIVE:
        link += command[EXTERNAL]
    if p[P.pulse_torque] != 0.0:
        overlap = min(age + p[P.tick], p[P.pulse_stop]) - max(age, p[P.pulse_start])
        link += p[P.pulse_torque] * max(overlap, 0.0) / p[P.tick]
    z[Z.beside, lane], z[Z.asked, lane] = link, saturated(p, 0, x[held + EXTERNAL])
    if p[P.link_drive] == TORQUE_DRIVE:
        link += p[P.torque_gain] * z[Z.asked, lane] + p[P.torque_bias]
    if p[P.link_drive] == POSITION_DRIVE:
        power = 1.0 if x[held + POWER] > 0.5 else 0.0
        z[Z.aim, lane], z[Z.brake, lane] = x[held + GOAL] - p[P.encoder_offset], power * p[P.drive_damping]
        z[Z.strength, lane], z[Z.shift, lane] = power * p[P.torque_gain], power * p[P.torque_bias]
    z[Z.input, lane] = link
    for i in range(2):
        limit = p[P.torque_limit + i]
        asked = saturated(p, 1 + i, min(max(x[held + i], -limit), limit))
        z[Z.asked + 1 + i, lane] = asked
        if p[P.axis_kind + 1 + i] == DYNAMIC:
            torque = p[P.torque_gain + 1 + i] * asked + p[P.torque_bias + 1 + i] - p[P.coupling + 1 + i] * neighbour
            z[Z.input + 1 + i, lane] = torque
            z[Z.beside + 1 + i, lane] = -p[P.coupling + 1 + i] * neighbour
            z[Z.factor + i, lane] = spring_factor(p, i, age + 0.5 * p[P.tick])
    damping = 0.0
    if p[P.damper_site] != NO_DAMPER:
        damping = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[held + DAMPING])
    z[Z.damp, lane] = damping + z[Z.brake, lane]


@bare
def _note(p: Array, x: Array, command: Array, slot: int, late: int, z: Array, lane: int) -> None:
    """What acted last into state x, as `kernel.advance_tick` leaves it there."""
    held = _held(x, slot, late)
    x[X.beside] = z[Z.beside, lane]
    x[X.external], x[X.damping] = z[Z.input, lane], z[Z.damp, lane] - z[Z.brake, lane]
    positioned = p[P.link_drive] == POSITION_DRIVE  # its goal is behind nothing here
    if positioned:
        x[X.external] += drive_torque(p, x[held + GOAL], 1.0 if x[held + POWER] > 0.5 else 0.0, x[0])
        x[X.external] -= z[Z.brake, lane] * x[3]
    else:
        x[X.lag] = saturated(p, 0, x[held + EXTERNAL])
    for i in range(2):
        limit = p[P.torque_limit + i]
        x[X.reported_torque + i] = min(max(command[i], -limit), limit)
        x[X.motor_torque + i] = z[Z.input + 1 + i, lane]
        if not positioned:
            x[X.lag + 1 + i] = saturated(p, 1 + i, min(max(x[held + i], -limit), limit))


@bare
def _place(p: Array, x: Array, z: Array, lane: int) -> bool:
    """State x into its lane -> whether an axis stands there (friction may still be too weak to hold it)."""
    stands = False
    for i in range(6):
        z[Z.start + i, lane] = x[i]
    for axis in range(3):
        sign = held = 0.0
        if has_friction(p, axis):
            if x[3 + axis] == 0.0:
                held, stands = 1.0, True
            else:
                sign = 1.0 if x[3 + axis] > 0.0 else -1.0
        z[Z.sign + axis, lane], z[Z.held + axis, lane] = sign, held
        z[Z.bristle + axis, lane] = x[X.bristle + axis] if p[P.bristle_torque + axis] > 0.0 else 0.0
        z[Z.lag + axis, lane] = x[X.lag + axis]
    for i in range(2):
        phi, half = deflection(p, i, x[0], x[1 + i]), 0.5 * p[P.backlash + i]
        z[Z.flank + i, lane] = 0.0 if half <= 0.0 or abs(phi) < half else (1.0 if phi > 0.0 else -1.0)
        level = p[P.hysteresis_torque + i]
        torque = x[X.hysteresis + i] if level > 0.0 else 0.0
        slips = abs(torque) >= level > 0.0 and torque * (x[3] - x[4 + i]) > 0.0
        z[Z.maxwell + i, lane] = torque
        z[Z.slip + i, lane] = (1.0 if torque > 0.0 else -1.0) if slips else 0.0
    depth = p[P.contact_side] * (x[0] - p[P.contact_angle])
    touches = depth > 0.0 or (depth == 0.0 and p[P.contact_side] * x[3] > 0.0)
    z[Z.touch, lane] = 1.0 if touches and p[P.contact_stiffness] > 0.0 else 0.0
    return stands


@bare
def _rare_bits(p: Array) -> int:
    """Which terms a row has that most joints lack."""
    bits = int(p[P.contact_stiffness] > 0.0) << _WALL | int(p[P.lag] > 0.0) << _LAG
    bits |= int(p[P.link_drive] == POSITION_DRIVE) << _POSITION
    for axis in range(3):
        bits |= int(p[P.bristle_torque + axis] > 0.0) << (_BRISTLE + axis)
        bits |= int(p[P.quadratic_drag + axis] != 0.0) << (_DRAG + axis)
        bits |= int(feels_both_sides(p, axis)) << _LOADS
        for k in range(axis, 3 * RIPPLE_HARMONICS, 3):
            bits |= int(p[P.ripple_amplitude + k] != 0.0) << (_RIPPLE + k)
    for i in range(2):
        bits |= int(p[P.hysteresis_torque + i] > 0.0) << (_MAXWELL + i)
        bits |= int(p[P.spring_damping + i] != 0.0) << _RUB
    return bits


@bare
def _terms_of(rows: Array, first: int, count: int) -> tuple[int, int, bool, int, bool, int, int]:
    """Arguments of `_step` from rows: (axes, terms, gravity, friction, falls, gaps, rare).

    On its own because numba would compile `_step` anew for every type that they have while a loop finds them.
    """
    axes = terms = friction = gaps = rare = 0
    gravity = falls = False
    for lane in range(count):
        p = rows[first + lane]
        gravity |= p[P.gravity_torque] != 0.0
        rare |= _rare_bits(p)
        for axis in range(3):
            if p[P.axis_kind + axis] != ABSENT:
                axes = axis + 1
            friction |= int(has_friction(p, axis)) << axis
            falls |= p[P.breakaway_friction + axis] != p[P.kinetic_friction + axis]
        for i in range(2):
            if p[P.backlash + i] > 0.0:
                gaps = i + 1
            for k in range(N_COEFFICIENTS):
                if p[P.spring + i * N_COEFFICIENTS + k] != 0.0:
                    terms = max(terms, k + 1)
    return axes, terms, gravity, friction, falls, gaps, rare


@compiled
def run_many(rows: Array, states: Array, commands: Array, begins: Any, out: Array) -> None:
    """One run per row (K, N_PARAMETERS) over n ticks, states (K, n) in place -> motion out (K, n+1, 6).

    commands  (N, 5) of a whole recording
    begins    (K,) where each run stands in it at its first tick: runs that begin apart go side by side all the same

    Rows are of one joint (same arrangement), states of one length. Motion is what ideal sensors read: angles with the
    errors that effects give their encoders.
    """
    lead_many(rows, states, commands, begins, np.zeros((0, 6)), np.zeros(0, np.int64), out)


@compiled
def lead_many(
    rows: Array, states: Array, commands: Array, begins: Any, measured: Array, axes: Any, out: Array
) -> None:  # fmt: skip
    """`run_many` with some axes led: set to what was read of them at the beginning of every tick, and at the end.

    measured  (N, 6) angles [rad] and velocities [rad/s] of tick 0 of a state on, as encoders read them
    axes      those that are led (int64)
    """
    u, y = np.zeros(N_INPUTS), np.zeros(9)
    modes, weights = np.zeros((LANES, N_MODES), np.int64), np.zeros((LANES, 3, N_WEIGHTS))
    lanes = np.zeros((6, LANES), np.int64)
    for first in range(0, len(rows), LANES):
        wide = (min(LANES, len(rows) - first) + _VECTOR - 1) // _VECTOR * _VECTOR
        z = np.zeros((_N_ROWS, wide))
        _run_block(rows, states, commands, begins, measured, axes, out, first, z, u, y, modes, weights, lanes)
    if axes.size > 0:
        for k in range(len(rows)):
            _lead(rows[k], states[k], measured, axes)


@bare
def _run_block(
    rows: Array, states: Array, commands: Array, begins: Any, measured: Array, led: Any, out: Array, first: int,
    z: Array, u: Array, y: Array, modes: Array, weights: Array, lanes: Array,
) -> None:  # fmt: skip
    """The runs from row `first` on, LANES at most; scratch as `run_many` makes it.

    lanes (6, LANES): whether a lane goes in lockstep, is in step now, reads its angles as they are; ticks it is late;
    whether an axis of it stands; its tick number at the start
    """
    joins, placed, plain, late, stands, number = lanes[0], lanes[1], lanes[2], lanes[3], lanes[4], lanes[5]
    count, lead, ticks = min(LANES, len(rows) - first), rows[first], out.shape[1] - 1
    period, length = lead[P.tick], (states.shape[1] - X.queue) // QUEUED
    axes, terms, gravity, friction, falls, gaps, rare = _terms_of(rows, first, count)
    together = 0
    z[:, :] = 0.0
    for lane in range(count):
        p, x = rows[first + lane], states[first + lane]
        begin(p, x, u, modes[lane], weights[lane])
        sense(p, x, out[first + lane, 0])
        _enter(p, z, lane)
        alike = p[P.substeps] == lead[P.substeps] and p[P.tick] == period
        number[lane] = int(x[X.tick])
        joins[lane], placed[lane], plain[lane] = alike and _written_out(p), 0, _reads_true(p)
        late[lane] = int(p[P.delay] / period + 1e-9)
        together += joins[lane]
    steps, every = max(1, int(lead[P.substeps])), stride(period)
    h = period / steps
    for tick in range(ticks):
        last = tick == ticks - 1
        ready = standing = 0
        if led.size > 0:
            for lane in range(count):
                _lead(rows[first + lane], states[first + lane], measured, led)
                placed[lane] = 0
        if together >= FEWEST:
            for lane in range(count):
                p, x = rows[first + lane], states[first + lane]
                if placed[lane] == 0 and joins[lane] != 0:
                    placed[lane], stands[lane] = 1, _place(p, x, z, lane)
                z[Z.margin, lane] = 2.0 * placed[lane] - 1.0
                if placed[lane] != 0:
                    ready += 1
                    standing += stands[lane]
                    command, now = commands[begins[first + lane] + tick], number[lane] + tick
                    _drive(p, x, command, now % length, late[lane], p[P.origin] + now * period, z, lane)
                    own = weights[lane, 2]
                    if own[N_WEIGHTS - 2] != h or own[N_WEIGHTS - 1] != z[Z.damp, lane]:
                        weigh(p, h, z[Z.damp, lane], own)
                        for k in range(3 * PER_AXIS):
                            z[Z.weight + k, lane] = own[k]
            if ready > 0:
                for _ in range(steps):
                    _step(z, rows, first, axes, terms, gravity, friction, falls, gaps, standing != 0, rare)
        for lane in range(count):
            p, x, motion = rows[first + lane], states[first + lane], out[first + lane, tick + 1]
            command, now = commands[begins[first + lane] + tick], number[lane] + tick
            if ready > 0 and z[Z.margin, lane] > 0.0:
                if now % every == 0:
                    record(x, modes[lane, EVERY])
                for i in range(6):
                    x[i] = z[Z.start + i, lane]
                if rare != 0:
                    for i in range(3):
                        x[X.bristle + i] = z[Z.bristle + i, lane]
                    for i in range(2):
                        x[X.hysteresis + i] = z[Z.maxwell + i, lane]
                x[X.tick] += 1.0
                if last:
                    _note(p, x, command, now % length, late[lane], z, lane)
                if p[P.lag] > 0.0 and joins[lane] != 0:
                    for axis in range(3):
                        x[X.lag + axis] = z[Z.lag + axis, lane]
            else:
                placed[lane] = 0
                advance_tick(p, x, command, u, modes[lane], weights[lane], y)
            if plain[lane] != 0:
                for i in range(6):
                    motion[i] = x[i]
            else:
                sense(p, x, motion)


@bare
def _lead(p: Array, x: Array, measured: Array, axes: Any) -> None:
    """Axes of state x to where they were read at its tick; an encoder that is late read it later."""
    for axis in axes:
        at = min(x[X.tick] + p[P.skew + axis] / p[P.tick], len(measured) - 1.0)
        low = int(at)
        share, high = at - low, min(low + 1, len(measured) - 1)
        angle = (1.0 - share) * measured[low, axis] + share * measured[high, axis]
        speed = (1.0 - share) * measured[low, 3 + axis] + share * measured[high, 3 + axis]
        x[axis], x[3 + axis] = true_motion(p, axis, angle, speed)


@bare
def _reads_true(p: Array) -> bool:
    """Whether encoders read angles as they are."""
    true = True
    for axis in range(3):
        true &= p[P.skew + axis] <= 0.0 and p[P.encoder_harmonics + axis] == 0.0 and p[P.encoder_offset + axis] == 0.0
    return true
