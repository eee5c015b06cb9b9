"""Held-out evidence: loss of a fitted model on segments to which it was not fitted, and comparison of two models.

The loss of a segment is log(1 + z^2), with z^2 its mean squared whitened error: halving an error counts the same at any
size, and little is gained below the noise. The loss of runs over whole recordings (servos) is log(1 + mean z^2),
because their gap is the mean squared error. Errors of neighbouring segments are correlated; differences between two
models are therefore averaged in blocks, whose means count as independent. A rest counts as one segment.

One criterion serves every comparison (adding, dropping, replacing an effect; a veto of inverse dynamics). Model a is
significantly worse than model b if

- loss(a) - loss(b) exceeds the margin on held-out segments, and
- the lower end of its confidence interval exceeds the margin on all segments, fitted ones included.

Fitted segments are included because a short log has few held-out ones. This is possible because a fit with few
parameters cannot overfit many segments: each additional parameter may explain one by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.stats import t as student_t
from via_core.signals import Array, Indices, Mask

from via_gap.candidates.fit import Fit
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.numbers import NUMBERS

BLOCK = 1.0  # [s] of segments whose errors are correlated; at least one segment
RESAMPLES = 300
Kinds = frozenset[tuple[str, str, int]]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fit and its held-out evidence.

    residual  (R,) whitened held-out residual
    segments  (S,) mean squared whitened error of each segment; one value for all segments of one rest
    block     number of segments whose errors are correlated
    whole     whether segments are runs over whole recordings
    other_view  (W,) mean squared whitened error of each segment in the other view; empty if it is not available
    fitted    (F,) that of each fitted segment; empty for cross-validation, where every segment is held out once, and
              for models that are not fitted
    shared    (S,) whether a segment is among the fitted ones as well: it contains an event; empty if none is
    """

    fit: Fit
    residual: Array
    segments: Array
    block: int
    whole: bool = False
    other_view: Array = field(default_factory=lambda: np.empty(0))
    fitted: Array = field(default_factory=lambda: np.empty(0))
    shared: Mask = field(default_factory=lambda: np.empty(0, dtype=np.bool_))

    @property
    def score(self) -> float:
        """Mean loss; log 2 = .69 for noise alone."""
        return float(np.log1p(self.mean_square) if self.whole else np.mean(np.log1p(self.segments)))

    @property
    def mean_square(self) -> float:
        return float(np.mean(self.segments))

    @property
    def rms(self) -> float:
        """Root mean squared whitened error, for which large errors in few segments count most; 1 for noise alone."""
        return float(np.sqrt(self.mean_square))

    @property
    def typical(self) -> float:
        """Whitened error of a typical segment, the one whose loss is the mean loss; 1 for noise alone."""
        return float(np.sqrt(np.expm1(self.score)))

    @property
    def on_fitted(self) -> Evaluation:
        """The same fit with its error on the fitted segments."""
        return Evaluation(self.fit, self.fitted, self.fitted, self.block)

    @property
    def on_all(self) -> Evaluation:
        """The same fit with its error on the fitted and the held-out segments, each once."""
        only = self.segments[~self.shared] if self.shared.size and self.fitted.size else self.segments
        none = np.empty(0, dtype=np.bool_)
        return replace(self, segments=np.concatenate((self.fitted, only)), fitted=np.empty(0), shared=none)

    @property
    def apart(self) -> Evaluation:
        """The same fit with its error on the held-out segments that are not fitted as well."""
        return Evaluation(self.fit, self.residual, self.segments[~self.shared], self.block)

    @property
    def in_other_view(self) -> Evaluation:
        """The same fit with its error in the other view."""
        return Evaluation(self.fit, self.other_view, self.other_view, self.block)


def evaluate(
    held: ResidualModel, fits: Sequence[Fit], other: ResidualModel | None = None, fitted: ResidualModel | None = None
) -> list[Evaluation]:
    """Evaluation of every fit on the held-out segments `held`, in the `other` view, and on the `fitted` segments."""
    if not fits:
        return []
    rows = [held.row(fit.effects, fit.offsets) for fit in fits]
    residuals = held.residual(rows)
    first = held.views[0].segments
    block = max(1, round(BLOCK * first.rate / first.ticks))
    seen = other.evidence(other.residual(rows)) if other is not None else np.empty((len(fits), 0))
    known = [fitted.evidence(fit.residual) if fitted is not None else np.empty(0) for fit in fits]
    shared = _shared(held, fitted) if fitted is not None else np.empty(0, dtype=np.bool_)
    return [
        Evaluation(fit, residual, held.evidence(residual), block, other_view=other_view, fitted=own, shared=shared)
        for fit, residual, other_view, own in zip(fits, residuals, seen, known, strict=True)
    ]


