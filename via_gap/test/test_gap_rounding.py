"""Errors of rounding: against values rounded at many phases; a coarse encoder alone causes no gap."""

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import savgol_filter
from via_core.signals import Signals
from via_gap.candidates.fit import fit_device_parameters
from via_gap.logs.log import JointLog
from via_gap.logs.rounding import correlation, interpolated, mean_variance, slope_order, variances
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect


@pytest.mark.parametrize("advance", [0.0, 0.07, 0.4, 1.3], ids="{} steps from reading to reading".format)
def test_errors_hang_together_as_those_of_readings_rounded_at_every_phase_do(advance):
    step, lags = 0.003, 9
    angle = advance * step * np.arange(500)
    phases = step * (np.arange(1000) + 0.5) / 1000.0
    shifted = angle[:lags] + phases[:, None]
    error = step * np.rint(shifted / step) - shifted
    seen = error.T @ error / len(phases) / (step**2 / 12.0)
    expected = correlation(angle, step, lags)
    assert expected == pytest.approx(seen[0], abs=0.01)
    weights = np.random.default_rng(1).normal(size=lags)
    assert variances(weights, expected) == pytest.approx(weights @ seen @ weights, rel=0.02, abs=0.02)


def test_readings_of_one_step_are_one_reading_and_those_without_order_are_as_many():
    slow, fast = (correlation(speed * np.arange(4000.0), 1.0, 4) for speed in (1e-3, 17.38))
    assert mean_variance(slow) == pytest.approx(1.0, abs=0.03)
    assert mean_variance(fast) == pytest.approx(0.25, abs=0.03)


def test_of_an_axis_that_rests_for_most_of_a_log_the_rest_counts():
    angle = np.concatenate([np.zeros(20000), 3.7 * np.arange(8000.0)])
    assert correlation(angle, 1.0, 4)[1] > 0.5
    moving = correlation(angle, 1.0, 4, run=250)
    assert moving == pytest.approx(correlation(angle[20000:], 1.0, 4), abs=0.05)
    assert np.array_equal(correlation(np.zeros(1000), 1.0, 4, run=250), [1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("step", "order"), [(1e-4, 3), (4e-4, 3), (1e-3, 2), (8e-3, 2)])
def test_the_slope_taken_is_the_one_that_is_less_wrong(step, order):
    amplitude, rate, window = 0.05, 2.0 * np.pi * 4.0, 25
    time = np.arange(8000) / 1000.0
    angle = amplitude * np.sin(rate * time) + 0.6 * np.sin(0.7 * time)
    speed = amplitude * rate * np.cos(rate * time) + 0.42 * np.cos(0.7 * time)
    values = step * np.rint(angle / step)
    chosen = slope_order(values, savgol_filter(values, window, 2), step, window)
    slopes = sliding_window_view(values, window) @ np.linalg.pinv(np.vander(np.arange(-12, 13) / 1e3, 4))[2]
    wrong = {2: savgol_filter(values, window, 2, deriv=1, delta=1e-3)[12:-12] - speed[12:-12]}
    wrong[3] = slopes - speed[12:-12]
    assert chosen == order == min(wrong, key=lambda each: float(np.mean(wrong[each] ** 2)))


@pytest.mark.parametrize(("motors", "axis"), [(1, 0), (1, 1), (0, 0)], ids=["link", "motor", "rigid"])
def test_a_coarse_encoder_leaves_no_gap_that_the_device_does_not_explain(motors, axis):
    """With uncorrelated errors and the slope of a cubic, the values would be 3.9, 2.0 and 2.4."""
    fine = flexible().sensors
    device = flexible() if motors else rigid().model_copy(update={"sensors": fine})
    coarse = Effect("encoder_quantisation", "sensor", {"quantum": 0.02}, axis)
    segments = cut_log(log_of(device, (coarse,), seed=1, duration=6.0))
    fit = fit_device_parameters(ResidualModel.of([segments], [np.arange(1, len(segments))]))
    each = fit.residual.reshape(-1, len(segments.axes))
    assert np.max(np.mean(each**2, axis=0)) < 1.25
    assert np.min(np.mean(each**2, axis=0)) > 0.75  # nor is it taken for more than it is


def test_between_readings_a_cubic_is_exact_and_its_weights_tell_what_is_left_of_their_errors():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.9e-3, 1.1e-3, 3000))
    wanted = np.sort(rng.uniform(time[1], time[-2], 2000))
    cubic = np.polynomial.Polynomial([0.3, -2.0, 4.0, 7.0])
    found, weights = interpolated(time, cubic(time), wanted, 1.5e-3)
    assert np.allclose(found, cubic(wanted), atol=1e-12)
    errors = 1e-9 * rng.normal(size=(3000, 400))  # which turn no bend
    noisy = np.stack([1e9 * interpolated(time, cubic(time) + each, wanted, 1.5e-3)[0] for each in errors.T])
    independent = np.eye(1, 4)[0]
    assert np.mean(variances(weights, independent)) == pytest.approx(float(np.mean(np.var(noisy, axis=0))), rel=0.02)
    assert interpolated(time, cubic(time), time[5:9], 1.5e-3)[0] == pytest.approx(cubic(time[5:9]), abs=1e-14)


def test_beside_lost_samples_and_at_the_ends_readings_are_joined_by_straight_lines():
    time = np.array([0.0, 1.0, 2.0, 3.0, 6.0, 7.0, 8.0, 9.0])
    wanted = np.array([-0.5, 0.5, 1.5, 2.5, 4.5, 6.5, 7.5, 8.5, 9.0])
    found, weights = interpolated(time, time**3, wanted, 1.5)
    straight = np.interp(wanted, time, time**3)
    curved = np.isin(wanted, [1.5, 7.5, 9.0])
    assert np.allclose(found[~curved], straight[~curved]) and np.allclose(found[curved], wanted[curved] ** 3)
    assert np.allclose(np.sum(weights, axis=1), 1.0)


def test_a_jump_of_readings_is_joined_by_straight_lines():
    time, values = np.arange(12.0), np.append(np.zeros(6), 1.5 - 0.1 * np.arange(6.0))
    found, _ = interpolated(time, values, time[:-1] + 0.5, 1.5)
    assert np.allclose(found, np.interp(time[:-1] + 0.5, time, values))


def test_readings_at_wobbling_times_leave_what_their_encoder_does():
    """Commands change between the samples; with linear interpolation, the value would be 0.51."""
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    rng, kept = np.random.default_rng(2), np.arange(1, len(log.measured) - 1, 2)
    path = {name: savgol_filter(log.measured[name].reshape(len(log.measured)), 9, 3) for name in ("q", "theta")}
    time = log.measured.time[kept] + np.append(0.1e-3, rng.uniform(-0.2e-3, 0.2e-3, len(kept) - 1))
    step = 4.0 * log.device.sensors.link_quantum
    read = {name: step * np.rint(np.interp(time, log.measured.time, each) / step) for name, each in path.items()}
    read["theta"] = read["theta"][:, None]
    segments = cut_log(JointLog("wobbling", log.device, Signals(time, read, log.measured.units), log.commands))
    assert not segments.averaged
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    left = problem.per_segment(problem.residual([problem.row(())])[0])
    assert 0.85 < float(np.mean(left)) < 1.15
