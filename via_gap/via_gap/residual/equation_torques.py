"""Torque of everything but inertia along a log, for every sample and axis, with the effects of a parameter row.

    inertia * acceleration = torque        link, motor 1, motor 2; of a servo  1 * acceleration = w^2 (u - x) - 2 w x'

`equation_torques` evaluates the torque functions that the simulator integrates, so each effect is defined once.
Integrated against modulating functions (via_core.weak_form) both sides agree where the model is right:
inertia <angle, psi''> = <torque, psi>. No measured signal is differentiated; velocities only set the sign of friction.

**Commands are zero-order hold, samples are instants**: each sample gets the mean of the command over its cell
(record.py). A lag T y' = u - y turns the mean of u into that of y: mean(u) - T (y_end - y_begin) / width.
Friction whose sign changes within a cell counts with its mean as well.

**Elements with memory** (bristles, Maxwell elements) follow the increments of the measured angles, from zero torque at
the first sample.

**Sensor effects** are undone first: `angle` is the true angle under the row, and late channels are shifted ahead.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from math import exp, isfinite, nan
from typing import Any

import numpy as np
from via_core.errors import ParameterError
from via_core.servos import servo_acceleration
from via_core.signals import Array, Indices
from via_sim.joint.actuation import couple, servo_bandwidth
from via_sim.joint.compiled import compiled, inlined
from via_sim.joint.encoders import read_motion, true_motion
from via_sim.joint.friction import breakaway, has_friction, viscous_friction
from via_sim.joint.layout import ARM, DAMPING, EXTERNAL, MODE, N_INPUTS, N_MODES, NEIGHBOUR, U, X
from via_sim.joint.parameters import ABSENT, DYNAMIC, N_PARAMETERS, POSITION_DRIVE, SERVO, TORQUE_DRIVE, P
from via_sim.joint.torques import (
    EVERYTHING,
    counter_torque,
    deflection,
    motive_torques,
    prepare,
    preset_of,
    remember,
    spring_factor,
    transmission_torque,
)

from via_gap.residual.cells import ahead, first_goal, mean_goal, slipping_friction
from via_gap.residual.record import Record

_SLEWING = 0.98  # share of its speed limit above which a servo counts as limited

# Columns of the result.
_Columns = namedtuple("_Columns", "torque friction forward backward angle velocity transmission")
_C: Any = _Columns(0, 3, 6, 9, 12, 15, 18)
_N_COLUMNS = 20

# A record with the means of its commands and the commands themselves; the work memory of the walk along it: modes,
# inputs, state, motion, and the command at which the last cell ended.
_Log = namedtuple("_Log", "time angle velocity late prompt sent")
_Work = namedtuple("_Work", "modes u x y at")


@dataclass(frozen=True, eq=False)
class EquationTorques:
    """Torques along a record; axes are link, motor 1, motor 2, NaN for absent or unmeasured axes.

    torque        (N, 3) [N m] all torque except inertia times acceleration; of a servo [rad/s^2]
    friction      (N, 3) [N m] dry friction in `torque` as if the axis slipped; opposes positive motion
    forward       (N, 3) [N m] largest static friction against positive motion; backward: against negative motion
    standing      (N, 3) whether the axis may be at rest: friction then is between -backward and forward
    angle         (N, 3) [rad] with sensor effects undone
    velocity      (N, 3) [rad/s] likewise
    transmission  (N, 2) [N m] torque of each transmission; a torque sensor at the link measures their sum
    inertia       (3,) [kg m^2]; 1 for a servo
    """

    torque: Array
    friction: Array
    forward: Array
    backward: Array
    standing: Any
    angle: Array
    velocity: Array
    transmission: Array
    inertia: Array


def equation_torques(row: Array, record: Record, wanted: Indices | None = None) -> EquationTorques:
    """Torques of a joint with parameter row (N_PARAMETERS,) along a record; tick and substeps of the row are ignored.

    wanted  (n,) ascending indices of the samples to return; None: all N

    Raises ParameterError for a row of another shape.
    """
    p = np.array(row, dtype=np.float64)  # numba would compile again for a read-only row
    if p.shape != (N_PARAMETERS,):
        raise ParameterError(f"a parameter row has shape ({N_PARAMETERS},), got {p.shape}")
    every = np.arange(len(record))
    walked = every if wanted is None or _has_memory(p) else wanted
    out = np.empty((len(walked), _N_COLUMNS))
    motion, sent = (record.angle, record.velocity), (record.command_time, record.commands)
    walk(p, record.time, motion, record.means(p), sent, walked, out)
    if wanted is not None and walked is every:
        out = out[wanted]
    kinds = p[P.axis_kind : P.axis_kind + 3]
    parts = {name: out[:, a : a + 3] for name, a in zip(_C._fields, _C, strict=True)}
    with np.errstate(invalid="ignore"):
        standing = (np.abs(parts["velocity"]) <= record.still) & (kinds == DYNAMIC)
    inertia = np.where(kinds == DYNAMIC, p[P.inertia : P.inertia + 3], 1.0)
    parts["transmission"] = out[:, _C.transmission :]
    return EquationTorques(standing=standing, inertia=inertia, **parts)


def _has_memory(p: Array) -> bool:
    """Whether the torque at a sample depends on more than the sample and its neighbours."""
    limited = p[P.link_drive] == POSITION_DRIVE and (p[P.drive_speed_limit] < np.inf or p[P.integral_rate] > 0.0)
    bristles, slips = p[P.bristle_torque : P.bristle_torque + 3], p[P.hysteresis_torque : P.hysteresis_torque + 2]
    return bool(p[P.lag] > 0.0 or limited or np.any(bristles > 0.0) or np.any(slips > 0.0))


@compiled
def walk(
    p: Array,
    time: Array,
    motion: tuple[Array, Array],
    means: tuple[Array, Array],
    sent: tuple[Array, Array],
    wanted: Any,
    out: Array,
) -> None:
    """Torques at the wanted samples of a record into out (n, 17), see `EquationTorques` and `Record.means`."""
    log = _Log(time, motion[0], motion[1], means[0], means[1], sent)
    work = _Work(np.zeros(N_MODES, np.int64), np.zeros(N_INPUTS), np.zeros(X.queue), np.zeros(6), np.zeros(1, np.int64))
    prepare(p, work.modes)
    for i in range(wanted.size):
        n, last = wanted[i], time.size - 1
        begin, end = 0.5 * (time[max(n - 1, 0)] + time[n]), 0.5 * (time[n] + time[min(n + 1, last)])
        age = p[P.origin] + time[n] - time[0]
        _load_inputs(p, log, n, age, begin, end - begin, work)
        _load_motion(p, log, n, (begin, end - begin), work)
        _store_torques(p, log, n, age, work, out[i])


@inlined
def _load_inputs(p: Array, log: _Log, n: int, age: float, begin: float, width: float, work: _Work) -> None:
    """Mean inputs over the cell of sample n, which begins at `begin` [s]."""
    u, x, late, now = work.u, work.x, log.late[n], log.prompt[n]
    couple(p, now[NEIGHBOUR], now[ARM], u)
    if p[P.link_drive] != TORQUE_DRIVE:
        u[U.beside] += now[EXTERNAL]
    if p[P.pulse_torque] != 0.0 and width > 0.0:
        from_age = age - (log.time[n] - begin)
        overlap = min(from_age + width, p[P.pulse_stop]) - max(from_age, p[P.pulse_start])
        u[U.beside] += p[P.pulse_torque] * max(overlap, 0.0) / width
    u[EXTERNAL], u[DAMPING] = u[U.beside], late[DAMPING]
    for axis in range(3):
        torque = late[EXTERNAL] if axis == 0 else late[axis - 1]
        if p[P.axis_kind + axis] != DYNAMIC or (axis == 0 and p[P.link_drive] != TORQUE_DRIVE):
            continue
        if p[P.lag] > 0.0:
            if n == 0:
                x[X.lag + axis] = torque
            passed = torque + (x[X.lag + axis] - torque) * exp(-width / p[P.lag])
            if width > 0.0:
                torque -= p[P.lag] * (passed - x[X.lag + axis]) / width
            x[X.lag + axis] = passed
        torque = p[P.torque_gain + axis] * torque + p[P.torque_bias + axis]
        if axis == 0:
            u[EXTERNAL] += torque
        else:
            u[axis - 1] = torque + u[U.beside + axis]


@inlined
def _load_motion(p: Array, log: _Log, n: int, cell: tuple[float, float], work: _Work) -> None:
    """Motion at sample n with sensor effects undone, and elements with memory advanced to it.

    cell  begin and width [s] of the cell
    """
    modes, u, x, y, late = work.modes, work.u, work.x, work.y, log.late[n]
    for axis in range(3):
        y[axis], y[3 + axis] = 0.0, 0.0
        if p[P.axis_kind + axis] != ABSENT:
            y[axis], y[3 + axis] = log.angle[n, axis], log.velocity[n, axis]
            if p[P.skew + axis] > 0.0:
                y[axis], y[3 + axis] = ahead(log.time, log.angle, log.velocity, axis, n, p[P.skew + axis])
            y[axis], y[3 + axis] = true_motion(p, axis, y[axis], y[3 + axis])
        if n == 0 or not isfinite(x[axis]):
            x[axis] = y[axis]
        travel = y[axis] - x[axis]
        modes[axis] = 1 if travel > 0.0 else (-1 if travel < 0.0 else 0)
    if p[P.link_drive] == POSITION_DRIVE:
        measured, _ = read_motion(p, 0, y[0], y[3])
        if n == 0:
            first_goal(p, late, measured, x)
        mean_goal(p, log.sent, work.at, cell[0], cell[1], measured, x, u)
        u[DAMPING] += u[U.on] * p[P.drive_damping]
    if isfinite(y[0] + y[1] + y[2]):
        remember(p, modes, x, y)
    for axis in range(6):
        x[axis] = y[axis]


@inlined
def _store_torques(
    p: Array, log: _Log, n: int, age: float, work: _Work, out: Array
) -> None:  # fmt: skip
    """Torques at the motion and inputs of sample n into out (_N_COLUMNS,)."""
    modes, u, x, late, last = work.modes, work.u, work.x, log.late[n], log.time.size - 1
    u[U.spring], u[U.spring + 1] = spring_factor(p, 0, age), spring_factor(p, 1, age)
    for i in range(2):
        phi = deflection(p, EVERYTHING, i, x[0], x[1 + i])
        half = 0.5 * p[P.backlash + i]
        modes[MODE.flank + i] = 0 if abs(phi) < half else (1 if phi > 0.0 else -1)
    modes[MODE.touch] = p[P.contact_side] * (x[0] - p[P.contact_angle]) > 0.0 and p[P.contact_stiffness] > 0.0
    torques = motive_torques(p, EVERYTHING, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5])
    for axis in range(3):
        kind, load = p[P.axis_kind + axis], torques[3 + axis]
        friction = forward = backward = 0.0
        torque = nan
        if kind == DYNAMIC:
            if has_friction(p, axis):
                counter = counter_torque(p, modes, u, axis, x[0], x[3])
                before, after = log.velocity[max(n - 1, 0), axis], log.velocity[min(n + 1, last), axis]
                friction = slipping_friction(p, axis, before, x[3 + axis], after, load, counter)
                forward, backward = breakaway(p, axis, 1, load, counter), breakaway(p, axis, -1, load, counter)
            torque = torques[axis] - viscous_friction(p, axis, u[DAMPING]) * x[3 + axis] - friction
        elif kind == SERVO:
            v, w = x[3 + axis], servo_bandwidth(p, axis - 1)
            torque = servo_acceleration(x[axis], v, late[axis - 1], w)
            if abs(v) >= _SLEWING * p[P.saturation + axis] and torque * v > 0.0:
                torque = 0.0
        out[_C.torque + axis] = torque
        out[_C.friction + axis] = friction
        out[_C.forward + axis], out[_C.backward + axis] = forward, backward
        out[_C.angle + axis] = x[axis] if kind != ABSENT else nan
        out[_C.velocity + axis] = x[3 + axis] if kind != ABSENT else nan
    for i in range(2):
        total = nan
        if p[P.transmissions] > i:
            preset = preset_of(p, i, x[1], x[2])
            phi = deflection(p, EVERYTHING, i, x[0], x[1 + i])
            total = transmission_torque(p, EVERYTHING, modes, i, phi, preset, modes[MODE.flank + i], u[U.spring + i])
            total += x[X.hysteresis + i] + p[P.spring_damping + i] * (x[3] - x[4 + i])
        out[_C.transmission + i] = total