def _shared(held: ResidualModel, fitted: ResidualModel) -> Mask:
    """(S,) whether each held-out segment is fitted as well; empty if none is."""
    of_log = {id(view.segments.log): view.chosen for view in fitted.views}
    none: Indices = np.empty(0, dtype=np.intp)
    both = [np.isin(view.chosen, of_log.get(id(view.segments.log), none)) for view in held.views]
    found = np.concatenate(both)
    return held.once_per_rest(found.astype(np.float64)) == 1.0 if found.any() else np.empty(0, dtype=np.bool_)


def losses(each: Evaluation, reference: Evaluation) -> Array:
    """(S,) losses whose mean differences are those of the scores; for whole runs to first order."""
    if not each.whole:
        return np.log1p(each.segments)
    return each.segments / (1.0 + 0.5 * (each.mean_square + reference.mean_square))


def difference(a: Evaluation, b: Evaluation) -> tuple[float, float]:
    """Score of a minus score of b, and its standard deviation; 0 for a single block, whose scatter is not known."""
    gap, means = _differences(a, b)
    return gap, float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else 0.0


def least_difference(a: Evaluation, b: Evaluation) -> float:
    """Lower end of the one-sided confidence interval of `difference`, by Student's t of the means of blocks."""
    gap, sd = difference(a, b)
    return gap - quantile(len(_differences(a, b)[1])) * sd if sd > 0.0 else gap


def _differences(a: Evaluation, b: Evaluation) -> tuple[float, Array]:
    """Mean difference of the losses of all segments, and the means (B,) of blocks."""
    values = losses(a, b) - losses(b, a)
    return float(np.mean(values)), block_means(values[None], a.block)[0]


def significantly_worse(a: Evaluation, b: Evaluation) -> bool:
    """Whether the loss of a exceeds that of b by more than the margin, at the significance in `NUMBERS`.

    On held-out segments by its value; on all segments, if both models are fitted to the same, by the lower end of its
    confidence interval, or because a is refuted there. A fit to S segments whose values err together reduces their mean
    squared error by 1 / S per needless parameter.
    """
    one, other = with_fitted(a, b)
    needless = max(freedom(b.fit) - freedom(a.fit), 0) / len(one.segments) if one is not a else 0.0
    certain = least_difference(one, other) - needless > NUMBERS.margin or refuted_beside(one, other)
    return refuted_beside(a, b) or (certain and difference(a, b)[0] > NUMBERS.margin)


def with_fitted(a: Evaluation, b: Evaluation) -> tuple[Evaluation, Evaluation]:
    """Both with their errors on all segments, if they are fitted to the same; otherwise as they are."""
    alike = len(a.fitted) == len(b.fitted) > 0 and not a.whole
    return (a.on_all, b.on_all) if alike else (a, b)


def refuted_beside(a: Evaluation, b: Evaluation) -> bool:
    """Whether b explains all but noise, and a does not.

    Example: a limit that is reached twice. It is in so few segments that the mean loss is uncertain, but a model that
    explains them down to the noise does not do so by chance. Noise is known to a factor of `no_gap` in both.
    """
    factor = NUMBERS.no_gap**2
    return b.mean_square <= factor and a.mean_square > factor * max(b.mean_square, 1.0)


def outdone_by(a: Evaluation, b: Evaluation) -> bool:
    """Whether a is refuted beside b, or leaves a rare event that b explains.

    The comparison of blocks takes all blocks as alike; a push, or a limit that is reached twice, does not pass it. Such
    an event is certain if both hold:

    - a leaves more than b in the mean and in the largest error, by more than the noise is uncertain;
    - the largest error of a lies beyond the prediction interval of one more loss like those of b. They show how large
      the errors of a model with small faults (a belt, a slow sensor) become in this log.

    A model that explains one of several events is not enough: the others keep its mean up.
    """
    a, b = with_fitted(a, b)
    count = len(b.segments)
    if refuted_beside(a, b) or count < 2:
        return refuted_beside(a, b)
    factor = NUMBERS.no_gap**2
    pairs = ((np.mean(each.segments), np.max(each.segments)) for each in (a, b))
    usual = np.log1p(b.segments)
    widest = quantile(count, count) * np.std(usual, ddof=1) * np.sqrt(1.0 + 1.0 / count)
    beyond = np.log1p(a.segments.max()) > np.mean(usual) + widest
    return bool(beyond) and all(more > factor * max(less, 1.0) for more, less in zip(*pairs, strict=True))


