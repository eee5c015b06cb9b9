"""Rows before and after a gap: no common sample, and what may have changed during the gap."""

from dataclasses import replace

import numpy as np
import pytest
from via_core.status import Status
from via_estimators import coloured
from via_estimators.modulated_stiffness import ModulatedStiffness, ModulatedStiffnessParameters
from via_estimators.modulated_torque import ModulatedTorque, ModulatedTorqueParameters

WINDOW, UNKNOWNS, PERIOD = 50, 3, 2e-3
PLAIN = ModulatedTorqueParameters(
    transmissions=1, window=WINDOW, order=2, torque_noise=0.05, position_noise=0.0, truncation=0.0
)
KNOWN_MOTOR = ModulatedStiffnessParameters(
    transmissions=1,
    window=WINDOW,
    sampling=PERIOD,
    motor_inertia_1=0.02,
    motor_damping_1=0.3,
    torque_noise=0.05,
    position_noise=0.0,
)


def log(start, count, stiffness, seed):
    """Rows (count, 4) of one motor in prescribed motion, from `start` [s]; B .02, D .3, noise .05 N m on the torque."""
    t = start + PERIOD * np.arange(count)
    theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t)
    q = 0.5 * np.sin(4.0 * t)
    middle = t - 0.5 * PERIOD  # a torque held over the interval that ends at its stamp
    rate = 2.1 * np.cos(7.0 * middle) + 2.6 * np.cos(13.0 * middle)
    bend = -14.7 * np.sin(7.0 * middle) - 33.8 * np.sin(13.0 * middle)
    pull = 0.5 * np.sin(4.0 * middle) - 0.3 * np.sin(7.0 * middle) - 0.2 * np.sin(13.0 * middle)
    torque = 0.02 * bend + 0.3 * rate - stiffness * pull
    return np.column_stack([t, q, theta, torque + 0.05 * np.random.default_rng(seed).normal(size=count)])


def middles(state):
    return coloured.middles(state[len(state) - coloured.size(UNKNOWNS, WINDOW + 1) :], UNKNOWNS)


def test_covariances_of_rows_on_both_sides_of_a_gap_add():
    first, second = log(0.0, 120, 8.0, 1), log(1.0, 120, 8.0, 2)
    estimator = ModulatedStiffness(KNOWN_MOTOR)
    both, one, other = (
        middles(estimator.run_rows(rows)[0]) for rows in (np.concatenate([first, second]), first, second)
    )
    np.testing.assert_allclose(both, one + other, rtol=1e-6, atol=1e-6 * np.abs(both).max())


@pytest.mark.parametrize(("gap", "share"), [(0.1, 0.45), (20.0, 0.0)])
def test_forgetting_continues_during_a_gap(gap, share):
    """A spring exchanged during the gap: after 20 s with a memory of 1 s the leak's target alone remains of it."""
    first = log(0.0, 1500, 20.0, 1)
    second = log(first[-1, 0] + gap, 500, 8.0, 2)
    estimator = ModulatedStiffness(replace(KNOWN_MOTOR, memory=1.0))
    both = estimator.run_rows(np.concatenate([first, second]))[1]
    alone = estimator.run_rows(second)[1]
    left = (both.value[-1, 0] - alone.value[-1, 0]) / 12.0
    assert left == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize("gap", [0.1, 20.0])
def test_the_default_follows_a_spring_exchanged_during_a_gap(gap):
    first = log(0.0, 1500, 20.0, 1)
    second = log(first[-1, 0] + gap, 1000, 8.0, 2)
    found = ModulatedTorque(PLAIN).run_rows(np.concatenate([first, second]))[1]
    value, sd, status = found.value[:, 0], found.standard_deviation[:, 0], found.status
    later = np.arange(len(value)) >= 1500 + 250
    assert (status[later] == Status.OK).mean() > 0.7
    assert np.mean(np.abs(value - 8.0)[later] <= 1.96 * sd[later]) > 0.85
    assert np.abs(value[-1] - 8.0) < 0.2
    assert np.abs(value[1499] - 20.0) < 0.2
