"""The achievable error: held-out error of a flexible torque model beside the effects of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.selection.bound import Flexible, flexible
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment


class Achievable:
    """Flexible models beside the effects of fits, each made once for the decision and for the gap."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._models: dict[tuple[Location, ...], Flexible] = {}

    def beside(self, each: Evaluation) -> Evaluation:
        """Evaluation of the flexible model beside an evaluated fit, on the same held-out segments."""
        experiment = self._experiment
        if experiment.by_equations:
            segments = experiment.bound_of_equations(each.fit)
        elif experiment.folds is not None:
            segments = experiment.folds.flexible(each.fit)
        else:
            model, data = self.model(each.fit), experiment.evaluated
            segments = data.evidence(model.residual(data, model.functions(data)))
        return replace(each, segments=segments, fitted=np.empty(0))

    def model(self, fit: Fit) -> Flexible:
        """The flexible model beside `fit`; fits at the same locations share the first one."""
        if fit.locations not in self._models:
            self._models[fit.locations] = flexible(self._experiment.fitted, fit)
        return self._models[fit.locations]
