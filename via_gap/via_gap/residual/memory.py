"""Hidden states at the start of a segment: bristles, Maxwell elements, and the goal of a position drive.

    torques = torques_along(rows, angles, ticks)            # (K, n, 5)
    behind = goals_along(rows, commands, measured, ticks)   # (K, n, 3)

A segment starts from measured angles, but the torque of such an element depends on all reversals since it last slipped,
perhaps seconds ago. Its equation, as in the simulator (`remember`), is therefore integrated along the measured angles
from the beginning of the log, once per parameter row. The goal of a position drive lags behind its command because of a
speed limit or a filter. It is integrated along the commands in the same way, and so is the integral of the error.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import ceil

import numpy as np
from via_core.signals import Array, Indices, Mask
from via_sim.joint.compiled import compiled
from via_sim.joint.layout import GOAL, HISTORY, N_MODES, POWER, X
from via_sim.joint.measurements import stride
from via_sim.joint.parameters import POSITION_DRIVE, P
from via_sim.joint.position_drive import acting_goal, followed, integral_at_start, integrated, led
from via_sim.joint.torques import remember

HELD = 5  # bristles of link, motor 1, motor 2; Maxwell elements of transmission 1, 2
TORQUES = np.r_[P.bristle_torque : P.bristle_torque + 3, P.hysteresis_torque : P.hysteresis_torque + 2]
STIFFNESSES = np.r_[P.bristle_stiffness : P.bristle_stiffness + 3, P.hysteresis_stiffness : P.hysteresis_stiffness + 2]
# Slots of a row that matter for each: most rows of a fit differ in others.
ELEMENTS = np.r_[TORQUES, STIFFNESSES]
GOAL_NUMBERS = np.array([
    P.delay, P.lag, P.drive_speed_limit, P.integral_rate, P.integral_start, P.integral_limit, P.drive_torque_limit,
    P.saturation, P.drive_stiffness, P.drive_damping, P.feedforward,
])  # fmt: skip
OF_INTEGRAL = [P.integral_start, P.integral_limit, P.drive_torque_limit, P.saturation]
KEPT = 256  # rows of a log whose goals are kept


def torques_along(rows: Array, angles: Array, ticks: Indices) -> Array:
    """Torques [N m] (K, n, HELD) of the elements of rows (K, N_PARAMETERS) at ticks (n,).

    angles  (T, 3) [rad] of link and motors on every tick; NaN: not measured, taken as 0
    """

    def integrate(some: Array, ascending: Indices, out: Array) -> None:
        _integrate(np.where(np.isfinite(angles), angles, 0.0), some, ascending, out)

    return _once_per_row(rows, with_memory(rows), rows[:, ELEMENTS], ticks, HELD, integrate)


def with_memory(rows: Array) -> Array:
    """(K,) whether a row has an element with memory."""
    return np.asarray(np.any(rows[:, TORQUES] > 0.0, axis=1))


def _once_per_row(
    rows: Array, which: Array, numbers: Array, ticks: Indices, width: int, integrate: Callable[..., None]
) -> Array:
    """(K, n, width) by `integrate(rows, ascending ticks, out)`, once for rows `which` (K,) that agree in `numbers`."""
    out = np.zeros((len(rows), len(ticks), width))
    some = np.flatnonzero(which)
    if some.size and len(ticks):
        _, first, alike = np.unique(numbers[some], axis=0, return_index=True, return_inverse=True)
        at, back = np.unique(ticks, return_inverse=True)
        found = np.zeros((first.size, len(at), width))
        integrate(np.ascontiguousarray(rows[some[first]]), at, found)
        out[some] = found[alike.reshape(-1)][:, back.reshape(-1)]
    return out


@compiled
def _integrate(angles: Array, rows: Array, ticks: Array, out: Array) -> None:
    """`torques_along` for ascending ticks."""
    x, y = np.zeros(X.queue), np.zeros(6)
    modes = np.zeros(N_MODES, np.int64)
    for k in range(len(rows)):
        x[:] = 0.0
        x[:3] = angles[0]
        done = 0
        for j in range(len(ticks)):
            while done < ticks[j]:
                done += 1
                y[:3] = angles[done]
                for axis in range(3):
                    modes[axis] = np.sign(y[axis] - x[axis])
                remember(rows[k], modes, x, y)
                x[:3] = y[:3]
            out[k, j] = x[X.bristle : X.bristle + HELD]


def with_late_goal(rows: Array) -> Array:
    """(K,) whether the goal of a row's position drive can differ from its delayed command, or it has an integral."""
    slow = (rows[:, P.lag] > 0.0) | np.isfinite(rows[:, P.drive_speed_limit]) | (rows[:, P.integral_rate] > 0.0)
    slow |= rows[:, P.feedforward] != 0.0
    return np.asarray(slow & (rows[:, P.link_drive] == POSITION_DRIVE))


def with_drive_memory(rows: Array) -> Mask:
    """(K,) whether what a drive does depends on its earlier commands, beyond those in the queue of its dead time."""
    return np.asarray(with_late_goal(rows), dtype=np.bool_) | np.asarray(rows[:, P.lag] > 0.0, dtype=np.bool_)


def goals_along(rows: Array, commands: Array, measured: Array, ticks: Indices) -> Array:
    """(K, n, 3) [rad] lag of the goals of rows (K, N_PARAMETERS) by speed limit and by time constant, and integrals.

    ticks     (n,)
    commands  (T, N_COMMANDS) constant over each tick; before the first tick the drive had reached its first goal
    measured  (T,) [rad] by the drive's encoder, the goal while the drive is off
    """
    numbers, follow = _goal_numbers(rows), partial(_follow, commands, measured)
    return _once_per_row(rows, with_late_goal(rows), numbers, ticks, 3, follow)


