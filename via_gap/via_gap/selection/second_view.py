"""The other view of the data, where simulated segments name no cause.

A torque that no model predicts (a push, a cable, a hand) adds up in a simulated segment, and hides whatever acts beside
it. In inverse dynamics it stays in its window and in the equation of its axis: a link that is pushed at random leaves
the equation of its spring as it is. So if simulation names nothing, models are compared by inverse dynamics.

That answer stands if simulation agrees:

- the repair lowers the error of simulated segments as well, and so does each of its effects beside the others: a push
  that dominates both views says nothing about what is named beside it;
- if a flexible torque explains the simulated error that no effect explains (`unknown`), only one effect that explains
  everything refutes that: a main effect leaves it as unknown as before, and of several effects the flexible torque is
  the simpler explanation. So no further ones are searched.
"""

from __future__ import annotations

from dataclasses import replace

from via_gap.candidates.refinement import fit_on
from via_gap.selection.experiment import Experiment
from via_gap.selection.search import MOST
from via_gap.selection.verdict import UNNAMED, Decision


def second_view(experiment: Experiment, decision: Decision) -> Experiment | None:
    """The experiment by inverse dynamics, if simulation names no cause; None if it does, or there is no equation."""
    return experiment.compared_by_equations() if decision.verdict in UNNAMED else None


def most_effects(decision: Decision) -> int:
    """Most effects of an answer by inverse dynamics beside the decision by simulation."""
    return 1 if decision.verdict == "unknown" else MOST


def upheld(experiment: Experiment, first: Decision, other: Decision) -> bool:
    """Whether simulation, which led to the decision `first`, supports what `other`, by inverse dynamics, names."""
    if not other.named or (first.verdict == "unknown" and other.verdict != "effect"):
        return False
    fit = other.chosen.fit
    fewer = [replace(fit, effects=fit.effects[:i] + fit.effects[i + 1 :]) for i in range(len(fit.effects))]
    repaired, *without = experiment.evaluate([fit_on(experiment.fitted, each) for each in (fit, *fewer)])
    return all(repaired.on_all.score < each.on_all.score for each in (experiment.tuned, *without))
