"""Rivals of the named model: one of its effects replaced by another one, beside the same other effects.

The search adds effects to the best model so far, and exchanges them on a subset of the segments. Of two similar first
effects, often only one was therefore tried with a second effect, and the other would lose for lack of it. A fair
comparison needs both with the same other effects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from via_gap.candidates.fit import Fit
from via_gap.candidates.refinement import FINISHING, refine_all
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.evidence import Evaluation
from via_gap.selection.plausibility import absurd

MOST = 2  # that replace each effect


def rivals(
    whole: ResidualModel,
    models: Sequence[Evaluation],
    scales: Scales,
    evaluated: Callable[[Sequence[Fit]], list[Evaluation]],
) -> Callable[[Evaluation], list[Evaluation]]:
    """A function that gives the rivals of a model, fitted to all segments of `whole`.

    models     of the search. Each effect of the model is replaced by those that were best alone and that the search did
               not try beside its other effects
    evaluated  gives evaluations of those fits that may be named

    A model of one effect has no rivals. Neither have whole runs, where each evaluation needs one fit per fold.
    """
    alone = sorted((each for each in models if len(each.fit.effects) == 1), key=lambda each: each.score)
    tried = {frozenset(each.fit.locations) for each in models}

    def of(model: Evaluation) -> list[Evaluation]:
        if model.whole or len(model.fit.effects) < 2:
            return []
        fits = []
        for out in model.fit.locations:
            rest = [each for each in model.fit.members if each[0] != out]
            there = {location for location, _ in rest}
            others = [each.fit for each in alone if not any(map(each.fit.locations[0].overlaps, there))]
            new = [each.members for each in others if there | {*each.locations} not in tried]
            starts = [(model.fit, [*rest, *each]) for each in new[:MOST]]
            swapped = refine_all(whole, starts, scales, FINISHING)
            fits += [each for each in swapped if each is not None and not absurd(each, scales)]
        return evaluated(fits)

    return of
