"""One decision from the evidence: verdict, named effects, ranking, probabilities and ties all follow from it.

Steps lead from the device's own numbers to larger sets of effects, each clearly and materially better than the one
before. With E the root mean squared whitened held-out error and `bound` the lowest error that a flexible model reaches,

    explained = (E(device numbers) - E(step)) / (E(device numbers) - E(bound))

The last step that matters is the answer. If it explains everything above the noise, it is the cause (`effect`,
`several_effects`); if most of what can be explained, the main cause (`main_effect`); if less, nothing is named
(`unknown`), provided that the flexible model shows that there is something to explain. What no model of the motion
explains is `cannot_tell`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from via_gap.candidates.fit import converged
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.selection.confidence_set import confidence_set
from via_gap.selection.evidence import Evaluation, block_means, clearly_worse, freedom, losses, resamples
from via_gap.selection.experiment import Experiment
from via_gap.selection.numbers import NUMBERS

Verdict = Literal["effect", "several_effects", "main_effect", "unknown", "no_gap", "cannot_tell"]
Locations = tuple[Location, ...]


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer.

    chosen      what the repaired simulator gets: device numbers and the effects named
    explained   fraction of the explainable error that `chosen` explains; 1 where nothing is to explain
    bound       lowest root mean squared whitened error that is achievable, the unit of `Evaluation.rms`
    shares      (location, share) of every cause compared, largest first: how often it is in the best model under
                resampling, ties shared; at most 1
    models      the model that speaks for each of `shares`, for those named `chosen`
    equivalent  locations that held-out data do not tell from those named
    reason      why nothing is named, for `cannot_tell`
    """

    verdict: Verdict
    chosen: Evaluation
    explained: float
    bound: float
    shares: tuple[tuple[Location, float], ...] = ()
    models: tuple[Evaluation, ...] = ()
    equivalent: Locations = ()
    reason: str = ""

    @property
    def named(self) -> Locations:
        return self.chosen.fit.locations

    def refuted(self, tuned: Evaluation) -> Decision:
        """Nothing is named: the repair leaves no less of the held-out gap than the device's own numbers alone."""
        reason = "what explains the fitted recordings does not carry over to those held out"
        return replace(self, verdict="cannot_tell", chosen=tuned, explained=0.0, equivalent=(), reason=reason)

    def converged(self, experiment: Experiment, scales: Scales) -> Decision:
        """The same answer with the chosen fit led to its end, as the repair states it."""
        if not self.named:
            return self
        fit = converged(experiment.fitted, self.chosen.fit, scales)
        if experiment.folds is not None:
            (chosen,) = experiment.folds.evaluate([fit], scales)
        else:
            (chosen,) = experiment.evaluate([fit])
        models = tuple(chosen if each is self.chosen else each for each in self.models)
        return replace(self, chosen=chosen, models=models)


def decide(
    tuned: Evaluation, models: Sequence[Evaluation], flexible_beside: Callable[[Evaluation], Evaluation]
) -> Decision:
    """The decision about `models`, which are plausible, supported by both views, and compared on the same segments.

    flexible_beside  evaluation of a flexible torque model beside the effects of a model
    """
    if noise_only(tuned):
        return Decision("no_gap", tuned, 1.0, tuned.rms)
    steps = ladder(tuned, models)
    last = steps[-1]
    flexible = flexible_beside(last)
    if not noise_only(last) and last is not tuned:  # beside a wrong cause it may explain less than alone
        flexible = min(flexible, flexible_beside(tuned), key=lambda each: each.score)
    bound = min(flexible.rms, last.rms)
    explained = fraction(tuned, last, bound)
    if last is tuned:
        if matters(flexible, tuned, tuned):
            return _unnamed("unknown", tuned, models, bound, "")
        return _unnamed("cannot_tell", tuned, models, bound, "what the model leaves does not repeat with the motion")
    if explained < NUMBERS.most:
        return _unnamed("unknown", tuned, models, bound, "")
    if fraction(tuned, last, 1.0) < NUMBERS.substantial:
        reason = f"what is left repeats with no motion and outweighs what {last.fit.locations[0]} would explain"
        return _unnamed("cannot_tell", tuned, models, bound, reason)
    rivals = without_needless([each for each in models if len(each.fit.effects) == len(last.fit.effects)])
    tied = _tied(last, rivals)
    verdict: Verdict = "main_effect"
    if min(explained, fraction(tuned, last, 1.0)) >= NUMBERS.complete:
        verdict = "effect" if len(last.fit.effects) == 1 else "several_effects"
    equivalent = tuple(dict.fromkeys(place for each in (last, *tied) for place in each.fit.locations))
    if len(tied) > NUMBERS.largest_set:
        reason = f"{len(tied)} causes explain these data equally well"
        return replace(_unnamed("cannot_tell", tuned, models, bound, reason), equivalent=equivalent)
    shares, spoken = _shares(rivals)
    alone = {each.fit.locations[0]: each.score for each in models if len(each.fit.effects) == 1}
    ranked = sorted(
        ((p, round(share, 9), model) for (p, share), model in zip(shares, spoken, strict=True)),
        key=lambda each: (-each[1], alone.get(each[0], np.inf)),
    )
    shares, spoken = tuple((p, share) for p, share, _ in ranked), tuple(model for _, _, model in ranked)
    spoken = tuple(last if p in last.fit.locations else m for (p, _), m in zip(shares, spoken, strict=True))
    return Decision(verdict, last, explained, bound, shares, spoken, equivalent)


