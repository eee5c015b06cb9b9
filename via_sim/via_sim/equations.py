"""The same effects driven by a log: the torque of everything but inertia, for every sample and axis.

    inertia * acceleration = torque        link, motor 1, motor 2; of a servo  1 * acceleration = w^2 (u - x) - 2 w x'

`equation_torques` walks a record once, with the torque functions the simulator integrates, so that an effect is defined
once. Integrated against modulating functions (via_core.weak_form) the two sides agree where the plant is right:
inertia <angle, psi''> = <torque, psi>, with no derivative of anything measured but what friction needs for its sign.

**Commands are held, samples are instants**: each sample gets the mean of what is held over its cell (held_commands.py).
A lag T y' = u - y turns the mean of u into that of y, which is mean(u) - T (y_end - y_begin) / width. A friction whose
sign changes within a cell counts likewise.

**Memory** (bristles, Maxwell elements) runs on the increments of the angles themselves, from rest at the first sample.

**Sensor effects** are undone first: `angle` is what the axes did if the row is right, and late channels are read ahead.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from math import exp, isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray
from via_core.errors import ParameterError
from via_core.servos import servo_acceleration
from via_core.signals import Array

from via_sim.actuation import couple, servo_bandwidth
from via_sim.encoders import read_motion, true_motion
from via_sim.friction import breakaway, dry_friction, has_friction, viscous_friction
from via_sim.measurements import hermite
from via_sim.parameters import (
    ABSENT,
    DYNAMIC,
    N_PARAMETERS,
    POSITION_DRIVE,
    SERVO,
    TORQUE_DRIVE,
    P,
)
from via_sim.position_drive import followed, mean_followed
from via_sim.records import Record
from via_sim.torques import (
    ACTING,
    ARM,
    BESIDE,
    DAMPING,
    EXTERNAL,
    FLANK,
    GOAL,
    N_INPUTS,
    N_MODES,
    NEIGHBOUR,
    ON,
    POWER,
    RARE,
    SPRING,
    TOUCH,
    X,
    bare,
    compiled,
    counter_torque,
    deflection,
    laws,
    motive_torques,
    prepare,
    preset_of,
    remember,
    spring_factor,
    transmission_torque,
)

_SLEWING = 0.98  # share of its speed limit from which a servo is at it

# Columns of the result.
_Columns = namedtuple("_Columns", "torque friction capacity angle velocity transmission")
_C: Any = _Columns(0, 3, 6, 9, 12, 15)
_N_COLUMNS = 17


@dataclass(frozen=True, eq=False)
class EquationTorques:
    """What `equation_torques` returns; axes are link, motor 1, motor 2, NaN where there is none or nothing measured.

    torque        (N, 3) [N m] that accelerates: all but inertia times acceleration; of a servo [rad/s^2]
    friction      (N, 3) [N m] dry friction that `torque` contains, as if the axis slipped; opposes positive motion
    capacity      (N, 3) [N m] dry friction that the axis can take standing, at most (mean of both directions)
    standing      (N, 3) whether it nearly stands: then friction is any number between -capacity and capacity
    angle         (N, 3) [rad] with sensor effects undone
    velocity      (N, 3) [rad/s] likewise
    transmission  (N, 2) [N m] torque of each transmission, what a torque sensor at the link reads the sum of
    inertia       (3,) [kg m^2]; 1 for a servo
    """

    torque: Array
    friction: Array
    capacity: Array
    standing: Any
    angle: Array
    velocity: Array
    transmission: Array
    inertia: Array


def equation_torques(row: Array, record: Record, wanted: NDArray[np.intp] | None = None) -> EquationTorques:
    """Torques of a joint with parameter row (N_PARAMETERS,) along a record; the row's tick and substeps are not used.

    wanted  (n,) ascending: samples whose torques are returned; None: all N

    Raises ParameterError for a row of another shape.
    """
    p = np.array(row, dtype=np.float64)  # a locked row would be another type to numba
    if p.shape != (N_PARAMETERS,):
        raise ParameterError(f"a parameter row has shape ({N_PARAMETERS},), got {p.shape}")
    every = np.arange(len(record))
    walked = every if wanted is None or _remembers(p) else wanted
    out = np.empty((len(walked), _N_COLUMNS))
    walk(p, record.time, record.angle, record.velocity, *record.held.means(p), walked, out)
    if wanted is not None and walked is every:
        out = out[wanted]
    kinds = p[P.axis_kind : P.axis_kind + 3]
    parts = {name: out[:, a : a + 3] for name, a in zip(_C._fields, _C, strict=True)}
    with np.errstate(invalid="ignore"):
        standing = (np.abs(parts["velocity"]) < record.still) & (kinds == DYNAMIC)
    inertia = np.where(kinds == DYNAMIC, p[P.inertia : P.inertia + 3], 1.0)
    parts["transmission"] = out[:, _C.transmission :]
    return EquationTorques(standing=standing, inertia=inertia, **parts)


def _remembers(p: Array) -> bool:
    """Whether what acts at a sample hangs on more of the samples before it than on the last."""
    limited = p[P.link_drive] == POSITION_DRIVE and p[P.drive_speed_limit] < np.inf
    bristles, slips = p[P.bristle_torque : P.bristle_torque + 3], p[P.hysteresis_torque : P.hysteresis_torque + 2]
    return bool(p[P.lag] > 0.0 or limited or np.any(bristles > 0.0) or np.any(slips > 0.0))


@bare
def _ahead(time: Array, angle: Array, velocity: Array, axis: int, n: int, skew: float) -> tuple[float, float]:
    """Reading and velocity of an axis `skew` [s] after sample n, from the samples around that time."""
    when, k, last = time[n] + skew, n, time.size - 1
    while k < last - 1 and time[k + 1] < when:
        k += 1
    if k == last or time[last] < when:
        return angle[last, axis] + (when - time[last]) * velocity[last, axis], velocity[last, axis]
    h = time[k + 1] - time[k]
    a, b = angle[k, axis], angle[k + 1, axis]
    return hermite(a, velocity[k, axis], b, velocity[k + 1, axis], h, (when - time[k]) / h)


@bare
def _slipping(p: Array, axis: int, before: float, speed: float, after: float, load: float, counter: float) -> float:
    """Dry friction [N m] on a slipping axis, its mean over a cell in which the speed may change its sign."""
    swing = 0.25 * abs(after - before)  # of the speed over half a cell
    if isfinite(swing) and abs(speed) < swing:
        forwards = 0.5 * (1.0 + speed / swing)
    else:
        forwards = 1.0 if speed > 0.0 else (0.0 if speed < 0.0 else 0.5)
    friction = 0.0
    if forwards > 0.0:
        friction += forwards * dry_friction(p, axis, 1, abs(speed), load, counter)
    if forwards < 1.0:
        friction -= (1.0 - forwards) * dry_friction(p, axis, -1, abs(speed), load, counter)
    return friction


@bare
def _aim(p: Array, held: Array, reading: float, width: float, x: Array, u: Array) -> None:
    """Mean goal of a position drive over a cell of `width` [s], and the share of it that the drive is on -> u.

    held (N_COMMANDS,): means of commands; reading [rad]: where the goal of a drive waits that is off. x carries where
    the goal stands behind the speed limit and behind the lag, both absolute [rad] here.
    """
    u[ON] = held[POWER]
    if u[ON] <= 0.0:
        x[X.behind] = x[X.lag] = u[ACTING] = reading
        return
    asked = held[GOAL] / u[ON]
    u[ACTING] = mean_followed(p, asked, x[X.behind], width)
    x[X.behind] = followed(p, asked, x[X.behind], width)
    if p[P.lag] > 0.0:
        passed = u[ACTING] + (x[X.lag] - u[ACTING]) * exp(-width / p[P.lag])
        if width > 0.0:
            u[ACTING] -= p[P.lag] * (passed - x[X.lag]) / width
        x[X.lag] = passed


@compiled
def walk(
    p: Array, time: Array, angle: Array, velocity: Array, late: Array, prompt: Array, wanted: Any, out: Array
) -> None:
    """The wanted samples of a record -> out (N, 17), see `EquationTorques`; late, prompt as of `HeldCommands.means`."""
    c1, c2 = laws(p)
    modes, u, x, y = np.zeros(N_MODES, np.int64), np.zeros(N_INPUTS), np.zeros(X.queue), np.zeros(6)
    prepare(p, modes)
    for i in range(wanted.size):
        _sample(p, c1, c2, time, angle, velocity, late, prompt, wanted[i], modes, u, x, y, i, out)


@bare
def _sample(
    p: Array, c1: Array, c2: Array, time: Array, angle: Array, velocity: Array, late: Array, prompt: Array, n: int,
    modes: Array, u: Array, x: Array, y: Array, row: int, out: Array,
) -> None:  # fmt: skip
    """Sample n of `walk` -> out[row], with its scratch: modes, inputs, state, angles and velocities of the sample."""
    held, now, last = late[n], prompt[n], time.size - 1
    begin = 0.5 * (time[max(n - 1, 0)] + time[n])
    end = 0.5 * (time[n] + time[min(n + 1, last)])
    width, age = end - begin, p[P.origin] + time[n] - time[0]

    # what drives the axes
    couple(p, now[NEIGHBOUR], now[ARM], u)
    if p[P.link_drive] != TORQUE_DRIVE:
        u[BESIDE] += now[EXTERNAL]
    if p[P.pulse_torque] != 0.0 and width > 0.0:
        from_age = age - (time[n] - begin)
        overlap = min(from_age + width, p[P.pulse_stop]) - max(from_age, p[P.pulse_start])
        u[BESIDE] += p[P.pulse_torque] * max(overlap, 0.0) / width
    u[EXTERNAL], u[DAMPING] = u[BESIDE], held[DAMPING]
    for axis in range(3):
        asked = held[EXTERNAL] if axis == 0 else held[axis - 1]
        if p[P.axis_kind + axis] != DYNAMIC or (axis == 0 and p[P.link_drive] != TORQUE_DRIVE):
            continue
        if p[P.lag] > 0.0:
            if n == 0:
                x[X.lag + axis] = asked
            passed = asked + (x[X.lag + axis] - asked) * exp(-width / p[P.lag])
            if width > 0.0:
                asked -= p[P.lag] * (passed - x[X.lag + axis]) / width
            x[X.lag + axis] = passed
        asked = p[P.torque_gain + axis] * asked + p[P.torque_bias + axis]
        if axis == 0:
            u[EXTERNAL] += asked
        else:
            u[axis - 1] = asked + u[BESIDE + axis]

    # where the axes are
    for axis in range(3):
        y[axis], y[3 + axis] = 0.0, 0.0
        if p[P.axis_kind + axis] != ABSENT:
            y[axis], y[3 + axis] = angle[n, axis], velocity[n, axis]
            if p[P.skew + axis] > 0.0:
                y[axis], y[3 + axis] = _ahead(time, angle, velocity, axis, n, p[P.skew + axis])
            y[axis], y[3 + axis] = true_motion(p, axis, y[axis], y[3 + axis])
        if n == 0 or not isfinite(x[axis]):
            x[axis] = y[axis]
        way = y[axis] - x[axis]
        modes[axis] = 1 if way > 0.0 else (-1 if way < 0.0 else 0)
    if p[P.link_drive] == POSITION_DRIVE:
        reading, _ = read_motion(p, 0, y[0], y[3])
        if n == 0:
            x[X.behind] = x[X.lag] = held[GOAL] / held[POWER] if held[POWER] > 0.0 else reading
        _aim(p, held, reading, width, x, u)
        u[DAMPING] += u[ON] * p[P.drive_damping]
    if modes[RARE] != 0 and isfinite(y[0] + y[1] + y[2]):
        remember(p, modes, x, y)
    for axis in range(6):
        x[axis] = y[axis]

    # what acts on them
    u[SPRING], u[SPRING + 1] = spring_factor(p, 0, age), spring_factor(p, 1, age)
    for i in range(2):
        phi = deflection(p, i, x[0], x[1 + i])
        half = 0.5 * p[P.backlash + i]
        modes[FLANK + i] = 0 if abs(phi) < half else (1 if phi > 0.0 else -1)
    modes[TOUCH] = p[P.contact_side] * (x[0] - p[P.contact_angle]) > 0.0 and p[P.contact_stiffness] > 0.0
    torques = motive_torques(p, c1, c2, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5])
    for axis in range(3):
        kind, load = p[P.axis_kind + axis], torques[3 + axis]
        friction = capacity = 0.0
        torque = nan
        if kind == DYNAMIC:
            if has_friction(p, axis):
                counter = counter_torque(p, modes, u, axis, x[0], x[3])
                before, after = velocity[max(n - 1, 0), axis], velocity[min(n + 1, last), axis]
                friction = _slipping(p, axis, before, x[3 + axis], after, load, counter)
                most = breakaway(p, axis, 1, load, counter)
                capacity = 0.5 * (most + breakaway(p, axis, -1, load, counter))
            torque = torques[axis] - viscous_friction(p, axis, u[DAMPING]) * x[3 + axis] - friction
        elif kind == SERVO:
            v, w = x[3 + axis], servo_bandwidth(p, axis - 1)
            torque = servo_acceleration(x[axis], v, held[axis - 1], w)
            if abs(v) >= _SLEWING * p[P.saturation + axis] and torque * v > 0.0:
                torque = 0.0
        out[row, _C.torque + axis] = torque
        out[row, _C.friction + axis] = friction
        out[row, _C.capacity + axis] = capacity
        out[row, _C.angle + axis] = x[axis] if kind != ABSENT else nan
        out[row, _C.velocity + axis] = x[3 + axis] if kind != ABSENT else nan
    for i in range(2):
        total = nan
        if p[P.transmissions] > i:
            preset = preset_of(p, i, x[1], x[2])
            phi = deflection(p, i, x[0], x[1 + i])
            c = c1 if i == 0 else c2
            total = transmission_torque(p, c, i, phi, preset, modes[FLANK + i], u[SPRING + i])
            total += x[X.hysteresis + i] + p[P.spring_damping + i] * (x[3] - x[4 + i])
        out[row, _C.transmission + i] = total
