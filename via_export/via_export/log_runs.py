"""Logs simulated with an exported model in MuJoCo: short segments from measured states, or the whole log."""

from __future__ import annotations

import numpy as np
from via_core.signals import Array, Signals
from via_gap.logs.replay import TICK_RATE, begin_of
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import binned
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.simulate import command_rows, initial_state, passive_command

from via_export.mujoco_joint import QUEUE, MujocoJoint
from via_export.target import Target


def _readable(target: Target) -> Array:
    """The row without encoder errors that MuJoCo's sensors lack."""
    row = target.row.copy()
    row[P.encoder_harmonics : P.encoder_harmonics + 3] = 0.0
    return row


def segment_angles(model: MujocoJoint, view: Rollout) -> Array:
    """Angles as compared (C, b, a) [rad] of the segments of a view."""
    segments = view.segments
    row = _readable(model.target)
    row[[P.tick, P.substeps]] = segments.nominal[[P.tick, P.substeps]]
    starts = view.starts(row)
    out = np.empty((len(view.chosen), *segments.measured.shape[1:]))
    axes = list(segments.axes)
    for k, begin in enumerate(segments.begin[view.chosen]):
        first = int(starts.ticks[k])
        before = segments.commands[np.maximum(first - 1 - np.arange(QUEUE), 0)]
        data = model.start(starts.states[k], before)
        if first < begin:
            model.run(data, segments.commands[first:begin])
        model.place(data, axes, starts.motion[k])
        if starts.held is not None:
            model.remember(data, starts.held[k])
        model.slide(data)
        moved = model.run(data, segments.commands[begin : begin + segments.ticks])
        out[k] = binned(moved[:, axes], segments.every, segments.averaged)
    return out


def whole_log(model: MujocoJoint, measured: Signals, commands: Signals) -> Signals:
    """Link angle `q` [rad] of a free run over the time of a log."""
    target = model.target
    device, row = target.device, _readable(target)
    start, duration, motion = begin_of(device, measured, commands, row)
    time = start + np.arange(round(duration * TICK_RATE) + 1) / TICK_RATE
    plant = JointPlant(device, row)
    state = initial_state(plant, TICK_RATE, motion, 0)
    before = np.tile(passive_command(plant, state), (QUEUE, 1))
    moved = model.run(model.start(state, before), command_rows(device, commands, time[:-1]))
    return Signals(time, {"q": moved[:, 0]}, {"q": "rad"})
