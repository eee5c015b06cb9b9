"""One decision, from which verdict, named effects, ranking, shares and ties follow.

Steps lead from the fitted device parameters (`tuned`) to larger sets of effects, each accepted beside the one before:
significantly better, and by a relevant amount. With E the whitened held-out error, and the bound that of a flexible
model,

    explained = (E(tuned) - E(step)) / (E(tuned) - E(bound))

E is the root mean square, to which rare large errors contribute most, or the error of a typical segment, to which they
contribute little. The larger of both fractions counts, because an effect may act rarely (a contact), and so may a
disturbance.

The last accepted step is the answer. The verdict depends on what it explains:

- everything above the noise, in held-out and in fitted segments: it is the cause (`effect`, `several_effects`);
- most of the explainable error: it is the main cause (`main_effect`);
- less: nothing is named (`unknown`).

If no model of the motion explains the error, the verdict is `cannot_tell`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Literal

import numpy as np

from via_gap.candidates.converged import converged
from via_gap.candidates.covariance import delay_sd
from via_gap.candidates.fit import Fit, event_times
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.selection import reliability
from via_gap.selection.evidence import Evaluation, compared, outdone_by, significantly_worse, simplest, without_needless
from via_gap.selection.experiment import Experiment
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.ties import (
    common_part,
    different,
    doubt,
    plainest,
    shares_of,
    tied_with,
)

Verdict = Literal["effect", "several_effects", "main_effect", "unknown", "no_gap", "cannot_tell"]
Locations = tuple[Location, ...]
UNNAMED = ("unknown", "cannot_tell")  # verdicts about a gap without a named cause
ERRORS = (attrgetter("rms"), attrgetter("typical"))  # sizes of the error of an `Evaluation`


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer.

    chosen      model of the repair: device parameters and named effects
    explained   fraction of the explainable error that `chosen` explains; 1 if there is none
    shares      (location, share) of every cause compared, largest first: frequency in the best model under resampling,
                ties divided; at most 1
    models      representatives: the model behind each of `shares`; for named ones `chosen`
    equivalent  named locations, and those that held-out data do not distinguish from them
    reason      why nothing is named, for `cannot_tell`
    widened     factor of the standard deviations of `chosen`, by calibration
    without     mean squared error of the repair without each of its effects, if it has several (contribution.py)
    transfer    share of the squared error that it leaves in motion to which it was not fitted (transfer.py)
    halves      fits to the halves of the motion between which it transfers worst
    rivals      models that were fitted for this decision, in addition to those of the search
    twins       two causes that no such log separates: the share of each is that of both together
    """

    verdict: Verdict
    chosen: Evaluation
    explained: float
    shares: tuple[tuple[Location, float], ...] = ()
    models: tuple[Evaluation, ...] = ()
    equivalent: Locations = ()
    reason: str = ""
    widened: float = 1.0
    without: tuple[float, ...] = ()
    transfer: Mapping[str, float] = field(default_factory=dict)
    halves: tuple[Fit, ...] = ()
    rivals: tuple[Evaluation, ...] = ()
    twins: Locations = ()

    @property
    def named(self) -> Locations:
        return self.chosen.fit.locations

    def part(self, location: Location) -> float:
        """Error that a named effect explains beside the others, in root mean square over the mean of all; else 1."""
        gains = [max(float(np.sqrt(left)) - self.chosen.rms, 0.0) for left in self.without]
        known = self.twins[0] if location in self.twins else location
        if known not in self.named or not any(gains):
            return 1.0
        return gains[self.named.index(known)] / float(np.mean(gains))

    def alone(self, location: Location) -> float:
        """The part of its share that a cause has for itself."""
        return 1.0 / len(self.twins) if location in self.twins else 1.0

    def refuted(self, tuned: Evaluation, why: str) -> Decision:
        """The decision that names nothing, for the reason `why`."""
        return replace(
            self, verdict="cannot_tell", chosen=tuned, explained=0.0, equivalent=(), reason=why, without=(),
            transfer={}, halves=(),
        )  # fmt: skip

    def converged(self, experiment: Experiment, scales: Scales) -> Decision:
        """The same decision with the chosen model, and those tied with it, fitted to convergence."""
        if not self.named:
            return self
        tied = [model for (cause, _), model in zip(self.shares, self.models, strict=True) if cause in self.equivalent]
        again = {id(each): _converged(each, experiment, scales, self.verdict) for each in (self.chosen, *tied)}
        models, rivals = (tuple(again.get(id(each), each) for each in some) for some in (self.models, self.rivals))
        chosen, wider = again[id(self.chosen)], reliability.wider(self.verdict)
        return replace(self, chosen=chosen, models=models, rivals=rivals, widened=wider)


def _converged(model: Evaluation, experiment: Experiment, scales: Scales, verdict: Verdict) -> Evaluation:
    fit = converged(experiment.fitted, model.fit, scales)
    unknown = delay_sd(experiment.fitted, fit.locations) ** 2  # by half a sample: it has its width
    bounded = np.diag(np.minimum(unknown, np.diag(fit.covariance)))
    covariance = reliability.widened(np.array(fit.values), fit.covariance - bounded, verdict) + bounded
    fit = replace(fit, covariance=covariance)
    return experiment.compare([fit], scales)[0]


