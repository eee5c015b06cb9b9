"""Hold-out by information: no log at rest is held out alone, and both sides contain comparable motion."""

import numpy as np
import pytest
from via_gap.selection.information import LEAST, SHARE, describe, hold_out


def swings(amplitudes, per_log=4, seed=0):
    """Descriptors of short logs with the amplitudes given, several segments each, and the log of each segment."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 0.25, 100)
    angle, speed, groups = [], [], []
    for i, size in enumerate(amplitudes):
        for _ in range(per_log):
            w, phase = rng.uniform(8.0, 14.0), rng.uniform(0.0, 6.28)
            angle.append(size * np.sin(w * time + phase))
            speed.append(size * w * np.cos(w * time + phase))
            groups.append(f"log {i}")
    return describe(np.array(angle), np.array(speed)), groups


@pytest.mark.parametrize("still", range(5))
def test_a_log_that_hardly_moves_does_not_judge_alone(still):
    amplitudes = np.ones(5)
    amplitudes[still] = 1e-3
    information, groups = swings(amplitudes)
    chosen = hold_out(information, groups)
    held_logs = {groups[i] for i in chosen.held}
    assert held_logs != {f"log {still}"}
    assert chosen.enough
    assert np.all(np.abs(chosen.shares - SHARE) < 0.25)


def test_groups_are_not_torn_apart_and_nothing_is_lost():
    information, groups = swings(np.linspace(0.2, 1.0, 15))
    chosen = hold_out(information, groups)
    assert {groups[i] for i in chosen.train}.isdisjoint({groups[i] for i in chosen.held})
    assert np.array_equal(np.sort(np.concatenate((chosen.train, chosen.held))), np.arange(len(groups)))
    assert np.all(np.abs(chosen.shares - SHARE) < 0.1)


def test_one_moving_log_among_still_ones_is_not_enough():
    information, groups = swings([1.0, 1e-3, 1e-3])
    chosen = hold_out(information, groups)
    assert not chosen.enough
    assert chosen.shares.min() < LEAST * SHARE or chosen.shares.max() > 1.0 - LEAST * SHARE


def test_one_group_is_fitted_as_a_whole():
    information, groups = swings([1.0])
    chosen = hold_out(information, groups)
    assert len(chosen.held) == 0 and len(chosen.train) == 4 and not chosen.enough


def test_reversals_and_speed_are_counted():
    time = np.linspace(0.0, 1.0, 500)
    speed = np.array([np.cos(2.0 * np.pi * 3.0 * time), np.full(500, 1.0)])
    found = describe(np.cumsum(speed, axis=1) / 500.0, speed)
    assert list(found[:, 2]) == [6.0, 0.0]
    assert found[:, 3:].sum(axis=1) == pytest.approx(found[:, 0])
