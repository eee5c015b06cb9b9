"""The gap of logs before and after a repair, measured again from a report's effects file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits
from via_core.devices import Device
from via_core.errors import SignalError
from via_sim.effects import Effect

from via_gap.logs.log import JointLog, believed
from via_gap.logs.quality import assessed
from via_gap.report.report import LogInterval
from via_gap.residual.errors import Errors, free_errors, segment_errors, torque_errors
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.recordings import follows
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Indices, Segments, cut_log


def before_and_after(
    logs: Sequence[JointLog],
    device: Device,
    effects: Sequence[Effect],
    held_out: Sequence[LogInterval] = (),
    only_equations: bool = False,
) -> tuple[Errors, Errors]:
    """Errors of the nominal device, and of the one with `effects` and the device numbers among them.

    Measured as in the report: in short segments where motors are driven by torque, else in one free run; over the whole
    logs, or over the intervals that a report held out.

    only_equations  measure by inverse dynamics, as in a report whose gap is `by` inverse dynamics

    Raises SignalError where nothing can be simulated, or the signals allow no inverse dynamics.
    """
    segments, chosen = compared_segments(logs, held_out)
    if follows(device) and not only_equations:
        return free_errors(device, (), segments, chosen), free_errors(device, effects, segments, chosen)
    problem = ResidualModel.of(segments, chosen, InverseDynamics.of if only_equations else Rollout.of)
    before, after = problem.residual([problem.row(()), problem.row(effects)])
    errors_of = torque_errors if only_equations else segment_errors
    return errors_of(problem, before), errors_of(problem, after)


@threadpool_limits.wrap(limits=1, user_api="blas")  # as in a diagnosis
def compared_segments(
    logs: Sequence[JointLog], held_out: Sequence[LogInterval]
) -> tuple[list[Segments], list[Indices]]:
    """The logs cut into segments, and which of them are compared.

    Raises SignalError where nothing can be simulated.
    """
    segments = [_cut(log, bool(held_out)) for log in believed(logs)]
    chosen = [_held(each, held_out) if held_out else np.flatnonzero(each.valid) for each in segments]
    if not any(map(len, chosen)):
        reason = "none of the intervals that the report held out" if held_out else "too short to compare"
        raise SignalError(f"{logs[0].name}: {reason}")
    return segments, chosen


def _cut(log: JointLog, as_diagnosed: bool) -> Segments:
    """The segments of a log with corrected stamps; as in a diagnosis, those where it cannot be used are invalid."""
    quality = assessed(log)
    return cut_log(quality.log, quality=quality if as_diagnosed else None)


def _held(segments: Segments, held_out: Sequence[LogInterval]) -> Indices:
    """Segments of one log whose middle lies in a held-out interval."""
    middle = segments.time - segments.log.measured.time[0] + 0.5 * segments.ticks / segments.rate
    inside = [(s.begin < middle) & (middle < s.end) for s in held_out if s.log == segments.log.name]
    return np.flatnonzero(segments.valid & np.any(inside, axis=0)) if inside else np.empty(0, dtype=np.intp)