def decide(
    tuned: Evaluation,
    models: Sequence[Evaluation],
    flexible_beside: Callable[[Evaluation], Evaluation],
    rivals_of: Callable[[Evaluation], Sequence[Evaluation]] = lambda _model: (),
) -> Decision:
    """The decision about `models`, which are plausible, supported by both views, and compared on the same segments.

    flexible_beside  evaluation of a flexible torque model beside the effects of a model
    rivals_of        further models with one effect of the named model replaced, with which it shares its probability
    """
    if no_gap(tuned):
        return Decision("no_gap", tuned, 1.0)
    unnamed = partial(_unnamed, tuned, models)
    if _hidden(tuned):
        return unnamed("cannot_tell", "only segments to which the device parameters were fitted show an error")
    last = ladder(tuned, models)[-1]
    if last is tuned:
        if noise_only(tuned):
            return Decision("no_gap", tuned, 1.0)
        if accepted(flexible_beside(tuned), tuned, tuned):
            return unnamed("unknown")
        return unnamed("cannot_tell", "the remaining error does not repeat with the motion")
    tied = tied_with(last, compared(_of_size(last, models)))
    last = plainest(tied)
    flexible = flexible_beside(last)
    if not noise_only(last):  # beside a wrong cause it may explain less than alone
        flexible = min(flexible, flexible_beside(tuned), key=lambda each: each.score)
    verdict, reason = _verdict(tuned, last, flexible)
    if verdict in UNNAMED:
        return unnamed(verdict, reason)
    equivalent = tuple(dict.fromkeys(location for each in (last, *tied) for location in each.fit.locations))
    if round(doubt(tied), 6) > NUMBERS.largest_set:
        common = common_part(tied, models)
        if common is None or _verdict(tuned, common, flexible)[0] in UNNAMED:
            reason = f"{different(tied)} causes explain these data equally well"
            return Decision("cannot_tell", tuned, 0.0, *_ranking(last, tied[0], models), equivalent, reason)
        # which other effect acts beside it is not certain
        verdict, last, equivalent = "main_effect", common, common.fit.locations
    rivals = tuple(each for each in rivals_of(last) if not _needless(last, each)) if last is tied[0] else ()
    named = simplest([last, *(each for each in rivals if _verdict(tuned, each, flexible)[0] not in UNNAMED)])
    if named is not last:
        verdict = _verdict(tuned, named, flexible)[0]
    also = tied_with(named, [last, *rivals])
    equivalent = tuple(dict.fromkeys((*(place for each in also for place in each.fit.locations), *equivalent)))
    ranking = _ranking(named, tied[0], models, rivals)
    return Decision(
        verdict, named, max(fractions(tuned, named, flexible)), *ranking, equivalent=equivalent, rivals=rivals
    )


def _needless(one: Evaluation, other: Evaluation) -> bool:
    """Whether one of two models has further parameters at the same sites and is not significantly better by them."""
    return len(without_needless([one, other])) < 2


def _verdict(tuned: Evaluation, model: Evaluation, flexible: Evaluation) -> tuple[Verdict, str]:
    """The verdict that names the effects of a model, or one of UNNAMED and the reason why they are not the cause."""
    explained, share = fractions(tuned, model, flexible), fractions(tuned, model)
    if max(explained) < NUMBERS.most:
        return "unknown", ""
    if max(share) < NUMBERS.substantial:
        location = model.fit.locations[0]
        return "cannot_tell", f"error that does not repeat with the motion exceeds the part that {location} explains"
    fitted = fractions(tuned.on_fitted, model.on_fitted) if model.fitted.size else share
    if min(*explained, *share, *fitted) < NUMBERS.complete:
        return "main_effect", ""
    return "effect" if len(model.fit.effects) == 1 else "several_effects", ""


def _ranking(
    named: Evaluation, best: Evaluation, models: Sequence[Evaluation], rivals: Sequence[Evaluation] = ()
) -> tuple[tuple[tuple[Location, float], ...], tuple[Evaluation, ...]]:
    """Causes with their shares and models; of equal shares first the named ones, then the smaller gap alone.

    best    of the models that are compared, those with as many effects; `named`, unless it is what they have in common
    rivals  further ones, as rich as `named`: none of them is needless beside it
    """
    alone = {each.fit.locations[0]: each.rms for each in models if len(each.fit.effects) == 1}
    shares = shares_of([*compared(_of_size(best, models)), *rivals])
    ranked = sorted(
        ((location, round(share, 9), model) for (location, share), model in zip(*shares, strict=True)),
        key=lambda each: (-each[1], each[0] not in named.fit.locations, alone.get(each[0], np.inf)),
    )
    representatives = tuple(named if location in named.fit.locations else model for location, _, model in ranked)
    return tuple((location, share) for location, share, _ in ranked), representatives


