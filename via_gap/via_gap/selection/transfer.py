"""Does a repair hold in all motion? Each half of the motion is compared with a fit to the other half.

Held-out blocks contain the same kinds of motion as fitted ones. A wrong effect that resembles the true one explains
them with parameters that balance slow and fast, small and large motion; fitted to slow motion alone, it fails on fast
motion. The right effect has the same parameters everywhere, also beside small effects that are not in the catalogue.

Halves are those below and above the median of a quantity of the segments. A tenth of the other half is fitted as well,
so that parameters keep their values where one half alone does not show them (a wall, a limit); and so are segments in
which an effect begins or ends.
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Mask

from via_gap.candidates.fit import event_times
from via_gap.candidates.refinement import Budget, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.quantities import quantities
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment

EVERY = 10  # of the other half, one segment of so many is fitted as well
REFITS = Budget(rounds=4)  # from the fit to all segments to the fit to half of them


def transferred(chosen: Evaluation, experiment: Experiment, scales: Scales) -> dict[str, float]:
    """Squared error that a model leaves in each half when fitted to the other, relative to the tuned device.

    By the quantity that divides the halves. Whole runs are not divided: empty.
    """
    if experiment.folds is not None or not chosen.fit.effects:
        return {}
    problem = experiment.everywhere()
    tuned = experiment.tuned.fit
    before = problem.per_segment(problem.residual([problem.row(tuned.effects, tuned.offsets)])[0])
    whole = refine(problem, chosen.fit, chosen.fit.members, scales, REFITS) or chosen.fit
    times = np.array([event_times(whole)] * 2)
    events = np.concatenate(
        [np.isin(np.arange(len(v.chosen)), at) for v, at in zip(problem.views, problem.touched(times), strict=True)]
    )
    found = {}
    for name, values in quantities(problem.views).items():
        low = values < np.median(values)
        if not np.any(low):  # most segments are alike, such as those of a joint that rests
            continue
        left = np.full(len(before), np.nan)
        for half in (low, ~low):
            kept = half | events | _every(~half)
            fit = refine(_part(problem, kept), whole, whole.members, scales, REFITS) or whole
            rest = _part(problem, ~half)
            left[~half] = rest.per_segment(rest.residual([rest.row(fit.effects, fit.offsets)])[0])
        found[name] = float(np.mean(left) / max(np.mean(before), 1e-12))
    return found


def _every(half: Mask) -> Mask:
    """Every tenth of some segments."""
    return np.asarray(half & (np.cumsum(half) % EVERY == 0))


def _part(problem: ResidualModel, kept: Mask) -> ResidualModel:
    """The model of some segments; kept: (S,) over all views."""
    ends = np.cumsum([len(view.chosen) for view in problem.views])[:-1]
    return problem.part([np.flatnonzero(each) for each in np.split(kept, ends)])[0]
