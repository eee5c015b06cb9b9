"""Does a repair hold in all motion? Each half of the motion is compared with a fit to the other half.

Held-out blocks contain the same kinds of motion as fitted ones. A wrong effect that resembles the true one can explain
them, with parameters that balance slow and fast, small and large motion. Fitted to slow motion alone, it fails on fast
motion. The right effect has the same parameters everywhere, also beside small effects that are not in the catalogue. An
effect that explains hardly anything in the other half is not named.

Halves are those below and above the median of a quantity of the segments. The loss of the other half counts a tenth in
the fit, so that parameters keep their values where one half alone does not show them: a wall, a limit, a beginning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from via_core.signals import Array

from via_gap.candidates.fit import Fit
from via_gap.candidates.refinement import Budget, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.quantities import quantities
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.verdict import fractions

OTHER = 0.1  # share with which the loss of the other half counts
REFITS = Budget(rounds=4)  # from the fit to all segments to the fit to half of them


@dataclass(frozen=True, eq=False)
class Transfer:
    """What the tuned device leaves, and what a model leaves in the half of the motion to which it was not fitted.

    left    by the quantity that divides the motion; empty for whole runs, which are not divided
    halves  fits to the lower and to the upper half, likewise
    """

    before: Evaluation
    left: dict[str, Evaluation]
    halves: dict[str, tuple[Fit, Fit]]

    @property
    def shares(self) -> dict[str, float]:
        """Squared error that is left, relative to the tuned device."""
        before = max(self.before.mean_square, 1e-12)
        return {name: each.mean_square / before for name, each in self.left.items()}

    @property
    def worst(self) -> tuple[Fit, ...]:
        """The fits to the halves between which the model transfers worst; empty if the motion is not divided."""
        return self.halves[max(self.left, key=lambda each: self.left[each].mean_square)] if self.left else ()

    @property
    def refuted_by(self) -> str:
        """The quantity whose halves refute the model; empty if there is none.

        Fitted to one half, it explains less of the error above the noise in the other than a named cause has to.
        """
        explained = {name: max(fractions(self.before, each)) for name, each in self.left.items()}
        worst = min(explained, key=lambda name: explained[name], default="")
        return worst if worst and explained[worst] < NUMBERS.substantial else ""


def transferred(chosen: Evaluation, experiment: Experiment, scales: Scales) -> Transfer:
    """What a model leaves in each half of the motion when fitted to the other."""
    tuned = experiment.tuned
    problem = experiment.everywhere()

    def errors(fit: Fit) -> Array:
        return problem.squares(fit.effects, fit.offsets)

    def evaluation(fit: Fit, squares: Array) -> Evaluation:
        return Evaluation(fit, squares, squares, tuned.block)

    before = evaluation(tuned.fit, errors(tuned.fit))
    found: dict[str, Evaluation] = {}
    halves: dict[str, tuple[Fit, Fit]] = {}
    if experiment.folds is not None or not chosen.fit.effects:
        return Transfer(before, found, halves)
    whole = refine(problem, chosen.fit, chosen.fit.members, scales, REFITS) or chosen.fit
    for name, values in quantities(problem.views).items():
        low = values < np.median(values)
        if not np.any(low):  # most segments are alike, such as those of a joint that rests
            continue
        fits = []
        for half in (low, ~low):
            weighted = replace(problem, importance=np.where(half, 1.0, OTHER))
            fits.append(refine(weighted, whole, whole.members, scales, REFITS) or whole)
        halves[name] = (fits[0], fits[1])
        found[name] = evaluation(whole, np.where(low, errors(fits[1]), errors(fits[0])))
    return Transfer(before, found, halves)
