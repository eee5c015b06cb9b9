"""Cross-validation over groups of fitted logs: each log is evaluated by fits to logs of other groups.

Logs that the caller holds out serve to measure the gap of the repair, so they must not also be used to choose among
many effects. Logs of one group, such as runs of the same motion, are left out together.

Source: T. Hastie, R. Tibshirani, J. Friedman, The Elements of Statistical Learning (2009), section 7.10.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.signals import Array, Indices

from via_gap.candidates.fit import Fit
from via_gap.candidates.refinement import Budget, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.bound import flexible
from via_gap.selection.evidence import Evaluation

FOLDS = 3
EVALUATED = 4  # fits with the least loss that are evaluated
REFITS = Budget(rounds=4)  # from the fit to all logs to the fit without some


@dataclass(frozen=True, eq=False)
class Folds:
    """A residual model and its folds.

    parts  of each fold the model of the logs kept, the model of those left out, and the indices of its values in (R,)
    block  number of segments of one group, which are resampled together
    """

    whole: ResidualModel
    parts: tuple[tuple[ResidualModel, ResidualModel, Indices], ...]
    block: int

    @staticmethod
    def of(whole: ResidualModel, groups: Sequence[Hashable]) -> Folds | None:
        """groups: one for each view of `whole`. None if there are fewer than two."""
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
        """The fits with the least loss, each fitted again without a fold and evaluated on it; effects need `scales`."""
        order = sorted(fits, key=lambda fit: fit.loss)
        return [self._evaluated(fit, scales) for fit in order[:EVALUATED]]

    def flexible(self, fit: Fit) -> Array:
        """(S,) mean squared whitened error of flexible models beside a fit, each fitted without the segment's fold."""
        residual = np.empty(self.whole.size)
        for kept, rest, where in self.parts:
            model = flexible(kept, fit)
            residual[where] = model.residual(rest, model.functions(rest))
        return self.whole.per_segment(residual)

    def nominal(self, fit: Fit) -> Evaluation:
        """Evaluation of a fit as it is."""
        residual = self.whole.residual([self.whole.row(fit.effects, fit.offsets)])[0]
        return Evaluation(fit, residual, self.whole.per_segment(residual), self.block, whole=True)

    def _evaluated(self, fit: Fit, scales: Scales | None) -> Evaluation:
        residual = np.empty(self.whole.size)
        members = fit.members
        for kept, rest, where in self.parts:
            if members and scales is not None:
                again = refine(kept, fit, members, scales, REFITS) or fit
            else:
                again = replace(fit, offsets=kept.fit_nuisances(fit.effects, fit.offsets)[0])
            residual[where] = rest.residual([rest.row(again.effects, again.offsets)])[0]
        return Evaluation(fit, residual, self.whole.per_segment(residual), self.block, whole=True)
