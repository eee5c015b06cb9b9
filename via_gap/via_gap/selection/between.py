"""Decision between commands with zero-order hold and commands that are interpolated linearly, with their delay.

The delay is estimated by one Gauss-Newton step over device parameters, effects and delay. Interpolation is used if the
same effects, fitted again with it, are significantly better on held-out data, by a relevant amount. They also have to
be better than with a zero-order hold that has a dead time of its own. Without any effect, interpolation might imitate a
part of one, so it has to explain half of the error. A delay below half a sample cannot be distinguished from a slower
controller. It is a note, not a cause.

Measured torques that drive the simulation may be late as well, because a current is filtered before it is recorded.
Then the delay is negative, and torques are shifted forward. A shift resembles viscous friction, so it is tried only
beside the best effects.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.linalg import solve
from via_sim.catalogue.sensor.channel_skew import MAX_SKEW

from via_gap.candidates.location import Location
from via_gap.candidates.refinement import FINISHING, fit_on, member_slopes, refine
from via_gap.candidates.scales import Scales
from via_gap.candidates.subset import subset
from via_gap.logs.between import period_of
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import lined
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.verdict import accepted

DELAY = Location("actuator_delay", "command", 0)
STEP = 0.05  # of a sample: finite-difference step of the delay
TURNS = 4  # Gauss-Newton steps of the delay at most


def with_interpolation(experiment: Experiment, best: Evaluation, scales: Scales) -> Experiment | None:
    """The experiment with interpolated commands; None if they are not accepted beside `best`."""
    if experiment.folds is not None:
        return None
    late = _late(subset(experiment.fitted, best.fit.residual)[0], best, scales)
    if late is None:
        return None
    other = experiment.in_lines(late)
    lines = _refined(other, other.tuned, best, scales)
    imitated = not best.fit.effects and lines.rms - 1.0 > (1.0 - NUMBERS.remaining) * (best.rms - 1.0)
    if imitated or not accepted(lines, best, best):
        return None
    steps = [_refined(experiment, best, best, scales), *_delayed(experiment, best, scales)]
    return other if all(accepted(lines, each, each) for each in steps) else None


def _delayed(experiment: Experiment, best: Evaluation, scales: Scales) -> list[Evaluation]:
    """Evaluation of `best` with a dead time of the commands beside its effects, which lines have as well."""
    if DELAY in best.fit.locations:
        return []
    here = period_of(experiment.fitted.views[0].segments.log)
    fit = refine(experiment.fitted, best.fit, [*best.fit.members, (DELAY, [0.5 * here])], scales, FINISHING)
    return [] if fit is None else experiment.evaluate([fit])


def _refined(experiment: Experiment, start: Evaluation, best: Evaluation, scales: Scales) -> Evaluation:
    """Evaluation of the effects of `best` fitted in an experiment, from the device parameters of `start`."""
    if not best.fit.effects:
        return start
    fit = refine(experiment.fitted, start.fit, best.fit.members, scales, FINISHING)
    return start if fit is None else experiment.evaluate([fit])[0]


def _late(few: ResidualModel, best: Evaluation, scales: Scales) -> float | None:
    """[s] delay of interpolated commands; None if to first order they explain no more."""
    log = few.views[0].segments.log
    period = period_of(log)
    ends = (-MAX_SKEW if best.fit.effects and few.views[0].segments.measured_drive else 0.0, 0.5 * period)
    late, predicted = 0.0, np.inf
    for _ in range(TURNS):
        before = late
        late, predicted = _step(few, best, scales, late, ends)
        if late >= 0.0 or abs(late - before) < STEP * period:
            break
    now = fit_on(few, best.fit)
    return late if predicted < now.loss - NUMBERS.margin * len(now.residual) else None


def _step(
    few: ResidualModel, best: Evaluation, scales: Scales, late: float, ends: tuple[float, float]
) -> tuple[float, float]:
    """Delay [s] of interpolated commands between `ends` after a Gauss-Newton step from `late`, and the predicted loss.

    Device parameters and effects take the step as well.
    """
    period = period_of(few.views[0].segments.log)
    lines, later = (few.under(partial(lined, late=each)) for each in (late, late + STEP * period))
    start, moved = fit_on(lines, best.fit), fit_on(later, best.fit)
    own = lines.nuisance_jacobian(start.effects, start.offsets, start.residual)
    if few.views[0].segments.measured_drive:  # the shift takes the place of their delay between samples
        own[:, few.delays] = 0.0
    shift = (moved.residual - start.residual) / STEP
    columns = [own, shift[:, None]]
    if start.effects:
        columns.insert(1, member_slopes(lines, start, scales))
    slopes = np.concatenate(columns, axis=1)
    weighted = slopes * lines.weights(start.residual)[:, None]
    normal = weighted.T @ weighted
    known = np.arange(own.shape[1])
    normal[known, known] += 1.0
    pull = weighted.T @ (lines.weights(start.residual) * start.residual)
    pull[known] += start.offsets
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    step = -solve(normal / np.outer(scale, scale) + 1e-9 * np.eye(len(scale)), pull / scale, assume_a="pos") / scale
    found = float(np.clip(late + step[-1] * period, *ends))
    step[-1] = (found - late) / period
    return found, float(lines.loss(start.residual + slopes @ step))
