"""Runs in lockstep: blocks of lanes, the ticks of a block, and the lanes that take a tick on their own."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from via_core.signals import Array

from via_sim.joint.compiled import bare, compiled, inlined
from via_sim.joint.encoders import true_motion
from via_sim.joint.kernel import advance_tick, begin
from via_sim.joint.layout import MODE, N_INPUTS, N_MODES, QUEUED, X
from via_sim.joint.measurements import record, sense, stride
from via_sim.joint.parameters import P
from via_sim.joint.step import N_WEIGHTS, PER_AXIS, weigh
from via_sim.lockstep.block import N_ROWS, Terms, Z
from via_sim.lockstep.lanes import is_supported, load_inputs, load_parameters, load_state, store_inputs, terms_of
from via_sim.lockstep.pack import LANES, rows_of_packs
from via_sim.lockstep.step import step

_FEWEST = 2  # lanes in lockstep: fewer are as fast one by one

# Arguments of `lead_many`.
_Runs = namedtuple("_Runs", "rows states commands begins measured led out")
# Work memory of a block. z: see `block`; u, y, modes, weights: of the scalar kernel, the last two per lane. Per lane:
#   joins   whether it goes in lockstep
#   loaded  whether z holds its state
#   plain   whether its encoders have no errors
#   late    dead time in ticks
#   sticks  whether an axis with friction is at standstill
#   number  tick number at the beginning
_Work = namedtuple("_Work", "z u y modes weights joins loaded plain late sticks number")


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

    measured  (N, 6) angles [rad] and velocities [rad/s] as the encoders measure them, from tick 0 of the states on
    axes      (m,) int64, the axes whose motion is prescribed
    """
    runs = _Runs(rows, states, commands, begins, measured, axes, out)
    u, y = np.zeros(N_INPUTS), np.zeros(9)
    modes, weights = np.zeros((LANES, N_MODES), np.int64), np.zeros((LANES, 3, N_WEIGHTS))
    lanes = np.zeros((6, LANES), np.int64)
    for first in range(0, len(rows), LANES):
        z = rows_of_packs(N_ROWS)
        work = _Work(z, u, y, modes, weights, lanes[0], lanes[1], lanes[2], lanes[3], lanes[4], lanes[5])
        _run_block(runs, first, work)
    if axes.size > 0:
        for k in range(len(rows)):
            _lead(rows[k], states[k], measured, axes)


@bare
def _run_block(runs: _Runs, first: int, work: _Work) -> None:
    """All ticks of the runs from row `first` on, LANES at most."""
    lead, period = runs.rows[first], runs.rows[first, P.tick]
    count, ticks = min(LANES, len(runs.rows) - first), runs.out.shape[1] - 1
    terms, together = terms_of(runs.rows, first, count), 0
    for lane in range(count):
        p, x = runs.rows[first + lane], runs.states[first + lane]
        begin(p, x, work.u, work.modes[lane], work.weights[lane])
        sense(p, x, runs.out[first + lane, 0])
        load_parameters(p, work.z, lane)
        alike = p[P.substeps] == lead[P.substeps] and p[P.tick] == period
        work.number[lane] = int(x[X.tick])
        work.joins[lane], work.loaded[lane], work.plain[lane] = alike and is_supported(p), 0, _has_ideal_encoders(p)
        work.late[lane] = int(p[P.delay] / period + 1e-9)
        together += work.joins[lane]
    steps = max(1, int(lead[P.substeps]))
    for tick in range(ticks):
        if runs.led.size > 0:
            for lane in range(count):
                _lead(runs.rows[first + lane], runs.states[first + lane], runs.measured, runs.led)
                work.loaded[lane] = 0
        ready = standstills = 0
        if together >= _FEWEST:
            for lane in range(count):
                _load(runs, first, lane, tick, period / steps, work)
                ready += work.loaded[lane]
                standstills += work.loaded[lane] * work.sticks[lane]
            if ready > 0:
                for _ in range(steps):
                    step(work.z, runs.rows, first, terms, standstills != 0)
        for lane in range(count):
            _finish(runs, first, lane, tick, ready > 0, terms, work)


