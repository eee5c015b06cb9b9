"""From held-out scores to an answer: an effect, two, none of these, no gap, or that this log cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from via_gap.calibration import Calibration
from via_gap.evidence import Judged, difference, needless, probabilities
from via_gap.places import Place
from via_gap.report import Verdict


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer.

    chosen        what the repaired simulator gets: device numbers and the effects named
    ranked        single causes with probabilities, best first (of a pair: each as fitted within it)
    equivalent    causes that this log does not separate from the best
    places        of the effects in `chosen`
    site_weights  how much of the gap each place explains
    """

    verdict: Verdict
    chosen: Judged
    ranked: tuple[tuple[Judged, float], ...]
    equivalent: tuple[Place, ...]
    places: tuple[Place, ...]
    site_weights: tuple[tuple[Place, float], ...]


def decide(
    tuned: Judged, causes: Sequence[Judged], pairs: Sequence[Judged], ceiling: Judged, frozen: Calibration
) -> Decision:
    """The verdict from single causes and pairs, both best first."""
    if tuned.mean_square <= frozen.no_gap or not causes:
        return Decision("no_gap" if tuned.mean_square <= frozen.no_gap else "unknown", tuned, (), (), (), ())
    kept = _without_needless(causes, frozen)
    best = kept[0]
    weights = probabilities(kept, frozen)
    tied = [each for each in kept if _ties(each, best, frozen)]
    equivalent = tuple(each.fit.places[-1] for each in tied)
    pair = _accepted(pairs, kept, tuned, frozen)
    after = pair or best
    explained = _explained(tuned, after, ceiling, frozen)
    if pair is not None and explained:
        singles = [_alone(pair, i) for i in range(2)]
        members = tuple((each, 0.95) for each in singles)
        shares = _pair_shares(pair, kept, tuned)
        places = pair.fit.places
        return Decision("two_effects", pair, members, places, places, tuple(zip(places, shares, strict=True)))
    ranked = tuple(sorted(zip(kept, map(float, weights), strict=True), key=lambda each: -each[1]))
    site_weights = tuple((each.fit.places[-1], weight) for each, weight in ranked)
    gain = 1.0 - (best.mean_square - 1.0) / max(tuned.mean_square - 1.0, 1e-9)
    if not _explained(tuned, best, ceiling, frozen):
        helps = difference(tuned, best)
        if gain < frozen.no_gap_gain or helps[0] < frozen.significance * helps[1]:
            chosen = tuned
        else:
            chosen = best
        doubt = tuple((each, 0.3 * weight) for each, weight in ranked)
        places = chosen.fit.places
        return Decision("unknown", chosen, doubt, equivalent, places, site_weights)
    if len(tied) > frozen.largest_set:
        return Decision("cannot_tell", best, ranked, equivalent, best.fit.places, site_weights)
    return Decision("effect", best, ranked, equivalent, best.fit.places, site_weights)


def _without_needless(causes: Sequence[Judged], frozen: Calibration) -> list[Judged]:
    """Causes but for those that a simpler one at the same place does as well."""
    kept = [c for c in causes if not any(needless(c, other, frozen) for other in causes if other is not c)]
    return sorted(kept, key=lambda each: each.score)


def _ties(each: Judged, best: Judged, frozen: Calibration) -> bool:
    gap, deviation = difference(each, best)
    return gap <= max(frozen.margin, 2.0 * deviation if gap < 0.2 else 0.0)


def rms(each: Judged) -> float:
    """Root mean square whitened error beyond the noise."""
    return float(np.sqrt(max(each.mean_square - 1.0, 0.0)))


def _explained(tuned: Judged, after: Judged, ceiling: Judged, frozen: Calibration) -> bool:
    if after.mean_square <= frozen.explained:
        return True
    best = min(rms(after), rms(ceiling))
    possible = rms(tuned) - best
    return possible > 0.0 and (rms(tuned) - rms(after)) / possible >= frozen.explained_share


def _accepted(pairs: Sequence[Judged], causes: Sequence[Judged], tuned: Judged, frozen: Calibration) -> Judged | None:
    """The best pair, if it closes enough more than any single cause and neither of its members is idle."""
    if not pairs:
        return None
    best = pairs[0]
    single = min(causes, key=rms)
    gain, deviation = difference(single, best)
    closes = (rms(single) - rms(best)) / max(rms(tuned), 1e-9)
    return best if closes >= frozen.second_gain and gain >= frozen.significance * deviation else None


def _alone(pair: Judged, member: int) -> Judged:
    """One effect of a pair with the pair's evidence."""
    fit = pair.fit
    first = len(fit.effects[0].parameters)
    spread = fit.spread[:first] if member == 0 else fit.spread[first:]
    single = type(fit)((fit.effects[member],), fit.deviations, fit.loss, fit.residual, spread)
    return Judged(single, pair.residual, pair.shots)


def _pair_shares(pair: Judged, causes: Sequence[Judged], tuned: Judged) -> tuple[float, float]:
    """How much of the gap each member of a pair closes alone, as shares of both."""
    alone = {each.fit.places[-1]: max(rms(tuned) - rms(each), 0.0) for each in causes}
    first, second = (alone.get(place, 0.0) for place in pair.fit.places)
    total = first + second
    return (0.5, 0.5) if total <= 0.0 else (max(first / total, 0.1), max(second / total, 0.1))
