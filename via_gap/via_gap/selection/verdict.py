"""From held-out scores to an answer: an effect, two, none of these, no gap, or that this log cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.selection.calibration import Calibration
from via_gap.selection.evidence import NOISE, Evaluation, cost, difference, needless, probabilities, significant
from via_gap.selection.gap import Gap

Verdict = Literal["effect", "two_effects", "no_gap", "unknown", "cannot_tell"]
IN_PART = 0.3  # probability of an effect that helps, where even all that help leave much unexplained
DOUBT = 0.3  # what remains of the probability of a cause that is not the explanation


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer.

    chosen        what the repaired simulator gets: device numbers and the effects named
    ranked        single causes with probabilities, best first (of a pair: each as fitted within it)
    equivalent    causes that this log does not separate from the best
    locations     of the effects in `chosen`
    site_weights  how much of the gap each location explains
    """

    verdict: Verdict
    chosen: Evaluation
    ranked: tuple[tuple[Evaluation, float], ...]
    equivalent: tuple[Location, ...]
    locations: tuple[Location, ...]
    site_weights: tuple[tuple[Location, float], ...]

    def with_chosen(self, chosen: Evaluation) -> Decision:
        """The same answer with the effects of `chosen`, its fit led further, as the report tells them."""
        alone = {location: _alone(chosen, i) for i, location in enumerate(chosen.fit.locations)}
        mine = self.chosen.fit.deviations
        ranked = tuple(
            (alone[each.fit.locations[-1]] if each.fit.deviations is mine else each, probability)
            for each, probability in self.ranked
        )
        return replace(self, chosen=chosen, ranked=ranked)


def decide(
    tuned: Evaluation, causes: Sequence[Evaluation], sets: Sequence[Evaluation], frozen: Calibration
) -> Decision:
    """The verdict from single causes and sets of two or more effects, both best first."""
    if tuned.mean_square <= frozen.no_gap or not causes:
        return Decision("no_gap" if tuned.mean_square <= frozen.no_gap else "unknown", tuned, (), (), (), ())
    kept = _without_needless(causes, frozen)
    best = kept[0]
    weights = probabilities(kept, frozen)
    tied = [each for each in kept if _ties(each, best, frozen)]
    equivalent = tuple(each.fit.locations[-1] for each in tied)
    pair = _accepted(sets, best, tuned, frozen)
    if pair is not None and _explained(tuned, pair, frozen):
        members = tuple((_alone(pair, i), 0.95) for i in range(len(pair.fit.effects)))
        shares = _shares(pair, kept, tuned)
        locations = pair.fit.locations
        equivalent = _alike(pair, sets, frozen)
        return Decision("two_effects", pair, members, equivalent, locations, tuple(zip(locations, shares, strict=True)))
    ranked = tuple(sorted(zip(kept, map(float, weights), strict=True), key=lambda each: -each[1]))
    site_weights = tuple((each.fit.locations[-1], weight) for each, weight in ranked)
    gain = 1.0 - (best.mean_square - 1.0) / max(tuned.mean_square - 1.0, 1e-9)
    if not _explained(tuned, best, frozen):
        if gain < frozen.no_gap_gain or not significant(tuned, best, frozen):
            chosen = tuned
        else:
            chosen = best
        doubt = _doubted(ranked)
        if pair is not None and (pair.free or len(pair.fit.effects) > 2):
            # What is known of the cause, short of all of it, is worth repairing.
            chosen, equivalent = pair, _alike(pair, sets, frozen)
            others = tuple((each, share) for each, share in doubt if each.fit.locations[-1] not in pair.fit.locations)
            doubt = (*((_alone(pair, i), IN_PART) for i in range(len(pair.fit.effects))), *others)
        locations = chosen.fit.locations
        return Decision("unknown", chosen, doubt, equivalent, locations, site_weights)
    if len(tied) > frozen.largest_set:
        return Decision("cannot_tell", best, ranked, equivalent, best.fit.locations, site_weights)
    return Decision("effect", best, ranked, equivalent, best.fit.locations, site_weights)


def against_ceiling(decision: Decision, gap: Gap, frozen: Calibration) -> Decision:
    """The answer, or none of these where a flexible model beside it closes what the cause itself would have closed.

    Only what the device's own numbers leave counts: of a gap that they nearly close, every effect closes the same.
    Three effects or more, nearly a flexible model themselves, have to come as near as it does.
    """
    if decision.verdict not in ("effect", "two_effects") or gap.after <= frozen.near * gap.ceiling:
        return decision
    closes = gap.tuned - gap.after >= frozen.explained_nearly * (gap.tuned - gap.ceiling)
    if closes and len(decision.locations) <= 2:
        return decision
    return replace(decision, verdict="unknown", ranked=_doubted(decision.ranked))