@dataclass(frozen=True, eq=False)
class DriveGoals:
    """`goals_along` under the commands of a log, with a cache: most rows agree in what a goal depends on.

    commands  (T, N_COMMANDS)
    measured  (T,) [rad]
    ticks     (n,) ascending
    """

    commands: Array
    measured: Array
    ticks: Indices
    _found: OrderedDict[bytes, Array] = field(default_factory=OrderedDict, init=False)

    def states(self, rows: Array, commands: Array | None = None) -> Array:
        """(K, n, 3) of rows (K, N_PARAMETERS); 0 where goals have no memory.

        commands  (K, T, N_COMMANDS) of each row, instead of the log's; without the cache
        """
        if commands is not None:
            each = zip(rows[:, None], commands, strict=True)
            return np.concatenate([goals_along(row, sent, self.measured, self.ticks) for row, sent in each])
        late, found = np.flatnonzero(with_late_goal(rows)), self._found
        out = np.zeros((len(rows), len(self.ticks), 3))
        keys = [each.tobytes() for each in _goal_numbers(rows[late])]
        new = {key: rows[k] for key, k in zip(keys, late, strict=True) if key not in found}
        if new:
            made = np.zeros((len(new), *out.shape[1:]))
            _follow(self.commands, self.measured, np.stack([*new.values()]), self.ticks, made)
            found.update(zip(new, made, strict=True))
        for key, k in zip(keys, late, strict=True):
            out[k] = found[key]
            found.move_to_end(key)
        while len(found) > KEPT:
            found.popitem(last=False)
        return out


def _goal_numbers(rows: Array) -> Array:
    """(K, GOAL_NUMBERS) of rows (K, N_PARAMETERS), 0 where nothing depends on them."""
    used = rows.copy()
    without = rows[:, P.integral_rate] <= 0.0
    used[np.ix_(without, OF_INTEGRAL)] = 0.0
    used[np.ix_(without & (rows[:, P.feedforward] == 0.0), [P.drive_stiffness, P.drive_damping])] = 0.0
    return used[:, GOAL_NUMBERS]


@compiled
def _follow(commands: Array, measured: Array, rows: Array, ticks: Array, out: Array) -> None:
    """`goals_along` for ascending ticks; within a tick the order of `kernel.advance_tick`."""
    for k in range(len(rows)):
        p = rows[k]
        period = p[P.tick]
        whole = int(np.floor(p[P.delay] / period + 1e-9))
        rest = p[P.delay] - whole * period
        if rest < 1e-9 * period:
            rest = 0.0
        follows = lags = commands[0, GOAL] if commands[0, POWER] > 0.5 else measured[0]
        done, integral = 0, integral_at_start(p)
        for j in range(len(ticks)):
            while done < ticks[j]:
                passed = 0.0  # [s] of the tick
                if commands[max(done - whole - 1, 0), POWER] <= 0.5:
                    follows = lags = measured[done]
                for piece in range(2):  # before and after the command of this tick arrives
                    held, span = max(done - whole - (1 - piece), 0), rest if piece == 0 else period - rest
                    if span <= 0.0:
                        continue
                    if commands[held, POWER] > 0.5:
                        goal = commands[held, GOAL]
                        if held > 0 and commands[held - 1, POWER] > 0.5:
                            goal = led(p, goal, commands[held - 1, GOAL], period)
                        before = acting_goal(p, goal, follows, lags, 0.0)
                        lags = acting_goal(p, goal, follows, lags, span)
                        follows = followed(p, goal, follows, span)
                        middle = (passed + 0.5 * span) / period
                        angle = measured[done] + middle * (measured[done + 1] - measured[done])
                        integral = integrated(p, integral, 0.5 * (before + lags) - angle, span)
                    else:
                        follows = lags = measured[done]
                        integral = 0.0
                    passed += span
                done += 1
            last = max(done - whole - 1, 0)
            if commands[last, POWER] > 0.5:
                out[k, j, 0], out[k, j, 1] = commands[last, GOAL] - follows, follows - lags
            out[k, j, 2] = integral


def write_goals(rows: Array, goals: Array, states: Array) -> None:
    """Write into states (n, .) how far goals (n, 3) of position drives of rows (n, .) are behind, and integrals."""
    late = with_late_goal(rows)
    states[late, X.behind], states[late, X.lag], states[late, X.integral] = goals[late].T


def write_history(
    rows: Array,
    ticks: Indices,
    states: Array,
    rate: float,
    known: Sequence[int],
    motion: Callable[[Array, Indices], Array],
) -> None:
    """Write into states (n, .) the motion before segments that start at `ticks` (n,), for late encoders of rows (n, .).

    The first samples of a late encoder in a segment are from the time before it. They are the measured motion then,
    not the simulated motion of the segment before, which ended elsewhere.

    rate    [Hz] of the ticks
    known   entries of a state that are measured: angles, then velocities
    motion  true angles and velocities (n, 6) of rows (n, .) at ticks (n,)
    """
    skews = rows[:, P.skew : P.skew + 3][:, [place for place in known if place < 3]].max(axis=1)
    late = np.flatnonzero(skews > 0.0)
    if not late.size:
        return
    every = stride(1.0 / rate)
    past, history = rows[late], states[late, X.history : X.queue].reshape(len(late), HISTORY, 6)
    for back in range(min(ceil(float(skews.max()) * rate / every) + 2, HISTORY)):
        which = ticks[late] // every - back
        there = motion(past, np.maximum(which * every, 0))
        history[np.arange(len(late))[:, None], (which % HISTORY)[:, None], known] = there[:, known]
    states[late, X.history : X.queue] = history.reshape(len(late), -1)
