"""Evidence on data not fitted: held-out shots simulated with each fitted cause, compared shot by shot.

A cause's score is the mean over held-out shots of log(1 + z^2), z^2 the mean squared whitened error of a shot: an error
halved counts the same wherever it is, and nothing is gained below the noise. Free runs are scored by log(1 + mean z^2):
their gap is the mean squared error, far beyond the noise wherever a model is not quite right. Neighbouring shots share
what the joint was doing, so that differences are judged by resampling blocks of shots, never as if rows were
independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_core.signals import Array
from via_sim.catalogue import EFFECTS

from via_gap.candidates.fit import Fit
from via_gap.residual.residual_model import Problem
from via_gap.selection.calibration import Calibration

BLOCK = 1.0  # [s] of shots that are resampled together, at least one shot
RESAMPLES = 300
NOISE = float(np.log(2.0))  # score of an error that is the sensors' own


@dataclass(frozen=True, eq=False)
class Judged:
    """A fit and what it is worth on held-out shots.

    residual  (R,) whitened, held out
    shots     (S,) mean squared whitened error of each shot
    block     shots that are resampled together
    free      whether they are free runs
    """

    fit: Fit
    residual: Array
    shots: Array
    block: int
    free: bool = False

    @property
    def score(self) -> float:
        return float(np.log1p(self.mean_square) if self.free else np.mean(np.log1p(self.shots)))

    @property
    def mean_square(self) -> float:
        return float(np.mean(self.shots))


def judge(held: Problem, fits: Sequence[Fit]) -> list[Judged]:
    """Every fit on the held-out shots, in the order given."""
    if not fits:
        return []
    residuals = held.residual([held.row(fit.effects, fit.deviations) for fit in fits])
    first = held.benches[0].shots
    block = max(1, round(BLOCK * first.rate / first.ticks))
    return [
        Judged(fit, residual, held.per_shot(residual), block) for fit, residual in zip(fits, residuals, strict=True)
    ]


def difference(a: Judged, b: Judged, seed: int = 0) -> tuple[float, float]:
    """How much worse a scores than b, and the standard deviation of that by resampled blocks."""
    if not a.free:
        return _resampled(np.log1p(a.shots) - np.log1p(b.shots), a.block, seed)
    between = 1.0 + 0.5 * (a.mean_square + b.mean_square)  # the slope of the logarithm between the two
    return _resampled((a.shots - b.shots) / between, a.block, seed)


def _resampled(values: Array, block: int, seed: int) -> tuple[float, float]:
    """Mean of values (S,) and its standard deviation by resampled blocks."""
    size = min(block, max(1, len(values) // 4))
    blocks = [float(np.mean(values[i : i + size])) for i in range(0, len(values), size)]
    pick = np.random.default_rng(seed).integers(0, len(blocks), (RESAMPLES, len(blocks)))
    return float(np.mean(values)), float(np.std(np.array(blocks)[pick].mean(axis=1)))


def significant(worse: Judged, better: Judged, calibration: Calibration) -> bool:
    """Whether one is better than the other and not by chance: in ratios, shot by shot, or in squared error as a whole.

    An effect that acts in a few shots only shows in the second, one that acts everywhere a little in the first.
    """
    for gap, deviation in (difference(worse, better), _resampled(worse.shots - better.shots, worse.block, 0)):
        if gap > 0.0 and gap >= calibration.significance * deviation:
            return True
    return False


def probabilities(judged: Sequence[Judged], calibration: Calibration) -> Array:
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


def cost(each: Judged, calibration: Calibration) -> float:
    """Held-out score, and what it costs to be the less simple or the rarer of two causes that no log tells apart."""
    rare = sum(calibration.rare.get(effect.name, 0.0) for effect in each.fit.effects)
    return each.score + calibration.parsimony * freedom(each.fit) + rare


def needless(each: Judged, simpler: Judged, calibration: Calibration) -> bool:
    """Whether a richer effect at the same place does nothing that the simpler one does not."""
    if freedom(each.fit) <= freedom(simpler.fit) or each.fit.places[-1].site != simpler.fit.places[-1].site:
        return False
    if each.fit.places[-1].motor != simpler.fit.places[-1].motor:
        return False
    gain, deviation = difference(simpler, each)
    return gain < max(calibration.margin, calibration.significance * deviation)
