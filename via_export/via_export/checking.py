"""The gap of logs in MuJoCo itself: the exported model without and with effects, beside the same in via_sim.

Both simulators run the same segments (or, with servos, whole logs) from the same starts under the same commands, and
their errors are measured in the same way (via_gap.residual). For a report by inverse dynamics, both are simulated in
segments, because MuJoCo's model has no equation to evaluate without accelerations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from via_core.devices import Device
from via_core.signals import Array
from via_gap.logs.log import JointLog
from via_gap.logs.replay import TICK_RATE
from via_gap.report.report import LogInterval
from via_gap.report.withheld import compared_segments
from via_gap.residual.errors import Errors, free_errors, run_errors, segment_errors
from via_gap.residual.recordings import follows
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_sim.effects import Effect

from via_export.exporting import Export, export
from via_export.log_runs import segment_angles, whole_log
from via_export.mujoco_joint import MujocoJoint

Loaded = Callable[[float], MujocoJoint]  # of the rate [Hz] of command rows


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
    held_out: Sequence[LogInterval] = (),
) -> Check:
    """The gap before and after `effects` in MuJoCo and in via_sim.

    into, joint  a given model, see `export`; its other joints are locked
    held_out     parts of the logs to compare, see GapReport.held_out; empty: all of them

    Raises SignalError where nothing can be simulated, ParameterError as `export`.
    """
    folder = Path(into).parent if into is not None else None
    sides = ((), tuple(effects))
    before, after = (partial(_loaded, export(device, added, "mjcf", into, joint), folder) for added in sides)
    segments, chosen = compared_segments(logs, held_out)
    if follows(device):
        runs = (partial(whole_log, load(TICK_RATE)) for load in (before, after))
        in_mujoco = [run_errors(device, run, segments, chosen) for run in runs]
        in_via_sim = [free_errors(device, added, segments, chosen) for added in sides]
    else:
        problem = ResidualModel.of(segments, chosen, Rollout.of)
        in_mujoco = [segment_errors(problem, _residual(problem, load)) for load in (before, after)]
        in_via_sim = [segment_errors(problem, each) for each in problem.residual([problem.row(s) for s in sides])]
    return Check((in_mujoco[0], in_mujoco[1]), (in_via_sim[0], in_via_sim[1]))


def _loaded(made: Export, folder: Path | None, rate: float) -> MujocoJoint:
    return MujocoJoint(made.text, made.target, made.link, rate, folder)


def _residual(problem: ResidualModel, load: Loaded) -> Array:
    """Whitened residual (R,) of the problem's segments, simulated with a model in MuJoCo."""
    parts = []
    for view in problem.views:
        assert isinstance(view, Rollout)
        parts.append(view.whitened(segment_angles(load(view.segments.rate), view)[None]).ravel())
    return np.concatenate(parts)
