"""Evidence from the fitted logs alone: each is judged by fits that did not see it (cross-validation by groups of logs).

Logs held out by the caller say how far a repair carries. Were they also asked which effects to add, and there are
many to choose from, they would no longer be held out. So that runs of the same motion do not vouch for each other, logs
of one group are left out together.

Source: T. Hastie, R. Tibshirani, J. Friedman, The Elements of Statistical Learning (2009), 7.10: what has to be left
out.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from via_core.signals import Array

from via_gap.candidates.fit import Fit, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Indices
from via_gap.selection.bound import flexible
from via_gap.selection.evidence import Evaluation

FOLDS = 3
JUDGED = 4  # of the fits, those that are closest to the logs they were fitted to
REFITS = 4  # rounds from the fit to all logs to that without some


@dataclass(frozen=True, eq=False)
class Folds:
    """A problem and its parts: of each fold the logs kept, those left out, and where their values stand in (R,).

    block  segments of one group, which are resampled together
    """

    whole: ResidualModel
    parts: tuple[tuple[ResidualModel, ResidualModel, Indices], ...]
    block: int

    @staticmethod
    def of(whole: ResidualModel, groups: Sequence[Hashable]) -> Folds | None:
        """Groups are of the views of `whole`. None where there are fewer than two."""
        names = list(dict.fromkeys(groups))
        if len(names) < 2:
            return None
        parts = []
        for fold in range(min(FOLDS, len(names))):
            out = [names.index(group) % FOLDS == fold for group in groups]
            sizes = [np.arange(len(view.chosen)) for view in whole.views]
            kept = whole.part([each[:0] if left else each for each, left in zip(sizes, out, strict=True)])[0]
            rest, where = whole.part([each if left else each[:0] for each, left in zip(sizes, out, strict=True)])
            parts.append((kept, rest, where))
        return Folds(whole, tuple(parts), max(1, round(sum(map(len, sizes)) / len(names))))

    def evaluate(self, fits: Sequence[Fit], scales: Scales | None) -> list[Evaluation]:
        """The closest fits, fitted again without each fold (with `scales` where they have effects), judged on it."""
        order = sorted(fits, key=lambda fit: fit.loss)
        return [self._judged(fit, scales) for fit in order[:JUDGED]]

    def flexible(self, fit: Fit) -> Array:
        """(S,) mean squared whitened error that a flexible model beside a fit leaves of each fold it did not see."""
        residual = np.empty(self.whole.size)
        for kept, rest, where in self.parts:
            model = flexible(kept, fit)
            residual[where] = model.residual(rest, model.functions(rest))
        return self.whole.per_segment(residual)

    def nominal(self, fit: Fit) -> Evaluation:
        """What a fit that was not fitted is worth."""
        residual = self.whole.residual([self.whole.row(fit.effects, fit.deviations)])[0]
        return Evaluation(fit, residual, self.whole.per_segment(residual), self.block, whole=True)

    def _judged(self, fit: Fit, scales: Scales | None) -> Evaluation:
        residual = np.empty(self.whole.size)
        members = [
            (location, list(e.parameters.values())) for location, e in zip(fit.locations, fit.effects, strict=True)
        ]
        for kept, rest, where in self.parts:
            effects, deviations = fit.effects, fit.deviations
            if members and scales is not None:
                again = refine(kept, fit, None, members, scales, rounds=REFITS)
                if again is not None:
                    effects, deviations = again.effects, again.deviations
            else:
                deviations = kept.fit_nuisances(effects, deviations)[0]
            residual[where] = rest.residual([rest.row(effects, deviations)])[0]
        return Evaluation(fit, residual, self.whole.per_segment(residual), self.block, whole=True)
