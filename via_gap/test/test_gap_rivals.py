"""Rivals replace one effect of a model, beside the same other effects and from their values."""

import numpy as np
from gap_logs import log_of, rigid
from via_gap.candidates.fit import Fit, fit_device_parameters
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import scales_of
from via_gap.diagnosis import diagnose
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.selection.evidence import Evaluation, evaluate
from via_gap.selection.rivals import rivals
from via_sim.effects import Effect

GAIN, BIAS = Location("torque_gain", "motor", 1), Location("torque_bias", "motor", 1)
DRY, SPRING = Location("coulomb_friction", "link", 0), Location("link_spring", "link", 0)


def test_each_effect_is_replaced_by_the_best_others_that_were_not_tried_beside_the_rest():
    planted = (Effect("coulomb_friction", "link", {"torque": 0.1}), Effect("torque_gain", "motor", {"gain": 1.3}, 1))
    log = log_of(rigid(), planted, seed=3, duration=10.0)
    segments = cut_log(log)
    model = ResidualModel.of([segments], [np.flatnonzero(segments.valid)], robust=True)
    scales = scales_of([segments], [None])
    tuned = fit_device_parameters(model)

    def of(*members: tuple[Location, list[float]]) -> Evaluation:
        fit = refine(model, tuned, list(members), scales)
        assert fit is not None
        return evaluate(model, [fit], None, model)[0]

    def evaluated(fits: list[Fit]) -> list[Evaluation]:
        return evaluate(model, fits, None, model)

    dry, gain, spring, bias = (DRY, [0.05]), (GAIN, [1.1]), (SPRING, [0.1, 0.0]), (BIAS, [0.05])
    singles = [of(each) for each in (dry, gain, spring, bias)]
    named = of(dry, gain)
    found = rivals(model, [*singles, named, of(dry, spring)], scales, evaluated)(named)
    pairs = {frozenset(each.fit.locations) for each in found}
    assert pairs == {frozenset((DRY, BIAS)), frozenset((GAIN, BIAS))}, "beside the gain the spring vanishes"
    for each in found:
        assert each.score >= named.score
    assert rivals(model, singles, scales, evaluated)(singles[0]) == []


def test_rivals_are_among_the_models_of_the_report(monkeypatch):
    fitted: list[Evaluation] = []

    def recorded(*given):
        of = rivals(*given)

        def wrapped(model):
            found = of(model)
            fitted.extend(found)
            return found

        return wrapped

    monkeypatch.setattr("via_gap.selection.gap.rivals", recorded)
    ripple = Effect("torque_ripple", "motor", {"amplitude": 0.0012, "order": 9.0, "phase": 0.3}, 1)
    planted = (Effect("coulomb_friction", "link", {"torque": 0.0025}), ripple)
    report = diagnose([log_of(rigid(), planted, seed=3, duration=10.0)], rigid())
    listed = [{each.effect for each in trial.effects} for trial in report.figures.trials]
    assert fitted
    assert all({location.name for location in each.fit.locations} in listed for each in fitted)
