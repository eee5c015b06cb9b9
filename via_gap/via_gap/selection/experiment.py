"""Segments that are fitted, segments that are held out, and the view in which models are compared.

There are two views of the error of a segment: the simulation from its measured start (`Rollout`), and the missing
torque of its equations along the measured motion (`InverseDynamics`). Models are compared by simulation, and inverse
dynamics can veto them. Exception: the tuned device does not predict the motion significantly better than constant
velocity from each start. In simulation, any effect that keeps the model at rest would then win, so models are compared
by inverse dynamics alone.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from via_core.errors import SignalError
from via_core.signals import Array, Indices

from via_gap.candidates.fit import Fit, fit_device_parameters
from via_gap.candidates.scales import Scales
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel, View
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Segments, lined
from via_gap.selection.evidence import Evaluation, evaluate, predicts, significantly_worse
from via_gap.selection.folds import Folds
from via_gap.selection.holdout import lopsided, one_sided, split, split_finely
from via_gap.selection.torque_bound import torque_bound

By = Literal["segments", "whole runs", "inverse dynamics"]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Segments of all logs, those of held-out logs last, and their residual models.

    train, held  indices of fitted and held-out segments, one array per log
    by           view in which models are compared
    fitted       residual model that fits minimise; `evaluated` the one on which fits are compared
    other_view   the other view of the held-out segments; None if it is not available
    nominal      evaluation of the device as filed; `tuned` with its parameters fitted
    baseline     evaluation of a prediction without a model
    folds        cross-validation over whole runs, where each run is one segment
    """

    segments: tuple[Segments, ...]
    train: tuple[Indices, ...]
    held: tuple[Indices, ...]
    by: By
    fitted: ResidualModel
    evaluated: ResidualModel
    other_view: ResidualModel | None
    nominal: Evaluation
    tuned: Evaluation
    baseline: Evaluation
    folds: Folds | None = None

    @staticmethod
    def of(
        segments: Sequence[Segments],
        holdout: Sequence[Segments],
        groups: Mapping[str, Hashable] | None = None,
        only_equations: bool = False,
    ) -> Experiment:
        """The experiment on logs cut into segments.

        holdout         logs to compare models on; without them, segments of the same logs are held out
        groups          group of each log by its name; logs of one group are left out together in cross-validation
        only_equations  compare models by inverse dynamics alone

        Raises SignalError if inverse dynamics is needed and the signals do not allow it.
        """
        train, held, everything = split(segments, holdout)
        if only_equations:
            return _experiment(everything, train, held, equations=True)
        runs = all(len(each) == 1 for each in everything) and bool(holdout)
        made = _experiment(everything, train, held, robust=not runs)
        if not holdout and one_sided(made.tuned.fitted, made.tuned.segments):
            train, held = split_finely(everything)
            made = _experiment(everything, train, held)
        if runs:
            known = groups or {}
            names = [known.get(s.log.name, i) for i, s in enumerate(segments) if len(train[i])]
            return made._crossed(names)
        return made if predicts(made.tuned, made.baseline) else made.compared_by_equations() or made

    def evaluate(self, fits: Sequence[Fit]) -> list[Evaluation]:
        """Held-out errors of fits in both views."""
        return evaluate(self.evaluated, fits, self.other_view, self.fitted)

    def compare(self, fits: Sequence[Fit], scales: Scales) -> list[Evaluation]:
        """Evaluations by which models are compared: on held-out data, or by cross-validation of whole runs."""
        return self.evaluate(fits) if self.folds is None else self.folds.evaluate(fits, scales)

    @property
    def by_equations(self) -> bool:
        """Whether models are compared by inverse dynamics."""
        return self.by == "inverse dynamics"

    def around(self, events: Sequence[float]) -> Experiment:
        """The same with finely alternating segments; those at `events` [s] and their neighbours are on both sides."""
        train, held = split_finely(self.segments, events)
        return _experiment(self.segments, train, held, self.by_equations, self.fitted.robust)

    def lopsided(self, models: Sequence[Evaluation]) -> bool:
        """Whether one of the useful models leaves errors in the fitted or in the held-out blocks alone.

        Then a motion repeats with the blocks, or one block hides when something began, and held-out errors say nothing
        about it: useful is what improves all segments. Held-out whole logs stay so.
        """
        if not any(len(a) and len(b) for a, b in zip(self.train, self.held, strict=True)):
            return False
        before = self.tuned.on_all.score
        return any(lopsided(each.fitted, each.segments) for each in models if each.on_all.score < before)

    def in_lines(self, late: float) -> Experiment:
        """The same with commands interpolated linearly between samples, delayed by `late` [s]."""
        segments = [lined(each, late) for each in self.segments]
        return _experiment(segments, self.train, self.held, self.by_equations, self.fitted.robust)

    def everywhere(self) -> ResidualModel:
        """The residual model of all segments, fitted and held out."""
        every = [np.flatnonzero(each.valid) for each in self.segments]
        return ResidualModel.of(self.segments, every, _view(self.by_equations), self.fitted.robust)

    @property
    def may_veto(self) -> bool:
        """Whether the other view may veto: the tuned device is not significantly worse there than no model."""
        if self.other_view is None:
            return False
        return not significantly_worse(self.tuned.in_other_view, _baseline(self.other_view, self.tuned))

    def compared_by_equations(self) -> Experiment | None:
        """The same compared by inverse dynamics alone.

        None if it is already, no equation can be evaluated, or no model predicts the torque of the drive. Neither for
        a drive with a control loop: as part of the model it makes up for missing torque.
        """
        if self.other_view is None or self.folds is not None or self.evaluated.device.drive != "torque":
            return None
        made = _experiment(self.segments, self.train, self.held, equations=True)
        flexible = replace(made.tuned, segments=made.bound_of_equations(made.tuned.fit))
        both = [replace(each, fitted=np.empty(0)) for each in (flexible, made.tuned)]  # a push may spoil the former
        return None if all(significantly_worse(each, made.baseline) for each in both) else made

    def bound_of_equations(self, fit: Fit) -> Array:
        """(S,) mean squared whitened held-out missing torque that a flexible torque model beside a fit leaves."""
        row = self.fitted.row(fit.effects, fit.offsets)
        sides = []
        for model in (self.fitted, self.evaluated):
            views = [view for view in model.views if isinstance(view, InverseDynamics)]
            sides += [views, [view.residual(row[None])[0] for view in views]]
        return self.evaluated.once_per_rest(torque_bound(*sides))

    def _crossed(self, names: Sequence[Hashable]) -> Experiment:
        """The same for whole runs: models are compared by cross-validation over the fitted runs."""
        folds = Folds.of(self.fitted, names)
        if folds is None:
            return replace(self, by="whole runs")
        nominal, (tuned,) = folds.nominal(self.nominal.fit), folds.evaluate([self.tuned.fit], None)
        baseline = _baseline(self.fitted, tuned)
        return replace(
            self, by="whole runs", folds=folds, nominal=nominal, tuned=tuned, baseline=baseline, other_view=None
        )