def _of_size(model: Evaluation, models: Sequence[Evaluation]) -> list[Evaluation]:
    """The models with as many effects."""
    return [each for each in models if len(each.fit.effects) == len(model.fit.effects)]


def no_gap(tuned: Evaluation) -> bool:
    """Whether the device leaves only noise with its parameters inside their tolerances.

    The noise is known to a factor, but is the same for every model: where a parameter would go further, a model that
    is significantly better shows that an effect acts.
    """
    return noise_only(tuned) and not _hidden(tuned) and not tuned.fit.at_bound


def _hidden(tuned: Evaluation) -> bool:
    """Whether held-out segments show only noise, but fitted ones an error: a push may lie in those alone.

    The limit over all segments is the factor of `refuted_beside`. It leaves room for one segment that errs by itself,
    such as one with a skipped encoder step.
    """
    return noise_only(tuned) and tuned.on_all.mean_square > NUMBERS.no_gap**2


def noise_only(each: Evaluation) -> bool:
    """Whether the error of a model is that of noise, within the uncertainty of the noise."""
    return each.mean_square <= NUMBERS.no_gap


def fractions(tuned: Evaluation, model: Evaluation, flexible: Evaluation | None = None) -> tuple[float, ...]:
    """Fractions of the explainable error that a model explains, at most 1: of root mean square and typical error.

    An error that does not exceed the noise has no fraction: with rare contacts, a typical segment shows nothing. If
    neither does, the fraction is 1.

    flexible  reaches the explainable error; None: all error above the noise is explainable
    """
    found = []
    for error in ERRORS:
        before, after = error(tuned), max(error(model), 1.0)
        if before > 1.0:
            possible = before - max(1.0, min(error(flexible), error(model)) if flexible else 1.0)
            found.append(1.0 if possible <= 0.0 else min((before - after) / possible, 1.0))
    return tuple(found) or (1.0,)


def accepted(more: Evaluation, fewer: Evaluation, tuned: Evaluation, models: Sequence[Evaluation] = ()) -> bool:
    """Whether a model with more effects is significantly better than one with fewer, by a relevant amount.

    models  all; an event has to explain more than the same model without it, not only more than `fewer`

    What is added beside an event has to show elsewhere: a push has another shape than that of the model, and other
    effects imitate the difference.
    """
    if fewer.shared.any() and event_times(fewer.fit):
        if fewer.shared.all():  # nothing was held out elsewhere
            return False
        more, fewer, tuned = more.apart, fewer.apart, tuned.apart
    if not relevant(more, fewer, tuned):
        return False
    return significantly_worse(fewer, more) or outdone_by(without_events(more, models) or fewer, more)


def without_events(each: Evaluation, models: Sequence[Evaluation]) -> Evaluation | None:
    """The one of `models` that lacks only the events of `each`; None if there is none, or `each` has no event."""
    effects = zip(each.fit.locations, each.fit.effects, strict=True)
    lasting = {location for location, effect in effects if not event_times(replace(each.fit, effects=(effect,)))}
    same = (other for other in models if other is not each and set(other.fit.locations) == lasting)
    return next(same, None)


def relevant(more: Evaluation, fewer: Evaluation, tuned: Evaluation) -> bool:
    """Whether a model with more effects is better by a relevant amount in one of the two errors, significantly or not.

    It has to explain the share `material` of the error, or half of the remaining error above the noise.
    """
    for error in ERRORS:
        gain = error(fewer) - max(error(more), 1.0)
        remaining = not noise_only(fewer) and gain > NUMBERS.remaining * (error(fewer) - 1.0) > 0.0
        if remaining or gain > NUMBERS.material * max(error(tuned) - 1.0, 0.0) > 0.0:
            return True
    return False


def improvable(each: Evaluation, tuned: Evaluation) -> bool:
    """Whether a model could be `relevant` beside this one: if it left only noise."""
    left = [(error(each) - 1.0, NUMBERS.material * max(error(tuned) - 1.0, 0.0)) for error in ERRORS]
    return not noise_only(each) or any(more > least > 0.0 for more, least in left)


def ladder(tuned: Evaluation, models: Sequence[Evaluation]) -> list[Evaluation]:
    """The tuned device, then larger and larger sets of effects, each accepted beside the one before."""
    steps = [tuned]
    for size in sorted({len(each.fit.effects) for each in models} - {0}):
        step = simplest([each for each in models if len(each.fit.effects) == size])
        if accepted(step, steps[-1], tuned, models):
            steps.append(step)
    return steps


def _unnamed(tuned: Evaluation, models: Sequence[Evaluation], verdict: Verdict, reason: str = "") -> Decision:
    """A decision that names nothing: the tuned device, with single causes ranked beside it."""
    singles = without_needless([each for each in models if len(each.fit.effects) == 1])
    shares, representatives = shares_of([tuned, *singles])
    return Decision(verdict, tuned, 0.0, shares, representatives, (), reason)
