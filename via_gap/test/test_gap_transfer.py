"""Whether a repair holds in motion to which it was not fitted."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from gap_logs import log_of, rigid
from gap_models import evaluated
from via_gap.candidates.converged import converged
from via_gap.candidates.covariance import clusters
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import Scales
from via_gap.diagnosis import diagnose
from via_gap.report.assembly import _halves
from via_gap.residual.quantities import quantities
from via_gap.residual.recordings import Recordings
from via_gap.selection import reliability, transfer
from via_gap.selection.comparison import candidates_of
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import Result
from via_gap.selection.transfer import Transfer, transferred
from via_gap.selection.verdict import Decision, decide
from via_sim.effects import Effect

DRAG = Effect("quadratic_drag", "link", {"coefficient": 0.05})


@pytest.fixture(scope="module")
def experiment():
    recordings = Recordings.of([log_of(rigid(), (DRAG,), seed=3, duration=20.0)], None, rigid())
    return Experiment.of(recordings.fitted, recordings.held_out)


def fitted_by(experiment, location: Location, start: float) -> tuple[Fit, Scales]:
    scales = candidates_of(experiment).scales
    fit = refine(experiment.fitted, experiment.tuned.fit, [(location, [start])], scales)
    assert fit is not None
    return fit, scales


def left_by(experiment, location: Location, start: float) -> tuple[float, dict[str, float]]:
    """Squared error that one effect leaves of held-out motion, and of motion to which it was not fitted."""
    fit, scales = fitted_by(experiment, location, start)
    (model,) = experiment.evaluate([fit])
    return model.mean_square / experiment.tuned.mean_square, transferred(model, experiment, scales).shares


def test_the_true_effect_has_the_same_size_in_slow_and_in_fast_motion(experiment):
    left, elsewhere = left_by(experiment, Location("quadratic_drag", "link", 0), 0.03)
    assert elsewhere.keys() == {"time", "angle", "amplitude", "speed"}
    assert max(elsewhere.values()) < 1.3 * left < 0.01


def test_what_resembles_it_has_another_size_in_fast_motion(experiment):
    """Viscous friction in place of a drag: larger where the motion is faster."""
    fit, scales = fitted_by(experiment, Location("viscous_friction", "link", 0), 0.03)
    (model,) = experiment.evaluate([fit])
    found = transferred(model, experiment, scales)
    slow, fast = (each.effects[0].parameters["coefficient"] for each in found.worst)
    assert found.worst is found.halves["speed"] and fast > 1.3 * slow > 0.0


def test_the_report_has_the_main_effect_as_fitted_to_the_lower_and_to_the_upper_half(experiment):
    other = Effect("coulomb_friction", "link", {"torque": 0.1})
    low, high = (
        replace(experiment.tuned.fit, effects=(Effect(DRAG.name, "link", {"coefficient": size}), other))
        for size in (0.04, 0.06)
    )
    decision = replace(decide(experiment.tuned, [], lambda _: experiment.tuned), halves=(low, high))
    result = Result(None, decision, None)
    assert _halves(result) == {"coefficient": (0.04, 0.06)}
    assert _halves(replace(result, decision=replace(decision, halves=()))) == {}


def test_an_effect_that_resembles_it_fails_in_fast_motion_when_fitted_to_slow_motion(experiment):
    """Viscous friction in place of a drag that grows with the square of the speed."""
    left, elsewhere = left_by(experiment, Location("viscous_friction", "link", 0), 0.03)
    assert max(elsewhere, key=elsewhere.get) == "speed"
    assert elsewhere["speed"] > 1.4 * max(left, elsewhere["time"])


def test_the_interval_of_a_wrong_friction_holds_its_values_in_slow_and_in_fast_motion(experiment, monkeypatch):
    """The dry friction that fits a drag grows with the speed, which neighbours do not show; the drag is constant."""
    fit, scales = fitted_by(experiment, Location("coulomb_friction", "link", 0), 0.03)
    drag, _ = fitted_by(experiment, Location("quadratic_drag", "link", 0), 0.03)
    (sd,), (of_drag,) = (converged(experiment.fitted, each, scales).sd for each in (fit, drag))
    monkeypatch.setattr("via_gap.candidates.converged.clusters", lambda problem: clusters(problem)[:1])
    (of_neighbours,) = converged(experiment.fitted, fit, scales).sd
    speed = quantities(experiment.fitted.views)["speed"]
    for half in (speed < np.median(speed), speed >= np.median(speed)):
        part = experiment.fitted.part([np.flatnonzero(half)])[0]
        there = refine(part, fit, fit.members, scales).values[0]
        assert 1.96 * of_neighbours < abs(there - fit.values[0]) < 1.96 * sd
    assert of_drag < 0.001 * drag.values[0]


def test_a_main_effect_has_wider_intervals_than_an_effect(experiment, monkeypatch):
    counted = reliability.shipped().model_copy(update={"wider": {"effect": 1.5, "main_effect": 6.0}})
    monkeypatch.setattr(reliability, "shipped", lambda: counted)
    fit, scales = fitted_by(experiment, Location("quadratic_drag", "link", 0), 0.03)
    (model,) = experiment.evaluate([fit])
    known = {"shares": ((fit.locations[0], 1.0),), "models": (model,), "equivalent": fit.locations}
    sds = []
    for verdict, factor in counted.wider.items():
        decision = Decision(verdict, model, 1.0, **known).converged(experiment, scales)
        assert decision.widened == factor
        sds.append(decision.chosen.fit.sd[0])
    assert sds[1] == pytest.approx(4.0 * sds[0])


def test_a_quantity_in_which_most_segments_are_alike_divides_nothing(experiment, monkeypatch):
    """A joint that rests in most segments has speed 0 there."""
    quantities = transfer.quantities(experiment.everywhere().views)
    resting = np.where(np.arange(len(quantities["speed"])) % 3 == 0, quantities["speed"], 0.0)
    assert np.median(resting) == 0.0
    monkeypatch.setattr(transfer, "quantities", lambda _views: {**quantities, "speed": resting})
    assert left_by(experiment, Location("quadratic_drag", "link", 0), 0.03)[1].keys() == {"time", "angle", "amplitude"}


def test_a_wall_that_one_half_touches_a_few_times_is_kept_by_the_other_half():
    """Of a wall reached at the largest angles, no even choice of segments is sure to contain a touch."""
    wall = Effect("contact", "environment", {"angle": 0.55, "stiffness": 60.0, "damping": 0.0, "side": 1.0})
    log = log_of(rigid(), (wall,), seed=3, duration=20.0)
    recordings = Recordings.of([log], None, rigid())
    made = Experiment.of(recordings.fitted, recordings.held_out)
    beyond = log.measured["q"] > 0.55
    assert 0.0 < np.mean(beyond) < 0.06
    place = Location("contact", "environment", 0)
    scales = candidates_of(made).scales
    fit = refine(made.fitted, made.tuned.fit, [(place, list(wall.parameters.values()))], scales)
    (model,) = made.evaluate([fit])
    left = model.mean_square / made.tuned.mean_square
    assert max(transferred(model, made, scales).shares.values()) < 4.0 * left < 1e-4


def squares(*values: float) -> Evaluation:
    return evaluated(np.repeat(values, 20))


@pytest.mark.parametrize(
    ("before", "left", "by"),
    [
        (squares(100.0), {"speed": squares(30.0), "angle": squares(2.0)}, ""),
        (squares(100.0), {"speed": squares(95.0), "angle": squares(2.0)}, "speed"),
        (squares(100.0), {"speed": squares(95.0), "angle": squares(170.0)}, "angle"),
        (squares(1.6), {"speed": squares(1.1)}, ""),  # what is left is noise, though it is two thirds
        (squares(1.0, 1.0, 1.0, 900.0), {"time": squares(1.0, 1.0, 1.0, 90.0)}, ""),
        (squares(100.0), {}, ""),
    ],
)
def test_what_explains_hardly_anything_in_the_other_half_is_refuted(before, left, by):
    assert Transfer(before, left, {}).refuted_by == by


def test_nothing_is_named_that_does_not_hold_in_the_other_half(monkeypatch):
    report = partial(diagnose, [log_of(rigid(), (DRAG,), seed=3, duration=20.0)], rigid())
    monkeypatch.setattr("via_gap.selection.gap.decide", main_effect_by(decide))
    assert report().verdict == "main_effect"
    monkeypatch.setattr(Transfer, "refuted_by", property(lambda _own: "speed"))
    refuted = report()
    assert refuted.verdict == "cannot_tell" and not refuted.effects and not refuted.transfer
    assert "divided by speed, does not explain the other" in refuted.reason


def main_effect_by(decided):
    """The same decision, called a main effect: only these are compared in halves."""
    return lambda *of, **also: replace(decided(*of, **also), verdict="main_effect")