def _experiment(
    segments: Sequence[Segments], train: Sequence[Indices], held: Sequence[Indices], equations: bool = False,
    robust: bool = True,
) -> Experiment:  # fmt: skip
    """An experiment in one view, with the device parameters fitted and evaluated."""
    view = _view(equations)
    fitted, evaluated = (ResidualModel.of(segments, side, view, robust) for side in (train, held))
    other_view = None
    if not equations:
        try:
            other_view = ResidualModel.of(segments, held, InverseDynamics.by_segment)
        except SignalError:
            other_view = None
    base = fit_device_parameters(fitted)
    filed = Fit((), np.zeros_like(base.offsets), 0.0, fitted.residual([fitted.row(())])[0], np.empty((0, 0)))
    nominal, tuned = evaluate(evaluated, [filed, base], other_view, fitted)
    own = fitted.evidence(fitted.baseline())
    baseline = replace(_baseline(evaluated, tuned), fitted=own, shared=tuned.shared)
    by: By = "inverse dynamics" if equations else "segments"
    return Experiment(
        tuple(segments), tuple(train), tuple(held), by, fitted, evaluated, other_view, nominal, tuned, baseline
    )


def _view(equations: bool) -> Callable[[Segments, Indices], View]:
    return InverseDynamics.of if equations else Rollout.of


def _baseline(model: ResidualModel, tuned: Evaluation) -> Evaluation:
    """Evaluation of a prediction without a model on the segments of `model`, resampled as those of `tuned`."""
    residual = model.baseline()
    return Evaluation(tuned.fit, residual, model.evidence(residual), tuned.block, tuned.whole)
