"""Runs in lockstep: blocks of lanes, the ticks of a block, and the lanes that take a tick on their own."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from via_core.signals import Array

from via_sim.joint.compiled import bare, compiled
from via_sim.joint.encoders import true_motion
from via_sim.joint.kernel import advance_tick, begin, queued_at
from via_sim.joint.layout import EXTERNAL, GOAL, HISTORY, MODE, N_COMMANDS, N_INPUTS, N_MODES, POWER, QUEUED, X
from via_sim.joint.measurements import record, sense
from via_sim.joint.parameters import NO_DAMPER, POSITION_DRIVE, P
from via_sim.joint.step import N_WEIGHTS
from via_sim.lockstep.block import N_ROWS, R, Z
from via_sim.lockstep.damping import set_damping
from via_sim.lockstep.goals import begin_integrals, end_integrals, leave_goals, recall_goals, take_goals
from via_sim.lockstep.lanes import (
    begin_piece,
    divide_tick,
    is_simple,
    load_parameters,
    load_state,
    place,
    steps_of,
    store_inputs,
    store_state,
    take_commands,
    terms_of,
)
from via_sim.lockstep.pack import LANES, any_above, choose, get, get_one, put, put_one, rows_of_packs
from via_sim.lockstep.step import step

# Arguments of `lead_many`, for the runs of a block.
_Runs = namedtuple("_Runs", "rows states commands begins measured led out")
# Work memory of a block. z: see `block`; u, y, modes, weights: of the scalar kernel, the last two per lane. Per lane:
#   loaded  whether z holds its state
#   plain   whether its motion follows from `out`: its state then rests until it takes a tick on its own
#   number  tick number at the beginning
#   known   ticks whose commands and motion are in queue and ring buffer of its state
_Work = namedtuple("_Work", "z u y modes weights loaded plain number known")


@compiled
def run_many(rows: Array, states: Array, commands: Array, begins: Any, out: Array) -> None:
    """Motion (K, n+1, 6) of K runs of n ticks into `out`; the states (K, size) are advanced in place.

    rows      (K, N_PARAMETERS) of one joint with one arrangement
    commands  (N, N_COMMANDS) of a whole recording
    begins    (K,) index of the first command of each run

    Motion is angles and velocities as ideal sensors measure them: with encoder errors, without noise and quantisation.
    """
    lead_many(rows, states, commands, begins, np.zeros((0, 6)), np.zeros(0, np.int64), out)


@compiled
def lead_many(
    rows: Array, states: Array, commands: Array, begins: Any, measured: Array, axes: Any, out: Array
) -> None:  # fmt: skip
    """`run_many` with prescribed motion of some axes: set to the measurement at every tick, the last one included.

    `out` contains it but for the last tick.

    measured  (N, 6) angles [rad] and velocities [rad/s] as the encoders measure them, from tick 0 of the states on
    axes      (m,) int64, the axes whose motion is prescribed
    """
    modes, weights = np.zeros((LANES, N_MODES), np.int64), np.zeros((LANES, 3, N_WEIGHTS))
    for first in range(0, len(rows), LANES):
        lanes, block = np.zeros((4, LANES), np.int64), slice(first, first + LANES)
        z, u, y = rows_of_packs(N_ROWS), np.zeros(N_INPUTS), np.zeros(9)
        work = _Work(z, u, y, modes, weights, lanes[0], lanes[1], lanes[2], lanes[3])
        _run_block(_Runs(rows[block], states[block], commands, begins[block], measured, axes, out[block]), work)
    if axes.size > 0:
        for k in range(len(rows)):
            _lead(rows[k], states[k], measured, axes)


@bare
def _run_block(runs: _Runs, work: _Work) -> None:
    """All ticks of at most LANES runs."""
    lead, z, period = runs.rows[0], work.z, runs.rows[0, P.tick]
    terms, count, together, late = terms_of(runs.rows), len(runs.rows), 0, 0
    early = later = 0  # steps of a tick before and after its command arrives, enough for every lane
    for lane in range(count):
        p, x = runs.rows[lane], runs.states[lane]
        begin(p, x, work.u, work.modes[lane], work.weights[lane])
        sense(p, x, runs.out[lane, 0])
        load_parameters(p, z, lane)
        work.number[lane], work.plain[lane] = int(x[X.tick]), _has_plain_encoders(p)
        z[Z.age, lane] = p[P.origin] + x[X.tick] * period
        alike = p[P.substeps] == lead[P.substeps] and p[P.tick] == period
        z[Z.joins, lane] = alike
        together, late = together + alike, late + work.modes[lane, MODE.late]
        if alike:
            before, after = steps_of(p, work.modes[lane, MODE.late])
            early, later = max(early, before), max(later, after)
    for lane in range(count):
        divide_tick(runs.rows[lane], work.modes[lane, MODE.late], (early, later), z, lane)
    simple = is_simple(terms)
    damped = lead[P.damper_site] != NO_DAMPER or lead[P.link_drive] == POSITION_DRIVE
    left_out = True
    for tick in range(runs.out.shape[1] - 1):
        if left_out or runs.led.size > 0:
            _join(runs, tick, work)
        if together > 0:
            for lane in range(count):
                command = runs.commands[runs.begins[lane] + tick]
                for i in range(N_COMMANDS):
                    put_one(z, Z.command + i, lane, command[i])
            put(z, Z.external, get(z, Z.command + EXTERNAL))
            for row in range(6 if simple else Z.at - Z.before):
                put(z, Z.before + row, get(z, Z.start + row))
            put(z, Z.margin, get(z, Z.joins))
            if terms.rare >> R.goal & 1:
                recall_goals(z, terms.rare)
            sticks = any_above(get(z, Z.stuck) + get(z, Z.stuck + 1) + get(z, Z.stuck + 2), 0.0)
            for piece, steps in enumerate((early, later)):
                if steps == 0:
                    continue
                if late + early > 0:
                    _delay(runs, tick, work, 1 - piece)
                if terms.rare >> R.goal & 1:
                    _look_back(runs, tick, work, 2 - piece if late + early > 0 else 1)
                take_commands(lead, z, tick * period)
                if terms.rare >> R.goal & 1:
                    take_goals(z, terms.rare)
                if damped or tick == 0:
                    set_damping(runs.rows, piece, tick == 0, work.weights[0, 2], z)
                if early > 0 or damped or tick == 0:
                    begin_piece(z, piece)
                if terms.rare >> R.goal & 1:
                    begin_integrals(z, terms.rare, steps)
                for _ in range(steps):
                    if simple:
                        step(z, runs.rows, terms, sticks, None)
                    else:
                        step(z, runs.rows, terms, sticks, True)
                if terms.rare >> R.goal & 1:
                    end_integrals(z, terms.rare, steps)
            if terms.rare >> R.goal & 1:
                leave_goals(z)
        left_out = together < count or any_above(choose(get(z, Z.margin), 0.0, get(z, Z.joins)), 0.0)
        for lane in range(count):
            if work.plain[lane] != 0 and get_one(z, Z.margin, lane) > 0.0:
                motion = runs.out[lane, tick + 1]
                for i in range(3):
                    motion[i] = get_one(z, Z.start + i, lane) + get_one(z, Z.encoder_offset + i, lane)
                    motion[3 + i] = get_one(z, Z.start + 3 + i, lane)
            else:
                _finish(runs, lane, tick, work)
    for lane in range(count):
        if work.loaded[lane] != 0:
            _store(runs, lane, runs.out.shape[1] - 1, Z.start, work)
            last = runs.commands[runs.begins[lane] + runs.out.shape[1] - 2]
            store_inputs(runs.rows[lane], runs.states[lane], last, z, lane)


@bare
def _join(runs: _Runs, tick: int, work: _Work) -> None:
    """Prescribed motion, and the state into the lanes that go in lockstep from this tick on."""
    z = work.z
    for lane in range(len(runs.rows)):
        p, x = runs.rows[lane], runs.states[lane]
        if work.loaded[lane] == 0:
            if runs.led.size > 0:
                _lead(p, x, runs.measured, runs.led)
            if z[Z.joins, lane] > 0.0:
                work.loaded[lane] = 1
                load_state(p, x, work.modes[lane, MODE.late], z, lane)
        elif runs.led.size > 0:
            for axis in runs.led:
                angle, speed = _prescribed(p, work.number[lane] + tick, runs.measured, axis)
                z[Z.start + axis, lane], z[Z.start + 3 + axis, lane] = angle, speed
                if work.plain[lane] == 0:  # its history is written from x, that of plain encoders from `out`
                    x[axis], x[3 + axis] = angle, speed
            place(p, z, lane)
        if work.plain[lane] != 0 and work.loaded[lane] != 0:
            for axis in runs.led:
                runs.out[lane, tick, axis] = z[Z.start + axis, lane] + z[Z.encoder_offset + axis, lane]
                runs.out[lane, tick, 3 + axis] = z[Z.start + 3 + axis, lane]


@bare
def _sent(runs: _Runs, lane: int, tick: int, work: _Work, late: int, column: int) -> float:
    """A column of the command of a lane from `late` ticks before: of this run, or from the queue in its first state."""
    if late <= tick:
        return runs.commands[max(runs.begins[lane] + tick - late, 0), column]
    x = runs.states[lane]
    return x[queued_at(x, (work.number[lane] + tick) % ((x.size - X.queue) // QUEUED), late) + column]


@bare
def _look_back(runs: _Runs, tick: int, work: _Work, more: int) -> None:
    """Goals of the commands `more` ticks behind the dead time, and whether the drive was on, into the lanes."""
    for lane in range(len(runs.rows)):
        late = work.modes[lane, MODE.late] + more
        work.z[Z.sent_before, lane] = _sent(runs, lane, tick, work, late, GOAL)
        work.z[Z.on_before, lane] = 1.0 if _sent(runs, lane, tick, work, late, POWER) > 0.5 else 0.0


@bare
def _delay(runs: _Runs, tick: int, work: _Work, more: int) -> None:
    """Commands behind the dead time, and `more` ticks behind it, into the lanes."""
    for lane in range(len(runs.rows)):
        late = work.modes[lane, MODE.late] + more
        for i in range(QUEUED):
            work.z[Z.command + i, lane] = _sent(runs, lane, tick, work, late, i)


@bare
def _finish(runs: _Runs, lane: int, tick: int, work: _Work) -> None:
    """Measured motion at the end of a tick; where the step was not valid, the run takes the tick on its own."""
    p, x = runs.rows[lane], runs.states[lane]
    if work.loaded[lane] != 0 and work.z[Z.margin, lane] > 0.0:
        _store(runs, lane, tick + 1, Z.start, work)
    else:
        if work.loaded[lane] != 0:
            _store(runs, lane, tick, Z.before, work)
        command = runs.commands[runs.begins[lane] + tick]
        advance_tick(p, x, command, work.u, work.modes[lane], work.weights[lane], work.y)
        work.loaded[lane], work.known[lane] = 0, tick + 1
    sense(p, x, runs.out[lane, tick + 1])


@bare
def _store(runs: _Runs, lane: int, tick: int, row: int, work: _Work) -> None:
    """Bring the state of a lane, see `store_state`, to the beginning of a tick."""
    x, number, begins = runs.states[lane], work.number[lane], runs.begins[lane]
    length, every = (x.size - X.queue) // QUEUED, work.modes[lane, MODE.every]
    if work.plain[lane] == 0 and work.known[lane] < tick:
        record(x, every)
    for past in range(max(work.known[lane], tick - length), tick):
        here = X.queue + QUEUED * ((number + past) % length)
        for i in range(QUEUED):
            x[here + i] = runs.commands[begins + past, i]
    if work.plain[lane] != 0:
        for past in range(max(work.known[lane], tick - HISTORY * every), tick):
            if (number + past) % every == 0:
                here = X.history + 6 * ((number + past) // every % HISTORY)
                for i in range(3):
                    x[here + i] = runs.out[lane, past, i] - work.z[Z.encoder_offset + i, lane]
                    x[here + 3 + i] = runs.out[lane, past, 3 + i]
    store_state(runs.rows[lane], work.z, row, lane, x)
    x[X.tick], work.known[lane] = number + tick, tick


@bare
def _lead(p: Array, x: Array, measured: Array, axes: Any) -> None:
    """Set axes of state x to their measurement at its tick."""
    for axis in axes:
        x[axis], x[3 + axis] = _prescribed(p, int(x[X.tick]), measured, axis)


@bare
def _prescribed(p: Array, tick: int, measured: Array, axis: int) -> tuple[float, float]:
    """Angle and velocity of an axis at a tick by its measurement, which a late encoder took later."""
    at = min(tick + p[P.skew + axis] / p[P.tick], len(measured) - 1.0)
    low = int(at)
    share, high = at - low, min(low + 1, len(measured) - 1)
    angle = (1.0 - share) * measured[low, axis] + share * measured[high, axis]
    speed = (1.0 - share) * measured[low, 3 + axis] + share * measured[high, 3 + axis]
    return true_motion(p, axis, angle, speed)


@bare
def _has_plain_encoders(p: Array) -> bool:
    """Whether encoders have neither skew nor periodic error."""
    plain = True
    for axis in range(3):
        plain &= p[P.skew + axis] <= 0.0 and p[P.encoder_harmonics + axis] == 0.0
    return plain
