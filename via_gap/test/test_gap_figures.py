"""The numbers behind the pictures: planted friction is read off the residual, and errors are those of the gap."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_logs import flexible, log_of, servo
from via_gap.candidates.fit import Fit
from via_gap.report.binning import BINS
from via_gap.report.error_figures import POINTS, error_figures, trace_figures
from via_gap.report.evidence_figures import LONGEST
from via_gap.report.simulated_intervals import SimulatedInterval, free_intervals, segment_intervals
from via_gap.report.torque_figures import amplitudes, missing_torques, order_spectra, residual_figures
from via_gap.residual.errors import free_errors, segment_errors
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect

COULOMB = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)


@cache
def friction():
    """Segments of a joint whose every number is right but for friction at its motor."""
    return cut_log(log_of(flexible(), (COULOMB,), seed=23, tolerance=0.0))


@cache
def two_residuals():
    """A problem of every third pair of segments, with the residuals of the nominal device and of the true one."""
    segments = friction()
    chosen = np.flatnonzero(segments.valid)
    problem = ResidualModel.of([segments], [chosen[chosen % 3 < 2]])
    return problem, *problem.residual([problem.row(()), problem.row((COULOMB,))])


def interval(error, restarts=None, begin=0.0) -> SimulatedInterval:
    """A link that stands at zero, simulated `error` beside it, every 10 ms."""
    n = len(error)
    time = begin + 0.01 * np.arange(n)
    states = np.zeros((n, 6))
    marks = np.zeros(n, dtype=bool) if restarts is None else np.asarray(restarts)
    nothing = np.zeros((n, 1))
    before = np.asarray(error)[:, None]
    return SimulatedInterval("log", (0,), time, states, nothing, before, nothing, marks, np.array([1e-3]))


def fit_of(*effects) -> Fit:
    return Fit(effects, np.zeros(len(two_residuals()[0].nuisances)), 0.0, np.empty(0), np.empty((0, 0)))


@cache
def missing():
    return missing_torques([friction()], fit_of(), fit_of(COULOMB))


def test_missing_friction_brakes_at_every_speed_until_it_is_added():
    figures = {(f.equation, f.by): f for f in residual_figures(missing(), 1)}
    assert {by for _, by in figures} == {"speed", "deflection", "angle", "motor angle", "time"}
    moving = [b for b in figures["motor 1", "speed"].bins if b.low > 0.2]
    assert len(moving) >= BINS // 2
    for each in moving:
        assert each.low <= each.centre <= each.high
        assert each.before == pytest.approx(-0.03, rel=0.05)
        assert each.before_rms >= abs(each.before) and each.floor < 0.01
        assert abs(each.after) < 0.1 * abs(each.before)
    assert all(abs(b.before) < 3.0 * b.floor for b in figures["link", "speed"].bins)


def test_bins_hold_every_window_once():
    (link, _) = missing()
    (angle,) = (f for f in residual_figures([link], 1) if f.by == "angle")
    whole = float(np.mean(link.before**2))
    assert np.mean([b.before_rms**2 for b in angle.bins]) == pytest.approx(whole, rel=0.02)  # bins of equal count
    assert all(a.high == b.low for a, b in zip(angle.bins, angle.bins[1:], strict=False))


def test_amplitudes_of_a_sum_of_sinusoids():
    angle = np.linspace(0.0, 6.0 * np.pi, 4000)
    values = 0.2 + 0.03 * np.sin(7.0 * angle + 0.4) + 0.01 * np.cos(12.0 * angle)
    found = amplitudes(angle, np.stack([values, 2.0 * values], axis=1), np.array([3.0, 7.0, 12.0]))
    assert found[0] == pytest.approx([0.0, 0.03, 0.01], abs=1e-3)
    assert found[1] == pytest.approx(2.0 * found[0])


def test_noise_alone_stays_below_the_level_of_a_spectrum():
    (link, _) = missing()
    rng = np.random.default_rng(7)
    angle = np.cumsum(rng.uniform(0.0, 0.02, 3000))
    states = np.zeros((3000, 6))
    states[:, 0] = angle
    noise, planted = 0.01 * rng.standard_normal((2, 3000))
    planted = planted + 0.02 * np.sin(7.0 * angle)
    only = replace(link, time=angle, states=states, before=planted, after=noise, floor=np.full(3000, 0.01), stride=1.0)
    (spectrum,) = order_spectra([only])
    above = np.array(spectrum.after) > spectrum.level
    assert above.mean() < 0.12  # 5 % expected
    assert spectrum.orders[int(np.argmax(spectrum.before))] == 7.0
    assert max(spectrum.before) == pytest.approx(0.02, rel=0.1)


def test_orders_that_the_motion_does_not_hold_once_are_left_out():
    turned = float(np.ptp(friction().start[:, 1])) / (2.0 * np.pi)
    spectra = {each.equation: each for each in order_spectra(missing())}
    assert spectra["motor 1"].orders[0] >= 1.0 / turned
    (link, _) = missing()
    unseen = replace(link, states=np.full_like(link.states, np.nan))
    assert order_spectra([unseen]) == ()


def test_errors_of_segments_are_those_of_the_gap():
    problem, before, after = two_residuals()
    intervals = segment_intervals(problem, before, after)
    for which, residual in (("before", before), ("after", after)):
        gap = segment_errors(problem, residual)
        error = np.concatenate([getattr(s, which) - s.measured for s in intervals])
        assert np.sqrt(np.mean(error**2, axis=0) / gap.variance) == pytest.approx(gap.signals, rel=1e-9)
    assert sum(s.restarts.sum() for s in intervals) == len(problem.views[0].chosen)
    assert len(intervals) > 3 and all(s.restarts[0] for s in intervals)


def test_error_figures_fall_where_the_effect_is_added():
    problem, before, after = two_residuals()
    figures = error_figures(segment_intervals(problem, before, after), 1)
    expected = {(s, by) for s in ("q", "theta_1") for by in ("speed", "deflection", "angle", "time")}
    assert {(f.signal, f.by) for f in figures} == {*expected, ("theta_1", "motor angle")}
    assert all(b.after < 0.2 * b.before for f in figures for b in f.bins)


def test_errors_of_a_free_run_are_those_of_the_gap():
    segments = cut_log(log_of(servo(), (Effect("coulomb_friction", "link", {"torque": 0.02}),), seed=5, duration=5.9))
    every = [np.arange(len(segments))]
    device = segments.log.device
    intervals = free_intervals(device, device, (), [segments], every)
    gap = free_errors(device, (), [segments], every)
    error = np.concatenate([s.before - s.measured for s in intervals])
    assert np.sqrt(np.mean(error**2)) == pytest.approx(float(gap.signals[0] * np.sqrt(gap.variance[0])), rel=0.03)
    assert all(np.array_equal(s.before, s.after) for s in intervals)
    assert {f.by for f in error_figures(intervals, 1)} >= {"speed", "angle", "time"}


def test_the_worst_stretch_is_drawn_first_and_in_few_points():
    quiet, loud = 0.001 * np.ones(3000), 0.5 * np.ones(3000)
    figures = trace_figures([interval(quiet), interval(loud, begin=100.0)], 5.0)
    assert [f.worst for f in figures] == ["after", "before", "after"]
    assert figures[1].time[0] >= 100.0  # the largest error before
    assert all(len(f.time) <= POINTS and f.time[-1] - f.time[0] <= 5.0 for f in figures)


def test_a_stretch_is_cut_where_a_segment_begins():
    restarts = np.arange(1000) % 25 == 0
    (first, *_) = trace_figures([interval(np.ones(1000), restarts)], LONGEST["segments"])
    assert first.time[-1] - first.time[0] <= LONGEST["segments"]
    begins = np.array(first.time)[list(first.restarts)]
    assert np.allclose(np.diff(begins), 0.25) and len(begins) >= 6
