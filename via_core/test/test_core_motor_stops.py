"""Where a mechanical stop may hold a motor: the angles reached, and the rests at their ends."""

import numpy as np
from via_core.motor_stops import reach_of, touched

TIME = 1e-3 * np.arange(2000)


def test_the_angles_reached_are_means_that_no_bounce_moves():
    theta = np.clip(np.sin(4.0 * TIME), -0.5, 0.5)
    theta[400:403] += 0.02
    low, high = reach_of(TIME, theta[:, None])
    assert abs(low[0] + 0.5) < 1e-9 and 0.5 - 1e-9 < high[0] < 0.501


def test_without_samples_or_time_nothing_is_reached():
    for time in (np.empty(0), np.zeros(3)):
        low, high = reach_of(time, np.zeros((len(time), 1)))
        assert low[0] == np.inf and high[0] == -np.inf
    assert np.all(np.isinf(reach_of(TIME, np.full((2000, 2), np.nan))))


def test_a_rest_at_an_end_is_touched_and_a_turning_point_is_not():
    theta = np.sin(4.0 * TIME)
    theta = np.where(theta > 0.5, 0.5, theta)  # rests at the upper end, turns at the lower one
    found = touched(TIME, theta, -1.0, 0.5)
    np.testing.assert_array_equal(found == 1.0, theta > 0.498)
    assert not np.any(found < 0.0)


def test_a_motor_that_never_moved_has_no_stop():
    assert not np.any(touched(TIME, np.full(2000, 0.3), 0.2999, 0.3001))
