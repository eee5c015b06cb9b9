"""Rows before and after a gap: no common sample, and forgetting during the gap."""

from dataclasses import replace

import numpy as np
import pytest
from via_core.status import Status
from via_estimators import coloured
from via_estimators.modulated_torque import ModulatedTorque, ModulatedTorqueParameters

WINDOW, UNKNOWNS, PERIOD = 50, 4, 2e-3
PLAIN = ModulatedTorqueParameters(
    transmissions=1, window=WINDOW, order=2, memory=1e9, torque_noise=0.05, position_noise=0.0, truncation=0.0
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
    estimator = ModulatedTorque(PLAIN)
    both, one, other = (
        middles(estimator.run_rows(rows)[0]) for rows in (np.concatenate([first, second]), first, second)
    )
    np.testing.assert_allclose(both, one + other, rtol=1e-6, atol=1e-6 * np.abs(both).max())


@pytest.mark.parametrize(("gap", "share"), [(0.1, 0.35), (20.0, 0.0)])
def test_forgetting_continues_during_a_gap(gap, share):
    """A spring exchanged during the gap: after 20 s with a memory of 1 s the old one is forgotten."""
    first = log(0.0, 1500, 20.0, 1)
    second = log(first[-1, 0] + gap, 500, 8.0, 2)
    estimator = ModulatedTorque(replace(PLAIN, memory=1.0))
    both = estimator.run_rows(np.concatenate([first, second]))[1]
    alone = estimator.run_rows(second)[1]
    after = both.status[1500:] == Status.OK
    assert after.sum() > 400
    left = (both.value[-1, 0] - alone.value[-1, 0]) / 12.0
    assert left == pytest.approx(share, abs=0.15 if share else 1e-6)
    if not share:
        begin = int(np.flatnonzero(after)[0])
        assert both.standard_deviation[1500 + begin, 0] > 5.0 * both.standard_deviation[1499, 0]
