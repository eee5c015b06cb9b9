"""Models that held-out data do not distinguish from the best one (its confidence set), and the doubt they leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array

from via_gap.candidates.location import Location
from via_gap.selection.confidence_set import confidence_set
from via_gap.selection.evidence import (
    Evaluation,
    Kinds,
    block_means,
    freedom,
    kinds_of,
    losses,
    outdone_by,
    resamples,
    simplest,
)
from via_gap.selection.numbers import NUMBERS

SAME = 0.1  # of the margin: two models whose losses differ by less in a mean segment are one model under two names


def tied_with(chosen: Evaluation, rivals: Sequence[Evaluation]) -> list[Evaluation]:
    """The models in the confidence set of all models as large as the chosen one, the chosen one first."""
    stacked = _block_losses(rivals, chosen)
    kept, _ = confidence_set(stacked, resamples(stacked.shape[1]), NUMBERS.margin, NUMBERS.significance)
    others = [rivals[k] for k in kept if rivals[k] is not chosen and not outdone_by(rivals[k], chosen)]
    return [chosen, *others]


def _block_losses(models: Sequence[Evaluation], reference: Evaluation) -> Array:
    """(K, B) mean losses of blocks."""
    return block_means(np.stack([losses(each, reference) for each in models]), reference.block)


def _agreeing(models: Sequence[Evaluation]) -> list[int]:
    """Index of the first of the models that each agrees with: the same error under another name."""
    found: list[int] = []
    for number, each in enumerate(models):
        same = (k for k in dict.fromkeys(found) if _apart(each, models[k]) <= SAME * NUMBERS.margin)
        found.append(next(same, number))
    return found


def _apart(one: Evaluation, other: Evaluation) -> float:
    """Mean difference of the losses of two models in a segment."""
    return float(np.mean(np.abs(losses(one, other) - losses(other, one))))


def plainest(tied: Sequence[Evaluation]) -> Evaluation:
    """The model with the fewest parameters among those that are the first one under another name."""
    same = [each for each, number in zip(tied, _agreeing(tied), strict=True) if number == 0]
    return min(same, key=lambda each: (freedom(each.fit), each.score, str(each.fit.locations)))


def common_part(tied: Sequence[Evaluation], models: Sequence[Evaluation]) -> Evaluation | None:
    """The plainest model of the effects that all tied models have in common; None if it is not among `models`."""
    common = frozenset.intersection(*map(kinds_of, tied))
    found = [each for each in models if common and kinds_of(each) == common]
    return simplest(found) if found else None


def _parts(models: Sequence[Evaluation]) -> Array:
    """(K,) frequency of each model in the best one on resampled blocks, divided between similar models.

    One model under several names has equal parts, and so have models within the margin, which does not matter. A model
    that the best one outdoes has none: resamples without the few segments that show it know less.
    """
    first = [models[number] for number in _agreeing(models)]
    best = min(first, key=lambda each: each.score)
    possible = np.array([not outdone_by(each, best) for each in first])
    stacked = _block_losses(first, first[0])
    means = stacked[:, resamples(stacked.shape[1])].mean(axis=2)
    weight = possible[:, None] * np.exp(np.minimum(1.0 - (means - means[possible].min(axis=0)) / NUMBERS.margin, 0.0))
    return np.asarray((weight / weight.sum(axis=0)).mean(axis=1))


def different(models: Sequence[Evaluation]) -> int:
    """Number of models that differ in more than their names."""
    return len(set(_agreeing(models)))


def doubt(tied: Sequence[Evaluation]) -> float:
    """Number of equally likely causes that would leave as much doubt about the least certain effect of the first model.

    What the tied models have in the place of an effect has parts with the entropy of so many equal ones. Two effects
    with two alternatives each are four models, but two alternatives: in the place of an effect is what replaces it
    beside the same other effects.
    """
    kinds = [kinds_of(tied[number]) for number in _agreeing(tied)]
    parts, numbers = _parts(tied), []
    for location in tied[0].fit.locations:
        own = frozenset((location.plainest, *spot) for spot in location.spots)
        replacing = frozenset().union(*(each - kinds[0] for each in kinds if kinds[0] - own <= each))
        share: dict[Kinds, float] = {}
        for each, part in zip(kinds, parts, strict=True):
            new = each - kinds[0]
            instead = own if own <= each else new & replacing or new
            share[instead] = share.get(instead, 0.0) + float(part)
        values = np.array([each for each in share.values() if each > 0.0])
        numbers.append(float(np.exp(-np.sum(values * np.log(values)))))
    return max(numbers)


def shares_of(rivals: Sequence[Evaluation]) -> tuple[tuple[tuple[Location, float], ...], tuple[Evaluation, ...]]:
    """Share of each location in the best of `rivals`, and of the models with it the one with the largest part."""
    share = _parts(rivals)
    total: dict[Location, float] = {}
    model: dict[Location, tuple[float, Evaluation]] = {}
    for each, part in zip(rivals, map(float, share), strict=True):
        for location in each.fit.locations:
            total[location] = total.get(location, 0.0) + part
            if location not in model or part > model[location][0]:
                model[location] = part, each
    order = sorted(total, key=lambda location: (-total[location], freedom(model[location][1].fit)))
    shares = tuple((location, min(total[location], 1.0)) for location in order)
    return shares, tuple(model[location][1] for location in order)
