"""What is fitted, what is held out, and which view judges.

Two views look at every segment: simulated from its measured start (`Rollout`), and the torque that its equations lack
along the measured motion (`InverseDynamics`). Simulated segments judge, with inverse dynamics as the witness that can
contradict, unless the model does not clearly predict the motion better than a straight line from each start: then
measured torque does not predict it, whatever keeps the model from moving would win, and inverse dynamics judges alone.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from via_core.errors import SignalError
from via_core.signals import Array

from via_gap.candidates.fit import Fit, fit_device_numbers
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Indices, Segments, lined
from via_gap.selection.evidence import Evaluation, clearly_worse, evaluate
from via_gap.selection.folds import Folds
from via_gap.selection.holdout import one_sided, split, split_finely
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.torque_bound import torque_bound

By = Literal["segments", "whole runs", "inverse dynamics"]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Segments of all logs, those held out last, and the models that are fitted to some and judged on others.

    train, held  indices of segments, one array per log
    fitted       what fits minimise; `judged` what they are evaluated on
    witness      the other view of the held-out segments, None where it cannot judge
    nominal      the device as filed, evaluated; `tuned` its own numbers fitted
    baseline     the prediction without a model, evaluated in the view that judges
    folds        cross-validation over whole runs, where each is one segment
    """

    segments: tuple[Segments, ...]
    train: tuple[Indices, ...]
    held: tuple[Indices, ...]
    by: By
    fitted: ResidualModel
    judged: ResidualModel
    witness: ResidualModel | None
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

        holdout         logs to judge on; without them stretches of the same logs are held out
        groups          of logs, by their names: those of one group never speak for each other
        only_equations  inverse dynamics judges alone, whatever is predicted

        Raises SignalError where inverse dynamics is needed and the signals allow none.
        """
        train, held, everything = split(segments, holdout)
        if only_equations:
            return _experiment(everything, train, held, equations=True)
        runs = all(len(each) == 1 for each in everything) and bool(holdout)
        made = _experiment(everything, train, held, robust=not runs)
        if not holdout and one_sided(
            made.fitted.per_segment(made.tuned.fit.residual), made.tuned.segments, NUMBERS.no_gap
        ):
            train, held = split_finely(everything)
            made = _experiment(everything, train, held)
        if runs:
            known = groups or {}
            names = [known.get(s.log.name, i) for i, s in enumerate(segments) if len(train[i])]
            return made._crossed(names)
        open_loop = made.judged.device.drive == "torque"  # else the loop that moves the joint is part of the model
        if open_loop and made.witness is not None and not clearly_worse(made.baseline, made.tuned):
            return made._by_equations() or made
        return made

    def evaluate(self, fits: Sequence[Fit]) -> list[Evaluation]:
        """Fits on held-out segments of the view that judges and of the witness."""
        return evaluate(self.judged, fits, self.witness)

    def around(self, events: Sequence[float]) -> Experiment:
        """The same with finely alternating segments; those in which something begins or ends [s] are fitted."""
        train, held = split_finely(self.segments, events)
        return _experiment(self.segments, train, held, self.by == "inverse dynamics", self.fitted.robust)

    def in_lines(self, late: float) -> Experiment:
        """The same experiment with commands on lines from sample to sample, `late` [s]."""
        segments = [lined(each, late) for each in self.segments]
        return _experiment(segments, self.train, self.held, self.by == "inverse dynamics", self.fitted.robust)

    def everywhere(self) -> ResidualModel:
        """All segments, fitted and held out, in the view that judges."""
        every = [np.flatnonzero(each.valid) for each in self.segments]
        return ResidualModel.of(self.segments, every, _view(self.by == "inverse dynamics"), self.fitted.robust)

    @property
    def contradicts(self) -> bool:
        """Whether the witness can contradict: it predicts better than no model does."""
        return self.witness is not None and not clearly_worse(
            _seen_by_witness(self.tuned), Evaluation(self.tuned.fit, *_baseline(self.witness), self.tuned.block)
        )

    def _by_equations(self) -> Experiment | None:
        """The same judged by inverse dynamics alone; None where no model predicts the torque either."""
        made = _experiment(self.segments, self.train, self.held, equations=True)
        bound = Evaluation(
            made.tuned.fit, made.tuned.residual, made.bound_of_equations(made.tuned.fit), made.tuned.block
        )
        return None if clearly_worse(bound, made.baseline) else made

    def bound_of_equations(self, fit: Fit) -> Array:
        """(S,) mean squared whitened missing torque that a flexible torque model beside a fit leaves, held out."""
        row = self.fitted.row(fit.effects, fit.deviations)
        sides = []
        for model in (self.fitted, self.judged):
            views = [view for view in model.views if isinstance(view, InverseDynamics)]
            sides += [views, [view.residual(row[None])[0] for view in views]]
        return torque_bound(*sides)

    def _crossed(self, names: Sequence[Hashable]) -> Experiment:
        """Whole runs: causes are chosen on the fitted runs alone, each evaluated by fits to others."""
        folds = Folds.of(self.fitted, names)
        if folds is None:
            return replace(self, by="whole runs")
        nominal, (tuned,) = folds.nominal(self.nominal.fit), folds.evaluate([self.tuned.fit], None)
        line = self.fitted.baseline()
        baseline = Evaluation(tuned.fit, line, self.fitted.per_segment(line), tuned.block, whole=True)
        return replace(
            self, by="whole runs", folds=folds, nominal=nominal, tuned=tuned, baseline=baseline, witness=None
        )


def _experiment(
    segments: Sequence[Segments], train: Sequence[Indices], held: Sequence[Indices], equations: bool = False,
    robust: bool = True,
) -> Experiment:  # fmt: skip
    """Both sides of one view, with the device's own numbers fitted by the loss that judges, and evaluated."""
    view = _view(equations)
    fitted, judged = (ResidualModel.of(segments, side, view, robust) for side in (train, held))
    witness = None
    if not equations:
        try:
            witness = ResidualModel.of(segments, held, InverseDynamics.witness)
        except SignalError:
            witness = None
    base = fit_device_numbers(fitted)
    filed = Fit((), np.zeros_like(base.deviations), 0.0, np.empty(0), np.empty((0, 0)))
    nominal, tuned = evaluate(judged, [filed, base], witness)
    baseline = Evaluation(base, *_baseline(judged), tuned.block)
    by: By = "inverse dynamics" if equations else "segments"
    return Experiment(tuple(segments), tuple(train), tuple(held), by, fitted, judged, witness, nominal, tuned, baseline)


def _view(equations: bool):  # type: ignore[no-untyped-def]
    return InverseDynamics.of if equations else Rollout.of


def _baseline(model: ResidualModel) -> tuple[Array, Array]:
    """(R,) and (S,) of the prediction without a model."""
    residual = model.baseline()
    return residual, model.per_segment(residual)


def _seen_by_witness(each: Evaluation) -> Evaluation:
    return Evaluation(each.fit, each.witness, each.witness, each.block)
