"""Most likely starts: closed forms, and a ripple whose periods a slow axis may or may not cross."""

import numpy as np
import pytest
from gap_logs import log_of, rigid
from scipy.optimize import minimize
from via_gap.candidates.converged import converged
from via_gap.candidates.fit import fit_device_parameters
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import scales_of
from via_gap.residual.inverse_dynamics import missing_torque
from via_gap.residual.likely_starts import likely_start, likely_starts
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect

RIPPLE = Effect("torque_ripple", "motor", {"amplitude": 0.4, "order": 60.0, "phase": 1.0}, 1)


def test_the_most_likely_starts_of_linear_errors_are_those_of_ridge_regression():
    rng = np.random.default_rng(1)
    slopes, begin = rng.normal(size=(5, 30, 2)), 3.0 * rng.normal(size=(5, 30))
    found, there = likely_starts(lambda d: begin + np.einsum("crk,ck->cr", slopes, d), 5, 2)
    for own, errors, at in zip(slopes, begin, found):
        assert at == pytest.approx(-np.linalg.solve(own.T @ own + np.eye(2), own.T @ errors), abs=1e-9)
    assert there == pytest.approx(slopes, abs=1e-9)
    # Small errors: the loss is that of squares.
    shared = likely_start(lambda d: 0.1 * (begin + (slopes @ d.T).transpose(2, 0, 1)), 2)
    flat, target = 0.1 * slopes.reshape(-1, 2), 0.1 * begin.ravel()
    assert shared == pytest.approx(-np.linalg.solve(flat.T @ flat + np.eye(2), flat.T @ target), abs=1e-3)


def test_the_most_likely_starts_of_curved_errors_are_those_of_a_general_search():
    rng = np.random.default_rng(2)
    grid, truth = np.linspace(0.0, 2.0, 25), rng.normal(size=(6, 2))

    def model(d):
        return 20.0 * np.exp(0.3 * d[:, :1] * grid) + 5.0 * np.sin(d[:, 1:] + grid)

    data = model(truth) + rng.normal(size=(6, 25))
    found, _ = likely_starts(lambda d: model(d) - data, 6, 2)
    for k, at in enumerate(found):
        best = minimize(lambda d, k=k: np.sum((model(d[None])[0] - data[k]) ** 2) + d @ d, at, tol=1e-12)
        assert at == pytest.approx(best.x, abs=1e-2)


@pytest.fixture(scope="module")
def slow():
    """Model of a slow joint with a ripple of many periods, and its sizes."""
    log = log_of(rigid(), [RIPPLE], seed=4, duration=12.0, tolerance=0.0)
    segments = cut_log(log)
    every = np.flatnonzero(segments.valid)
    problem = ResidualModel.of([segments], [every])
    scales = scales_of([segments], [missing_torque(segments, log.device)])
    return problem, scales


def test_the_true_model_leaves_noise_about_likely_starts_and_more_about_measured_ones(slow):
    problem, _ = slow
    truth = problem.row([RIPPLE])
    about_measured = np.mean(problem.residual([truth])[0] ** 2)
    about_likely = np.mean(problem.at_likely_starts(truth).residual([truth])[0] ** 2)
    assert about_measured > 2.0
    assert 0.7 < about_likely < 1.2


def test_a_part_keeps_its_starts(slow):
    problem, _ = slow
    truth = problem.row([RIPPLE])
    likely = problem.at_likely_starts(truth)
    some = np.arange(0, len(likely.views[0].chosen), 3)
    part, places = likely.part([some])
    assert part.residual([truth])[0] == pytest.approx(likely.residual([truth])[0][places], rel=1e-6, abs=1e-6)


def test_the_converged_fit_of_the_ripple_holds_the_truth(slow):
    problem, scales = slow
    location = Location.of(RIPPLE)
    base = refine(problem, fit_device_parameters(problem), [(location, list(RIPPLE.parameters.values()))], scales)
    found = converged(problem, base, scales)
    (effect,) = found.effects
    errors = np.array([effect.parameters[name] - value for name, value in RIPPLE.parameters.items()])
    assert np.all(np.abs(errors) <= 3.0 * found.sd)  # the order of whole periods is not fitted
    assert found.sd[0] < 0.01 * RIPPLE.parameters["amplitude"]
