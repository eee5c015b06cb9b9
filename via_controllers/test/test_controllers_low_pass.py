"""Velocities from angles: the step response of a low pass, for one axis and for a table of axes."""

import numpy as np
import pytest
from via_controllers.low_pass import low_passed

BANDWIDTH, STEP = 50.0, 1e-3


@pytest.mark.parametrize("filtered", [low_passed, low_passed.py_func], ids=["compiled", "checked by Python"])
@pytest.mark.parametrize("shape", [(3,), (2, 4), (4, 2)])
def test_velocities_rise_to_that_of_a_ramp_within_the_time_constant(shape, filtered):
    """Compiled code does not notice an index beyond an array; Python does."""
    speed = np.linspace(-2.0, 3.0, np.prod(shape)).reshape(shape)
    velocity, angle = np.zeros(shape), np.zeros(shape)
    for _ in range(40):
        now = angle + STEP * speed
        velocity, angle = filtered(velocity, angle, now, STEP, BANDWIDTH), now
    np.testing.assert_allclose(velocity, speed * (1.0 - np.exp(-40 * STEP * BANDWIDTH)), rtol=1e-9)


def test_without_time_they_stay():
    velocity = np.array([1.0, -2.0])
    kept = low_passed(velocity, np.zeros(2), np.ones(2), 0.0, BANDWIDTH)
    assert kept.tolist() == velocity.tolist() and kept is not velocity
