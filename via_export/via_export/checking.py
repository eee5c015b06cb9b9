"""The gap of logs in MuJoCo itself: the exported model without and with effects, beside the same in via_sim.

Both simulators run the same segments (or, with servos, whole logs) from the same starts under the same commands, and
their errors are measured in the same way (via_gap.residual). For a report by inverse dynamics, both are simulated in
segments, because MuJoCo's model has no equation to evaluate without accelerations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from via_core.devices import Device
from via_core.signals import Array, Signals
from via_gap.logs.log import JointLog
from via_gap.logs.replay import TICK_RATE, begin_of
from via_gap.report.report import HeldOutInterval
from via_gap.report.withheld import before_and_after, compared_segments
from via_gap.residual.errors import Errors, run_errors, segment_errors
from via_gap.residual.recordings import follows
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import binned
from via_sim.effects import Effect
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.simulate import command_rows, initial_state, passive_command

from via_export.exporting import export
from via_export.mujoco_joint import QUEUE, MujocoJoint
from via_export.target import Target


@dataclass(frozen=True)
class Check:
    """Errors on the same data: of the nominal device, and of that with effects.

    mujoco  before and after in MuJoCo
    via_sim before and after in the simulator of the diagnosis
    """

    mujoco: tuple[Errors, Errors]
    via_sim: tuple[Errors, Errors]

    @property
    def floor(self) -> float:
        """The gap that sensor noise alone explains."""
        return float(np.sqrt(np.mean(self.via_sim[0].floors ** 2)))

    @property
    def difference(self) -> float:
        """Gap after the repair in MuJoCo minus that in via_sim."""
        return self.mujoco[1].overall - self.via_sim[1].overall


def check(
    logs: Sequence[JointLog],
    device: Device,
    effects: Sequence[Effect],
    into: str | Path | None = None,
    joint: str = "",
    held_out: Sequence[HeldOutInterval] = (),
) -> Check:
    """The gap before and after `effects` in MuJoCo and in via_sim.

    into, joint  a given model, see `export`; its other joints are locked
    held_out     parts of the logs to compare, see GapReport.held_out; empty: all of them

    Raises SignalError where nothing can be simulated, ParameterError as `export`.
    """
    segments, chosen = compared_segments(logs, held_out)
    sides = []
    for added in ((), tuple(effects)):
        made = export(device, added, "mjcf", into, joint)
        folder = Path(into).parent if into is not None else None
        if follows(device):
            model = MujocoJoint(made.text, made.target, made.link, TICK_RATE, folder)
            sides.append(run_errors(device, _WholeLog(model).run, segments, chosen))
            continue
        problem = ResidualModel.of(segments, chosen, Rollout.of)
        parts = []
        for view in problem.views:
            assert isinstance(view, Rollout)
            model = MujocoJoint(made.text, made.target, made.link, view.segments.rate, folder)
            parts.append(view.whitened(_segments(model, view)[None]).ravel())
        sides.append(segment_errors(problem, np.concatenate(parts)))
    return Check((sides[0], sides[1]), before_and_after(logs, device, effects, held_out))


def _readable(target: Target) -> Array:
    """The row without encoder errors that MuJoCo's sensors lack."""
    row = target.row.copy()
    row[P.encoder_harmonics : P.encoder_harmonics + 3] = 0.0
    return row


def _segments(model: MujocoJoint, view: Rollout) -> Array:
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


@dataclass(frozen=True)
class _WholeLog:
    """Free runs of whole logs."""

    model: MujocoJoint

    def run(self, measured: Signals, commands: Signals) -> Signals:
        """Link angle over the time of a log."""
        target = self.model.target
        device, row = target.device, _readable(target)
        start, duration, motion = begin_of(device, measured, commands, row)
        time = start + np.arange(round(duration * TICK_RATE) + 1) / TICK_RATE
        state = initial_state(JointPlant(device, row), TICK_RATE, motion, 0)
        before = np.tile(passive_command(JointPlant(device, row), state), (QUEUE, 1))
        moved = self.model.run(self.model.start(state, before), command_rows(device, commands, time[:-1]))
        return Signals(time, {"q": moved[:, 0]}, {"q": "rad"})