def noise_only(each: Evaluation) -> bool:
    """Whether a model leaves no more than the noise, as well as that is known."""
    return each.mean_square <= NUMBERS.no_gap


def fraction(tuned: Evaluation, model: Evaluation, bound: float) -> float:
    """Fraction of the explainable error that a model explains, at most 1."""
    possible = tuned.rms - max(bound, 1.0)
    return 1.0 if possible <= 0.0 else min((tuned.rms - max(model.rms, 1.0)) / possible, 1.0)


def matters(more: Evaluation, fewer: Evaluation, tuned: Evaluation) -> bool:
    """Whether a model with more effects is clearly better than one with fewer, and by a share that is material."""
    return improves(more, fewer, tuned) and clearly_worse(fewer, more)


def improves(more: Evaluation, fewer: Evaluation, tuned: Evaluation) -> bool:
    """Whether a model explains a material share of the error more, or half of what is left, clearly or not.

    Then larger ones are worth a fit. What is left counts only where there is more than noise.
    """
    gain = fewer.rms - max(more.rms, 1.0)
    remaining = not noise_only(fewer) and gain > NUMBERS.remaining * (fewer.rms - 1.0)
    return remaining or gain > NUMBERS.material * (tuned.rms - 1.0)


def ladder(tuned: Evaluation, models: Sequence[Evaluation]) -> list[Evaluation]:
    """The device's own numbers, then ever larger sets of effects, each of which matters beside the one before it."""
    steps = [tuned]
    for size in sorted({len(each.fit.effects) for each in models} - {0}):
        step = simplest([each for each in models if len(each.fit.effects) == size])
        if matters(step, steps[-1], tuned):
            steps.append(step)
    return steps


def simplest(models: Sequence[Evaluation]) -> Evaluation:
    """The best of the models without the needless ones."""
    return min(without_needless(models), key=lambda each: (each.score, freedom(each.fit), str(each.fit.locations)))


def without_needless(models: Sequence[Evaluation]) -> list[Evaluation]:
    """The models but for those that one with fewer parameters at the same sites does as well as."""

    def needless(each: Evaluation, other: Evaluation) -> bool:
        same = _sites(each) == _sites(other) and freedom(other.fit) < freedom(each.fit)
        return same and not clearly_worse(other, each)

    return [each for each in models if not any(needless(each, other) for other in models)]


def _sites(each: Evaluation) -> list[tuple[str, int]]:
    """Every single place, so that one cause at both motors is held against one at each."""
    return sorted(spot for location in each.fit.locations for spot in location.spots)


def _tied(chosen: Evaluation, rivals: Sequence[Evaluation]) -> list[Evaluation]:
    """The models in the confidence set of all models as large as the chosen one, the chosen one first."""
    stacked = block_means(np.stack([losses(each, chosen) for each in rivals]), chosen.block)
    kept, _ = confidence_set(stacked, resamples(stacked.shape[1]), NUMBERS.margin, NUMBERS.significance)
    others = [rivals[k] for k in kept if rivals[k] is not chosen]
    return [chosen, *others]


def _shares(rivals: Sequence[Evaluation]) -> tuple[tuple[tuple[Location, float], ...], tuple[Evaluation, ...]]:
    """How often each location is in the best of `rivals` on resampled blocks; models within the margin share."""
    stacked = block_means(np.stack([losses(each, rivals[0]) for each in rivals]), rivals[0].block)
    means = stacked[:, resamples(stacked.shape[1])].mean(axis=2)
    weight = np.exp(-(means - means.min(axis=0)) / NUMBERS.margin)
    share = (weight / weight.sum(axis=0)).mean(axis=1)
    total: dict[Location, float] = {}
    model: dict[Location, tuple[float, Evaluation]] = {}
    for each, part in zip(rivals, map(float, share), strict=True):
        for place in each.fit.locations:
            total[place] = total.get(place, 0.0) + part
            if place not in model or part > model[place][0]:
                model[place] = part, each
    order = sorted(total, key=lambda place: (-total[place], freedom(model[place][1].fit)))
    return tuple((place, min(total[place], 1.0)) for place in order), tuple(model[place][1] for place in order)


def _unnamed(verdict: Verdict, tuned: Evaluation, models: Sequence[Evaluation], bound: float, reason: str) -> Decision:
    """Nothing is named: the device's own numbers stay, single causes are ranked beside them."""
    singles = without_needless([each for each in models if len(each.fit.effects) == 1])
    shares, spoken = _shares([tuned, *singles])
    return Decision(verdict, tuned, 0.0, bound, shares, spoken, (), reason)
