"""The least error that can be reached beside the effects of a model: what a flexible torque there leaves, held out."""

from __future__ import annotations

from dataclasses import replace

from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.selection.bound import Flexible, flexible
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment


class Achievable:
    """The flexible model beside the effects of a fit, made once for the decision and for the gap."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._models: dict[tuple[Location, ...], Flexible] = {}

    def beside(self, each: Evaluation) -> Evaluation:
        """Evaluation of the flexible model beside the effects of an evaluated fit, on the same held-out segments."""
        experiment = self._experiment
        if experiment.by == "inverse dynamics":
            segments = experiment.bound_of_equations(each.fit)
        elif experiment.folds is not None:
            segments = experiment.folds.flexible(each.fit)
        else:
            model, judged = self.model(each.fit), experiment.judged
            segments = judged.per_segment(model.residual(judged, model.functions(judged)))
        return replace(each, segments=segments)

    def model(self, fit: Fit) -> Flexible:
        """Beside the effects at the locations of `fit`, as they were fitted when first asked for."""
        if fit.locations not in self._models:
            self._models[fit.locations] = flexible(self._experiment.fitted, fit)
        return self._models[fit.locations]
