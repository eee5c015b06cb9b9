"""The smoothed signal-based estimator: known truths without a velocity sensor, delay, gaps, standard errors."""

from dataclasses import replace

import numpy as np
import pytest
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators import integral
from via_estimators.filtered_signal_based import FilteredSignalBased, FilteredSignalBasedParameters, colour
from via_estimators.savitzky_golay import savitzky_golay

INERTIA, DAMPING, QUANTUM = 0.02, 0.3, 2.0 * np.pi / 2**14
ONE = FilteredSignalBasedParameters(
    transmissions=1, window=200, order=8, terms=2, torque_noise=1e-3, position_noise=1e-6, truncation=0.0
)


def planted(count=4000, period=1e-3):
    """Rows (count, 4) of time, q, theta, effort of one motor in prescribed motion; 8 phi + 5 phi^3; its stiffness."""
    t = period * np.arange(count)

    def motion(t):
        theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
        rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
        bend = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
        q = 0.5 * np.sin(4.0 * t)
        return q, theta, INERTIA * bend + DAMPING * rate - 8.0 * (q - theta) - 5.0 * (q - theta) ** 3

    q, theta, _ = motion(t)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    effort = sum(0.5 * w * motion(t + 0.5 * period * (node - 1.0))[2] for node, w in zip(nodes, weights, strict=True))
    return np.column_stack([t, q, theta, effort]), 8.0 + 15.0 * (q - theta) ** 2


@pytest.mark.parametrize(("window", "order"), [(200, 8), (1000, 20)])
def test_parameters_are_recovered_without_a_velocity(window, order):
    rows, truth = planted()
    _, estimates = FilteredSignalBased(replace(ONE, window=window, order=order)).run_rows(rows)
    converged = estimates.status == Status.OK
    assert converged.mean() > 0.4
    assert np.abs(estimates.value[:, 0] / truth - 1.0)[converged].max() < 5e-3
    assert estimates.column("motor_inertia_1")[0][-1] == pytest.approx(INERTIA, rel=2e-3)
    assert estimates.column("motor_damping_1")[0][-1] == pytest.approx(DAMPING, rel=2e-3)


def test_errata_53_to_55_stiffness_is_that_of_the_present_deflection():
    """Evaluated at the window's centre, (W - 1)/2 samples ago, stiffness would be far off."""
    rows, truth = planted()
    value = FilteredSignalBased(ONE).run_rows(rows)[1].value[:, 0]
    now = np.abs(value - truth)[2000:].max()
    late = np.abs(value[2000:] - truth[1900:-100]).max()
    assert now < 0.05 and late > 50.0 * now


def test_a_rate_other_than_declared_is_measured():
    rows, truth = planted()
    _, estimates = FilteredSignalBased(replace(ONE, sampling=1.1e-3)).run_rows(rows)
    assert np.abs(estimates.value[-1000:, 0] / truth[-1000:] - 1.0).max() < 5e-3


@pytest.mark.parametrize("share", [0.3, 1.7])
def test_a_step_off_by_more_than_half_an_interval_is_a_gap(share):
    rows, _ = planted(2000)
    rows[1500:, 0] += (share - 1.0) * 1e-3
    state, estimates = FilteredSignalBased(ONE).run_rows(rows)
    assert FilteredSignalBased(ONE).health(state).gaps == 1
    assert np.all(estimates.status[1500:1700] == Status.NOT_EXCITED)
    rows[1500:, 0] += (1.3 - share) * 1e-3  # now a mere jitter
    assert FilteredSignalBased(ONE).health(FilteredSignalBased(ONE).run_rows(rows)[0]).gaps == 0


def test_standard_deviations_match_empirical_ones():
    """Reported over empirical on 60 seeds: quantised encoders and torque noise, an odd spring law within the basis."""
    clean, truth = planted(5000)
    estimator = FilteredSignalBased(
        replace(ONE, window=400, order=12, torque_noise=0.05, quantum=QUANTUM, position_noise=1e-5, acceleration=60.0)
    )
    errors, promised = [], []
    for seed in range(60):
        rng, rows = np.random.default_rng(seed), clean.copy()
        zero = rng.uniform(-0.5, 0.5, size=2)
        rows[:, 1:3] = QUANTUM * (np.round(rows[:, 1:3] / QUANTUM + zero) - zero)
        rows[:, 3] += 0.05 * rng.normal(size=len(rows))
        value, sd = estimator.run_rows(rows)[1].column("stiffness")
        errors.append((value - truth)[1500::50])
        promised.append(sd[1500::50])
    ratio = np.sqrt(np.mean(np.square(promised)) / np.mean(np.square(errors)))
    assert 0.8 <= ratio <= 1.25, ratio


@pytest.mark.parametrize(("window", "order"), [(1000, 20), (200, 4), (1000, 3)])
def test_colour_is_that_of_the_smoothing(window, order):
    """In all, and in what integrals of 50 and 100 samples make of it: k (T - k) from reset to reset."""
    weights = savitzky_golay(window + 1, order)[0]
    model = colour(weights[window // 2])
    true, found, state = np.correlate(weights, weights, "full")[window:], [model[0, 0]], model[1:, 0]
    for _ in range(10 * window):
        found.append(model[0, 1:] @ state)
        state = model[1:, 1:] @ state
    assert 2.0 * sum(found) - found[0] == pytest.approx(1.0, rel=1e-3)
    for span in (50, 100):
        kernel = np.tile(np.arange(span) * (span - np.arange(span)), 10 * window // span)
        lags = np.correlate(kernel, kernel, "full")[kernel.size - 1 :][: window + 1]
        white, smooth, ours = lags[0], *(2.0 * r @ lags - r[0] * lags[0] for r in (true, np.array(found)[: window + 1]))
        assert smooth < 0.87 * white
        assert ours == pytest.approx(smooth, rel=0.03)


def test_variance_of_stiffness_is_the_sum_over_single_torque_errors():
    """Errors at every 10th sample suffice, since the filter makes their effect smooth."""
    rows, _ = planted(1500)
    estimator = FilteredSignalBased(replace(ONE, horizon=0.05))
    state, last = estimator.run_rows(rows)
    effect = []
    for k in range(5, 1500, 10):
        wrong = rows.copy()
        wrong[k, 3] += 1e-3
        effect.append(estimator.run_rows(wrong)[1].value[-1] - last.value[-1])
    phi, n, own = rows[-1, 1] - rows[-1, 2], 5, estimator.parameters
    for at, slope in (
        (0, [0.0, 0.0, 0.0, 1.0, phi**2]),
        (2, [0.0, 1.0, 0.0, 0.0, 0.0]),
        (3, [0.0, 0.0, 1.0, 0.0, 0.0]),
    ):
        widths = np.array([0.0, own.inertia_deviation, own.damping_deviation, *(2 * [own.stiffness_deviation])])
        equation = state[-integral.size(n, 1, 2) :].copy()
        inverted, found = np.empty((n, n)), np.empty(1)
        integral.inverse(equation, n, inverted)
        slopes = (widths * slope)[None, :]
        integral.variances(equation, n, slopes, 1.0, 0.0, np.zeros(n), inverted, np.empty((n + 2, n)), found)
        assert np.sqrt(found[0]) == pytest.approx(np.sqrt(10.0 * np.sum(np.square(effect), axis=0)[at]), rel=0.03)


@pytest.mark.parametrize(
    ("change", "message"), [({"window": 201}, "must be even"), ({"window": 20, "order": 30}, "order must")]
)
def test_even_windows_raise(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(ONE, **change)
