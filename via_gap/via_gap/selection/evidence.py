"""Evidence on data not fitted: held-out segments simulated with each fitted cause, compared segment by segment.

A cause's score is the mean over held-out segments of log(1 + z^2), z^2 the mean squared whitened error of a segment: an
error halved counts the same wherever it is, and nothing is gained below the noise. Free runs are scored by log(1 + mean
z^2): their gap is the mean squared error, far beyond the noise wherever a model is not quite right. Neighbouring
segments share what the joint was doing, so that differences are judged by resampling blocks of segments, never as if
rows were independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_core.signals import Array
from via_sim.catalogue import EFFECTS

from via_gap.candidates.fit import Fit
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.calibration import Calibration

BLOCK = 1.0  # [s] of segments that are resampled together, at least one segment
RESAMPLES = 300
NOISE = float(np.log(2.0))  # score of an error that is the sensors' own


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fit and what it is worth on held-out segments.

    residual  (R,) whitened, held out
    segments  (S,) mean squared whitened error of each segment
    block     segments that are resampled together
    free      whether they are free runs
    """

    fit: Fit
    residual: Array
    segments: Array
    block: int
    free: bool = False

    @property
    def score(self) -> float:
        return float(np.log1p(self.mean_square) if self.free else np.mean(np.log1p(self.segments)))

    @property
    def mean_square(self) -> float:
        return float(np.mean(self.segments))


def judge(held: ResidualModel, fits: Sequence[Fit]) -> list[Evaluation]:
    """Every fit on the held-out segments, in the order given."""
    if not fits:
        return []
    residuals = held.residual([held.row(fit.effects, fit.deviations) for fit in fits])
    first = held.views[0].segments
    block = max(1, round(BLOCK * first.rate / first.ticks))
    return [
        Evaluation(fit, residual, held.per_segment(residual), block)
        for fit, residual in zip(fits, residuals, strict=True)
    ]


def difference(a: Evaluation, b: Evaluation, seed: int = 0) -> tuple[float, float]:
    """How much worse a scores than b, and the standard deviation of that by resampled blocks."""
    if not a.free:
        return _resampled(np.log1p(a.segments) - np.log1p(b.segments), a.block, seed)
    between = 1.0 + 0.5 * (a.mean_square + b.mean_square)  # the slope of the logarithm between the two
    return _resampled((a.segments - b.segments) / between, a.block, seed)


def _resampled(values: Array, block: int, seed: int) -> tuple[float, float]:
    """Mean of values (S,) and its standard deviation by resampled blocks."""
    size = min(block, max(1, len(values) // 4))
    blocks = [float(np.mean(values[i : i + size])) for i in range(0, len(values), size)]
    pick = np.random.default_rng(seed).integers(0, len(blocks), (RESAMPLES, len(blocks)))
    return float(np.mean(values)), float(np.std(np.array(blocks)[pick].mean(axis=1)))


def significant(worse: Evaluation, better: Evaluation, calibration: Calibration) -> bool:
    """Whether one is better than the other and not by chance: in ratios, by segment, or in squared error as a whole.

    An effect that acts in a few segments only shows in the second, one that acts everywhere a little in the first.
    """
    for gap, deviation in (difference(worse, better), _resampled(worse.segments - better.segments, worse.block, 0)):
        if gap > 0.0 and gap >= calibration.significance * deviation:
            return True
    return False


def probabilities(judged: Sequence[Evaluation], calibration: Calibration) -> Array:
    """Softmax of costs against the best, each softened by how well the difference in score is known."""
    best = min(judged, key=lambda each: cost(each, calibration))
    exponents = []
    for each in judged:
        _, deviation = difference(each, best)
        gap = cost(each, calibration) - cost(best, calibration)
        exponents.append(-max(gap, 0.0) / (calibration.temperature + deviation))
    weights = np.exp(np.array(exponents) - max(exponents))
    return weights / weights.sum()


def freedom(fit: Fit) -> int:
    """Number of parameters of the effects."""
    return sum(len(EFFECTS[effect.name].parameters) for effect in fit.effects)


def cost(each: Evaluation, calibration: Calibration) -> float:
    """Held-out score, and what it costs to be the less simple or the rarer of two causes that no log tells apart."""
    rare = sum(calibration.rare.get(effect.name, 0.0) for effect in each.fit.effects)
    return each.score + calibration.parsimony * freedom(each.fit) + rare


def needless(each: Evaluation, simpler: Evaluation, calibration: Calibration) -> bool:
    """Whether a richer effect at the same place does nothing that the simpler one does not."""
    if freedom(each.fit) <= freedom(simpler.fit) or each.fit.locations[-1].site != simpler.fit.locations[-1].site:
        return False
    if each.fit.locations[-1].motor != simpler.fit.locations[-1].motor:
        return False
    gain, deviation = difference(simpler, each)
    return gain < max(calibration.margin, calibration.significance * deviation)
