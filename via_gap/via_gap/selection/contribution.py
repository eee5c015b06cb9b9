"""How much each named effect explains beside the others: the error of the repair without it.

Each effect of a repair is removed in turn, and the other effects and the device parameters are fitted again. The main
effect is the one without which most error is left. The probability of an effect does not show this: a small dry
friction can be certain, while the delay that explains most is tied with a lag. If the final fit is as good without one
of its effects, the model is not the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_gap.candidates.location import Location
from via_gap.candidates.refinement import FINISHING, refine
from via_gap.selection.comparison import ModelComparison
from via_gap.selection.evidence import Evaluation
from via_gap.selection.verdict import Decision, relevant


def reduced(decision: Decision, comparison: ModelComparison) -> list[Evaluation]:
    """The model of the repair without each of its effects, if it has several."""
    named = decision.named
    return [_without(out, decision.chosen, comparison) for out in named] if len(named) > 1 else []


def confirmed(decision: Decision, fewer: Sequence[Evaluation], tuned: Evaluation) -> bool:
    """Whether the final fit still needs each effect: without it, the model is worse by a relevant amount."""
    return all(relevant(decision.chosen, each, tuned) for each in fewer)


def by_contribution(decision: Decision, fewer: Sequence[Evaluation]) -> Decision:
    """The same decision with the main effect of the repair first, and the mean squared error without each effect."""
    if not fewer:
        return decision
    chosen, left = decision.chosen, [each.mean_square for each in fewer]
    order = sorted(range(len(left)), key=lambda number: -left[number])
    ordered = replace(chosen, fit=chosen.fit.reordered(order))
    models = tuple(ordered if each is chosen else each for each in decision.models)
    without = tuple(left[number] for number in order)
    return replace(decision, chosen=ordered, models=models, without=without)


def _without(out: Location, chosen: Evaluation, comparison: ModelComparison) -> Evaluation:
    """The model without one of its effects: that of the search, if it was evaluated there."""
    rest = [member for member in chosen.fit.members if member[0] != out]
    kind = {location for location, _ in rest}
    known = (each for each in comparison.models if set(each.fit.locations) == kind)
    if (found := next(known, None)) is not None:
        return found
    experiment, scales = comparison.experiment, comparison.candidates.scales
    fit = refine(experiment.fitted, chosen.fit, rest, scales, FINISHING)
    return experiment.tuned if fit is None else experiment.compare([fit], scales)[0]
