"""Whether a repair holds in motion to which it was not fitted."""

import numpy as np
import pytest
from gap_logs import log_of, rigid
from via_gap.candidates.converged import converged
from via_gap.candidates.covariance import clusters
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import Scales
from via_gap.residual.quantities import quantities
from via_gap.residual.recordings import Recordings
from via_gap.selection import reliability, transfer
from via_gap.selection.comparison import candidates_of
from via_gap.selection.experiment import Experiment
from via_gap.selection.transfer import EVERY, _every, transferred
from via_gap.selection.verdict import Decision
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
    return model.mean_square / experiment.tuned.mean_square, transferred(model, experiment, scales)


def test_the_true_effect_has_the_same_size_in_slow_and_in_fast_motion(experiment):
    left, elsewhere = left_by(experiment, Location("quadratic_drag", "link", 0), 0.03)
    assert elsewhere.keys() == {"time", "angle", "amplitude", "speed"}
    assert max(elsewhere.values()) < 1.3 * left < 0.01


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


def test_segments_in_which_an_effect_begins_are_fitted_with_either_half(experiment, monkeypatch):
    problem, begins = experiment.everywhere(), 7.0
    (around,) = problem.touched(np.array([[begins], [begins]]))
    assert 0 < len(around) < 0.1 * len(problem.views[0].chosen)
    asked, part = [], transfer._part
    monkeypatch.setattr(transfer, "event_times", lambda _fit: (begins,))
    monkeypatch.setattr(transfer, "_part", lambda whole, kept: (asked.append(kept), part(whole, kept))[1])
    left_by(experiment, Location("quadratic_drag", "link", 0), 0.03)
    assert len(asked) == 2 * 2 * 4  # fitted and compared, both halves, four quantities
    for fitted, compared in zip(asked[::2], asked[1::2], strict=True):
        assert np.all(fitted[around]) and np.all(fitted | compared)
        assert np.mean(fitted & compared) < 0.15


def test_a_tenth_of_the_other_half_is_spread_evenly():
    half = np.arange(100) % 2 == 0
    chosen = _every(half)
    assert not np.any(chosen & ~half) and np.sum(chosen) == 50 // EVERY
    assert np.all(np.diff(np.flatnonzero(chosen)) == 2 * EVERY)