def predicts(each: Evaluation, without: Evaluation) -> bool:
    """Whether a model is significantly better than `without` a model, on all segments in which the latter errs.

    Fitted segments count as well: a few parameters cannot make a model follow them. Segments that the prediction
    without a model explains up to the noise (a joint that rests) cannot show that a model is better.
    """
    line, own = without.on_all, each.on_all
    errs = line.segments > NUMBERS.no_gap
    if not np.any(errs):
        return False
    return significantly_worse(*(replace(e, segments=e.segments[errs]) for e in (line, own)))


def vetoed(candidate: Evaluation, reference: Evaluation) -> bool:
    """Whether `candidate` is significantly worse than `reference` in the other view.

    Not one with a wall: along a measured motion its torque is its stiffness times a depth that no encoder resolves.
    """
    if any(location.kind.touched for location in candidate.fit.locations):
        return False
    return bool(candidate.other_view.size) and significantly_worse(candidate.in_other_view, reference.in_other_view)


def block_means(values: Array, block: int) -> Array:
    """(K, S) values of segments -> (K, B) means of blocks of neighbouring segments, at least four blocks."""
    size = min(block, max(1, values.shape[1] // 4))
    edges = np.arange(0, values.shape[1], size)
    counts = np.diff(np.append(edges, values.shape[1]))
    return np.asarray(np.add.reduceat(values, edges, axis=1) / counts)


@cache
def resamples(blocks: int) -> Indices:
    """(RESAMPLES, blocks) indices of blocks, the same for every comparison."""
    return np.random.default_rng(0).integers(0, blocks, (RESAMPLES, blocks))


@cache
def quantile(count: int, trials: int = 1) -> float:
    """Student's t with `count` - 1 degrees of freedom that the largest of `trials` exceeds at the significance."""
    return float(student_t.ppf(1.0 - NUMBERS.significance / trials, count - 1))


def freedom(fit: Fit) -> int:
    """Number of fitted parameters of the effects: an order of whole periods per turn is not fitted."""
    return int(np.count_nonzero(np.diag(fit.covariance)))


def simplest(models: Sequence[Evaluation]) -> Evaluation:
    """The best of the models without the needless ones."""
    return min(without_needless(models), key=lambda each: (each.score, freedom(each.fit), str(each.fit.locations)))


def plainer(one: Evaluation, other: Evaluation) -> Evaluation:
    """Of two forms of the same effects the one with fewer parameters, unless the other is better by the margin."""
    few, many = sorted((one, other), key=lambda each: (freedom(each.fit), each.score))
    return many if few.score - many.score > NUMBERS.margin else few


def without_needless(models: Sequence[Evaluation]) -> list[Evaluation]:
    """The models without those that are not significantly better than one with fewer parameters at the same sites."""
    return _without_needless(models, _sites)


def compared(models: Sequence[Evaluation]) -> list[Evaluation]:
    """The models that share probability: those that are not merely a richer form of another one.

    A payload that is seen only by its inertia needs one parameter more than a changed inertia of the link, but is no
    less likely. A Stribeck friction without any Stribeck effect is just a Coulomb friction.
    """
    return _without_needless(models, kinds_of)


def _without_needless(models: Sequence[Evaluation], comparable: Callable[[Evaluation], object]) -> list[Evaluation]:
    """Only models that are equal in `comparable` compete by the number of their parameters."""

    def needless(each: Evaluation, other: Evaluation) -> bool:
        same = comparable(each) == comparable(other) and freedom(other.fit) < freedom(each.fit)
        return same and not significantly_worse(other, each)

    return [each for each in models if not any(needless(each, other) for other in models)]


def kinds_of(each: Evaluation) -> Kinds:
    """Every effect, as the simplest one that it contains, at every single site."""
    return frozenset((place.plainest, *spot) for place in each.fit.locations for spot in place.spots)


def _sites(each: Evaluation) -> list[tuple[str, int]]:
    """Every single site, so that one effect at both motors compares with one at each."""
    return sorted(spot for location in each.fit.locations for spot in location.spots)