@inlined
def _load(runs: _Runs, first: int, lane: int, tick: int, h: float, work: _Work) -> None:
    """State, inputs and weights for steps of h [s] into a lane that goes in lockstep."""
    p, x, z = runs.rows[first + lane], runs.states[first + lane], work.z
    if work.loaded[lane] == 0 and work.joins[lane] != 0:
        work.loaded[lane], work.sticks[lane] = 1, load_state(p, x, z, lane)
    z[Z.margin, lane] = 2.0 * work.loaded[lane] - 1.0
    if work.loaded[lane] == 0:
        return
    command, now = runs.commands[runs.begins[first + lane] + tick], work.number[lane] + tick
    slot = now % ((x.size - X.queue) // QUEUED)
    load_inputs(p, x, command, slot, work.late[lane], p[P.origin] + now * p[P.tick], z, lane)
    own = work.weights[lane, 2]
    if own[N_WEIGHTS - 2] != h or own[N_WEIGHTS - 1] != z[Z.damping, lane]:
        weigh(p, h, z[Z.damping, lane], own)
        for k in range(3 * PER_AXIS):
            z[Z.weight + k, lane] = own[k]


@inlined
def _finish(runs: _Runs, first: int, lane: int, tick: int, stepped: bool, terms: Terms, work: _Work) -> None:
    """End of a tick: the lane's state is stored where its step was valid, else the run takes the tick on its own."""
    p, x, z = runs.rows[first + lane], runs.states[first + lane], work.z
    command, now = runs.commands[runs.begins[first + lane] + tick], work.number[lane] + tick
    if stepped and z[Z.margin, lane] > 0.0:
        if now % stride(p[P.tick]) == 0:
            record(x, work.modes[lane, MODE.every])
        for i in range(6):
            x[i] = z[Z.start + i, lane]
        if terms.rare != 0:
            for i in range(3):
                x[X.bristle + i] = z[Z.bristle + i, lane]
            for i in range(2):
                x[X.hysteresis + i] = z[Z.maxwell + i, lane]
        x[X.tick] += 1.0
        if tick == runs.out.shape[1] - 2:
            store_inputs(p, x, command, now % ((x.size - X.queue) // QUEUED), work.late[lane], z, lane)
        if p[P.lag] > 0.0 and work.joins[lane] != 0:
            for axis in range(3):
                x[X.lag + axis] = z[Z.lagged + axis, lane]
    else:
        work.loaded[lane] = 0
        advance_tick(p, x, command, work.u, work.modes[lane], work.weights[lane], work.y)
    motion = runs.out[first + lane, tick + 1]
    if work.plain[lane] != 0:
        for i in range(6):
            motion[i] = x[i]
    else:
        sense(p, x, motion)


@bare
def _lead(p: Array, x: Array, measured: Array, axes: Any) -> None:
    """Set axes of state x to their measurement at its tick; a late encoder measured it later."""
    for axis in axes:
        at = min(x[X.tick] + p[P.skew + axis] / p[P.tick], len(measured) - 1.0)
        low = int(at)
        share, high = at - low, min(low + 1, len(measured) - 1)
        angle = (1.0 - share) * measured[low, axis] + share * measured[high, axis]
        speed = (1.0 - share) * measured[low, 3 + axis] + share * measured[high, 3 + axis]
        x[axis], x[3 + axis] = true_motion(p, axis, angle, speed)


@bare
def _has_ideal_encoders(p: Array) -> bool:
    """Whether encoders have neither skew nor offset nor periodic error."""
    ideal = True
    for axis in range(3):
        ideal &= p[P.skew + axis] <= 0.0 and p[P.encoder_harmonics + axis] == 0.0 and p[P.encoder_offset + axis] == 0.0
    return ideal
