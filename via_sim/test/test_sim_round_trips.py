"""Round trips are counted once per sample, and their percentiles are those of the times."""

import numpy as np
import pytest
from via_sim.nodes import round_trips
from via_sim.nodes.round_trips import LONGEST, RECENT, RESOLUTION, RoundTrips


@pytest.fixture
def clock(monkeypatch):
    """The time now [ns], in a list."""
    now = [0]
    monkeypatch.setattr(round_trips.time, "perf_counter_ns", lambda: now[0])
    return now


def test_percentiles_are_those_of_the_times(clock):
    times, trips = np.random.default_rng(0).integers(100_000, 9_000_000, 1000), RoundTrips()
    for stamp, passed in enumerate(times.tolist()):
        trips.sent(stamp)
        clock[0] += passed
        trips.answered(stamp)
    assert trips.count == 1000 and trips.largest == pytest.approx(1e-6 * times.max())
    for share in (1.0, 50.0, 99.0, 100.0):
        exact = 1e-6 * np.percentile(times, share, method="inverted_cdf")
        assert exact <= trips.percentile(share) <= exact + 1e-6 * RESOLUTION


def test_a_sample_counts_once_and_an_unknown_or_old_one_not(clock):
    trips = RoundTrips()
    assert np.isnan(trips.percentile(50.0))
    for stamp in range(RECENT + 1):
        trips.sent(stamp)
    for stamp in (5, 5, 0, -1):
        trips.answered(stamp)
    assert trips.count == 1


def test_a_time_beyond_the_histogram_is_the_largest(clock):
    trips = RoundTrips()
    trips.sent(1)
    clock[0] = 3 * RESOLUTION * LONGEST
    trips.answered(1)
    assert trips.largest == pytest.approx(3e-6 * RESOLUTION * LONGEST)