def _doubted(ranked: Sequence[tuple[Evaluation, float]]) -> tuple[tuple[Evaluation, float], ...]:
    return tuple((each, DOUBT * weight) for each, weight in ranked)


def _alike(chosen: Evaluation, sets: Sequence[Evaluation], frozen: Calibration) -> tuple[Location, ...]:
    """Places of a set of effects and of those as large that these data do not tell from it."""
    locations = chosen.fit.locations
    alike = [each for each in sets if len(each.fit.locations) == len(locations) and _ties(each, chosen, frozen)]
    return tuple(dict.fromkeys((*locations, *(location for each in alike for location in each.fit.locations))))


def _without_needless(causes: Sequence[Evaluation], frozen: Calibration) -> list[Evaluation]:
    """Causes but for those that a simpler one at the same place does as well."""
    kept = [c for c in causes if not any(needless(c, other, frozen) for other in causes if other is not c)]
    return sorted(kept, key=lambda each: cost(each, frozen))


def _ties(each: Evaluation, best: Evaluation, frozen: Calibration) -> bool:
    gap, deviation = difference(each, best)
    return gap <= max(frozen.margin, 2.0 * deviation if gap < 0.2 or each.free else 0.0)


def rms(each: Evaluation) -> float:
    """Root mean square whitened error beyond the noise."""
    return float(np.sqrt(max(each.mean_square - 1.0, 0.0)))


def _explained(tuned: Evaluation, after: Evaluation, frozen: Calibration) -> bool:
    """Whether next to nothing is left, or enough of what the tuned device leaves beyond the noise.

    Where nearly every segment is at the noise again, a few may stick out more: those in which something begins or ends,
    which no other segment could tell to the millisecond. Where even the typical segment sticks out, something like the
    cause acts and not the cause itself: a share of the squared error is soon closed by what is only alike.
    """
    closed = 1.0 - rms(after) / max(rms(tuned), 1e-9)
    everywhere = 1.0 - (after.score - NOISE) / max(tuned.score - NOISE, 1e-9)
    exact = max(frozen.typical, frozen.slight * tuned.mean_square)
    sticks_out = not after.free and float(np.median(after.segments)) > exact
    if sticks_out and max(closed, everywhere) < frozen.explained_nearly:
        return False
    if after.mean_square <= frozen.explained:
        return True
    return closed >= frozen.explained_share or (
        closed >= frozen.explained_most and everywhere >= frozen.explained_nearly
    )


def helps(larger: Evaluation, smaller: Evaluation, single: Evaluation, frozen: Calibration) -> bool:
    """Whether an effect more closes enough of what the best single cause left, and not by chance.

    Of what is next to nothing it has to close a good part: every fit leaves a little that something else would take.
    """
    share = (rms(smaller) - rms(larger)) / max(rms(single), 1e-9)
    least = frozen.second_gain if smaller.mean_square > frozen.explained else frozen.last_gain
    return share >= least and significant(smaller, larger, frozen)


def _accepted(
    sets: Sequence[Evaluation], best: Evaluation, tuned: Evaluation, frozen: Calibration
) -> Evaluation | None:
    """The set of effects that leaves least, or the simplest as good as it, if it helps beyond the best single cause."""
    if not sets:
        return None
    least = min(sets, key=rms)
    alike = [
        each for each in sets if len(each.fit.locations) <= len(least.fit.locations) and _ties(each, least, frozen)
    ]
    least = min((least, *alike), key=lambda each: cost(each, frozen))
    return least if helps(least, best, best, frozen) else None


def _alone(whole: Evaluation, member: int) -> Evaluation:
    """One effect of a set with the set's evidence."""
    fit = whole.fit
    first = sum(len(effect.parameters) for effect in fit.effects[:member])
    sd = fit.sd[first : first + len(fit.effects[member].parameters)]
    return Evaluation(
        Fit((fit.effects[member],), fit.deviations, fit.loss, fit.residual, sd),
        whole.residual,
        whole.segments,
        whole.block,
        whole.free,
    )


def _shares(whole: Evaluation, causes: Sequence[Evaluation], tuned: Evaluation) -> list[float]:
    """How much of the gap each member of a set closes alone, as shares of all; none is next to nothing."""
    alone = {each.fit.locations[-1]: max(rms(tuned) - rms(each), 0.0) for each in causes}
    sizes = [alone.get(location, 0.0) for location in whole.fit.locations]
    total = sum(sizes)
    shares = [max(size / total, 0.1) if total > 0.0 else 1.0 for size in sizes]
    return [share / sum(shares) for share in shares]
