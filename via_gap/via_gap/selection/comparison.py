"""The models that are compared: searched, and only those that may be named.

What commands did between the samples of a log is not known: where lines explain the motion better than steps, the
comparison is made again with them (between.py).

What begins or ends at one time of a run is seen in the segments it lies in alone. Where the best model has such times,
they are sought in all segments, and the comparison is made again with those segments fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.candidates.fit import FINISHING, events, members_of, refine
from via_gap.selection.between import between_samples
from via_gap.selection.evidence import Evaluation, clearly_worse, vetoed
from via_gap.selection.experiment import Experiment
from via_gap.selection.plausibility import doubt
from via_gap.selection.search import Progress, Search
from via_gap.selection.verdict import noise_only

Models = list[Evaluation]


def compared(
    experiment: Experiment, candidates: CandidateSet, progress: Progress
) -> tuple[Experiment, CandidateSet, Models]:
    """The experiment that was compared on, its candidates, and every model evaluated that may be named."""
    lined = None if noise_only(experiment.tuned) else between_samples(experiment, experiment.tuned, candidates.scales)
    if lined is not None:
        experiment, candidates = lined, _candidates(lined)
    if noise_only(experiment.tuned):
        return experiment, candidates, []
    found: list[Experiment] = []

    def lines_matter(best: Evaluation) -> bool:
        other = between_samples(experiment, best, candidates.scales)
        found.extend([other] if other is not None else [])
        return bool(found)

    models = _searched(experiment, candidates, progress, lines_matter)
    if found:  # once: what is a little better beside one effect is a little worse beside another
        experiment, candidates = found[0], _candidates(found[0])
        models = [] if noise_only(experiment.tuned) else _searched(experiment, candidates, progress, _never)
    best = min(models, key=lambda each: each.score, default=experiment.tuned)  # clear only once its times are known
    if experiment.folds is not None or not events(best.fit):
        return experiment, candidates, models
    everywhere = experiment.everywhere()
    sought = refine(everywhere, best.fit, None, members_of(best.fit), candidates.scales, rounds=FINISHING)
    times = events(sought or best.fit)
    scales = candidates.scales
    if len(times) == 2:  # which the segments that are fitted alone might not lead to
        scales = replace(scales, busy=((times[0], times[1]), *scales.busy))
    experiment, candidates = experiment.around(times), replace(candidates, scales=scales)
    return experiment, candidates, _searched(experiment, candidates, progress, _never)


def _never(_best: Evaluation) -> bool:
    return False


def _candidates(experiment: Experiment) -> CandidateSet:
    return CandidateSet.of(experiment.segments, experiment.train, experiment.tuned.fit, experiment.fitted)


def _searched(
    experiment: Experiment, candidates: CandidateSet, progress: Progress, enough: Callable[[Evaluation], bool]
) -> Models:
    evaluate = experiment.evaluate
    folds = experiment.folds
    if folds is not None:
        evaluate = lambda fits: folds.evaluate(fits, candidates.scales)  # noqa: E731
    supported = _supported(experiment, candidates)
    search = Search.of(experiment.fitted, evaluate, supported, experiment.tuned, candidates)
    return search.run(progress, enough)


def _supported(experiment: Experiment, candidates: CandidateSet) -> Callable[[Evaluation], bool]:
    """Whether a model may be named: plausible, clearly better than no model, and not contradicted by the other view."""
    contradicts = experiment.contradicts

    def supported(each: Evaluation) -> bool:
        if doubt(each.fit, candidates.scales) or not clearly_worse(experiment.baseline, each):
            return False
        return not (contradicts and vetoed(each, experiment.tuned))

    return supported
