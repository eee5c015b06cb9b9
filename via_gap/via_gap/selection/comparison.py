"""Search for models, and for what the logs do not contain: commands between samples, and times of single events.

Commands between the samples of a log are not known. Linear interpolation (between.py) is compared with a zero-order
hold, beside the tuned device and beside the best model of the search. If it explains the motion better, the search is
repeated with interpolated commands. It is not tried beside the models in between, where the unknown times of jumps
would absorb a part of a missing delay.

Held-out blocks mislead if a motion repeats with them: a wall that only fitted blocks touch improves no held-out block.
If a model leaves an error only in fitted or only in held-out segments, the search is repeated with single segments that
alternate.

An effect that begins or ends at one time of a run is visible only in the segments around it. If the best model has such
times, they are fitted to all segments, and the search is repeated with those segments on both sides. The best of all
segments counts: fitted to a part of a push, a model is wrong about the rest, which may be held out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.candidates.fit import Fit, event_times
from via_gap.candidates.refinement import FINISHING, refine
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.between import with_interpolation
from via_gap.selection.evidence import Evaluation, predicts, vetoed
from via_gap.selection.experiment import Experiment
from via_gap.selection.plausibility import doubt
from via_gap.selection.search import MOST, Progress, Search
from via_gap.selection.verdict import no_gap, noise_only, relevant, without_events


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """The experiment that was used last, its candidates, and every model evaluated on it that may be named."""

    experiment: Experiment
    candidates: CandidateSet
    models: Sequence[Evaluation]

    def evaluated(self, fits: Sequence[Fit]) -> list[Evaluation]:
        """Evaluations of those fits that may be named."""
        supported = _supported(self.experiment, self.candidates)
        return [each for each in self.experiment.evaluate(fits) if supported(each)]


def candidates_of(experiment: Experiment) -> CandidateSet:
    """Candidates of an experiment, relative to its fitted device parameters."""
    return CandidateSet.of(experiment.segments, experiment.train, experiment.tuned.fit, experiment.fitted)


def compare_models(
    experiment: Experiment, candidates: CandidateSet, progress: Progress, most: int = MOST
) -> ModelComparison:
    """Models of at most `most` effects that explain the gap, compared on held-out segments.

    There are no models if the tuned device leaves only noise.
    """
    if not noise_only(experiment.tuned):
        lines = with_interpolation(experiment, experiment.tuned, candidates.scales)
        if lines is not None:
            experiment, candidates = lines, candidates_of(lines)
    if no_gap(experiment.tuned):
        return ModelComparison(experiment, candidates, [])
    models = _searched(experiment, candidates, progress, most)
    best = min(models, key=lambda each: each.score, default=experiment.tuned)
    lines = with_interpolation(experiment, best, candidates.scales) if models else None
    if lines is not None:  # decided once: interpolation that helps one effect a little may harm another
        experiment, candidates = lines, candidates_of(lines)
        models = [] if no_gap(experiment.tuned) else _searched(experiment, candidates, progress, most)
    if experiment.lopsided(models):
        experiment = experiment.around(())
        candidates = candidates_of(experiment)
        models = _searched(experiment, candidates, progress, most)
    best = min(models, key=lambda each: each.on_all.score, default=experiment.tuned)
    if experiment.folds is not None or not event_times(best.fit):
        return ModelComparison(experiment, candidates, models)
    everywhere = experiment.everywhere()
    sought = refine(everywhere, best.fit, best.fit.members, candidates.scales, FINISHING) or best.fit
    plain, tuned = (without_events(best, models) or experiment.tuned).fit, experiment.tuned.fit
    if not relevant(*(_everywhere(everywhere, fit) for fit in (sought, plain, tuned))):
        return ModelComparison(experiment, candidates, models)
    times = event_times(sought)
    scales = candidates.scales
    if len(times) == 2:  # an initial value that the fitted segments alone might not provide
        scales = replace(scales, busy=((times[0], times[1]), *scales.busy))
    experiment, candidates = experiment.around(times), replace(candidates, scales=scales)
    return ModelComparison(experiment, candidates, _searched(experiment, candidates, progress, most))


def _everywhere(everywhere: ResidualModel, fit: Fit) -> Evaluation:
    """The evaluation of a fit on all segments."""
    squares = everywhere.squares(fit.effects, fit.offsets)
    return Evaluation(fit, squares, squares, 1)


def _searched(experiment: Experiment, candidates: CandidateSet, progress: Progress, most: int) -> list[Evaluation]:
    """Every model of one search."""
    compare = partial(experiment.compare, scales=candidates.scales)
    search = Search.of(experiment.fitted, compare, _supported(experiment, candidates), experiment.tuned, candidates)
    return search.run(progress, most)


def _supported(experiment: Experiment, candidates: CandidateSet) -> Callable[[Evaluation], bool]:
    """Test whether a model may be named: plausible, significantly better than no model, not vetoed."""
    may_veto = experiment.may_veto

    def supported(each: Evaluation) -> bool:
        if doubt(each.fit, candidates.scales) or not predicts(each, experiment.baseline):
            return False
        return not (may_veto and vetoed(each, experiment.tuned))

    return supported
