"""Local polynomials where samples were lost, beside the slow version."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import log_of, rigid
from via_core.signals import Signals
from via_gap.logs.quality import SPANS, assessed
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments, cut_log
from via_gap.residual.smoothing import local_fit, smoothed

HALF = 12


@pytest.mark.parametrize(("order", "derivative"), [(2, 0), (2, 1), (3, 1)])
def test_a_fit_is_that_of_the_known_values_alone(order, derivative):
    rng = np.random.default_rng(3)
    values, known = rng.normal(size=200), rng.random(200) > 0.4
    known[80:120] = False
    fit, sd = local_fit(values, known, HALF, order, derivative)
    at = np.arange(200.0)
    for tick in range(200):
        near = np.flatnonzero(known & (np.abs(at - tick) <= HALF))
        powers = ((at[near] - tick) / HALF)[:, None] ** np.arange(order + 1)
        if len(near) <= order:
            assert np.isinf(sd[tick])
            continue
        inverse = np.linalg.pinv(powers)
        assert fit[tick] == pytest.approx(inverse[derivative] @ values[near], rel=1e-6, abs=1e-8)
        assert sd[tick] == pytest.approx(np.linalg.norm(inverse[derivative]), rel=1e-6)


def test_with_every_sample_it_is_the_filter_of_savitzky_and_golay():
    time = np.arange(300) / 1000.0
    angles = np.sin(20.0 * time)[:, None]
    known = np.ones(angles.shape, dtype=bool)
    states, sd = smoothed(angles, known, (0,), HALF, np.zeros(1), 1)
    known[-1] = False
    same, _ = smoothed(angles, known, (0,), HALF, np.zeros(1), 1)
    inside = slice(HALF, -HALF - 1)
    assert np.allclose(states[inside][:, [0, 3]], same[inside][:, [0, 3]], rtol=1e-9, atol=1e-12) and not sd.any()


def test_late_samples_leave_the_long_segments_of_a_position_drive():
    """A quarter of the samples late by up to five periods: no stretch of .75 s is free of them."""
    log = log_of(rigid(), (), seed=8, duration=12.0, tolerance=0.0)
    rng = np.random.default_rng(2)
    keep = np.ones(len(log.measured), dtype=bool)
    for first in np.flatnonzero(rng.random(len(keep)) < 0.03):
        keep[first : first + rng.integers(1, 9)] = False
    channels = {name: values[keep] for name, values in log.measured.channels.items()}
    late = replace(log, measured=Signals(log.measured.time[keep], channels, log.measured.units))
    segments = cut_log(late, SPANS["position"], assessed(late))
    assert segments.valid.mean() > 0.8 and 0.1 < np.mean(segments.weight == 0.0) < 0.5
    problem = ResidualModel.of([cut_log(late, quality=assessed(late))], [np.arange(1, 40)])
    assert np.median(problem.per_segment(problem.residual([problem.row(())])[0])) < 1.5


def test_a_segment_needs_eight_values_and_samples_around_its_start():
    log = log_of(rigid(), (), seed=8, duration=12.0, tolerance=0.0)
    whole = cut_log(log)
    span = whole.ticks / whole.rate

    def without(begin: float, end: float) -> Segments:
        """Cut without the samples in an interval, in segments from the beginning of segment 8."""
        time, first = log.measured.time, whole.time[8]
        keep = (time <= first + begin * span) | (time >= first + end * span)
        channels = {name: values[keep] for name, values in log.measured.channels.items()}
        cut = cut_log(replace(log, measured=Signals(time[keep], channels, log.measured.units)))
        assert cut.valid.sum() >= len(cut) - 2
        return cut

    def valid(begin: float, end: float) -> list[bool]:
        cut = without(begin, end)
        np.testing.assert_array_equal(cut.begin, whole.begin)
        return cut.valid[8:10].tolist()

    assert valid(0.3, 0.7) == [True, True]
    assert valid(0.2, 0.8) == [True, True]  # two fifths of a segment: 24 values
    assert valid(0.1, 0.95) == [True, True]  # nine
    assert valid(0.08, 0.95) == [False, True]  # seven
    later = without(0.8, 1.2)  # nothing at the start of the next one
    assert later.valid.all()
    assert whole.time[8] + 1.2 * span < later.time[9] < whole.time[8] + 1.4 * span


def test_segments_begin_where_the_state_is_known():
    """Gaps of 100 ms every .45 s in a log of 100 Hz: a third of fixed beginnings would be in or beside a gap."""
    log = log_of(rigid(), (), seed=8, duration=24.0, tolerance=0.0)
    time = log.measured.time
    keep = (np.arange(len(time)) % 5 == 0) & ((time - time[0]) % 0.45 < 0.35)
    channels = {name: values[keep] for name, values in log.measured.channels.items()}
    cut = cut_log(replace(log, measured=Signals(time[keep], channels, log.measured.units)))
    assert cut.valid.all() and np.all(np.diff(cut.begin) >= cut.ticks) and not np.any(cut.begin % cut.every)
    assert np.any(np.diff(cut.begin) == cut.ticks), "segments follow on one another where they can"
    inside = cut.begin[:, None] + np.arange(cut.ticks)
    assert np.array_equal(cut.since_begin[inside], inside - cut.begin[:, None])
    assert np.all(np.delete(cut.since_begin, inside) >= cut.ticks), "between segments"
    assert np.sum(cut.valid) * cut.ticks > 0.9 * len(cut.commands)
    problem = ResidualModel.of([cut], [np.arange(1, len(cut))])
    assert np.median(problem.per_segment(problem.residual([problem.row(())])[0])) < 1.5
