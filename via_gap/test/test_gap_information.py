"""Hold-out by information: no log at rest is held out alone, and both sides contain comparable motion."""

from itertools import combinations

import numpy as np
import pytest
from via_gap.selection.information import SHARE, describe, hold_out, unlike


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


def held_part(information, held):
    """(k,) part of the total of each descriptor that is held out."""
    return information[held].sum(axis=0) / information.sum(axis=0)


@pytest.mark.parametrize("still", range(5))
def test_a_log_that_hardly_moves_does_not_judge_alone(still):
    amplitudes = np.ones(5)
    amplitudes[still] = 1e-3
    information, groups = swings(amplitudes)
    held = hold_out(information, groups)
    assert {groups[i] for i in held} != {f"log {still}"}
    assert np.all(np.abs(held_part(information, held) - SHARE) < 0.2)  # both sides have half of their share at least


def test_groups_are_not_torn_apart_and_nothing_is_lost():
    information, groups = swings(np.linspace(0.2, 1.0, 15))
    held = hold_out(information, groups)
    train = np.setdiff1d(np.arange(len(groups)), held)
    assert np.array_equal(held, np.unique(held))
    assert {groups[i] for i in train}.isdisjoint({groups[i] for i in held})
    assert np.all(np.abs(held_part(information, held) - SHARE) < 0.1)


def test_the_choice_is_the_best_of_all():
    """Of every proper choice of logs, one after the other; the largest difference counts first, then the mean."""
    information, groups = swings([1.0, 0.3, 0.8, 1e-3, 0.5], seed=3)

    def cost(logs):
        off = (held_part(information, np.isin(groups, list(logs))) - SHARE) ** 2
        return off.max(), off.mean()

    names = sorted(set(groups))
    every = [logs for size in range(1, 5) for logs in combinations(names, size)]
    held = {groups[i] for i in hold_out(information, groups)}
    assert cost(held) == pytest.approx(min(map(cost, every)))


def test_one_group_is_fitted_as_a_whole():
    information, groups = swings([1.0])
    assert len(hold_out(information, groups)) == 0
    assert len(hold_out(np.zeros((4, 7)), ["a", "a", "b", "b"])) == 0, "where nothing moves"


def test_unlike_is_the_part_of_the_motion_that_is_furthest_from_its_share():
    information, groups = swings([1.0, 0.1, 0.1])
    assert unlike(information, hold_out(information, groups)) > 0.35  # whatever is held out, one side hardly moves
    information, groups = swings([1.0, 0.9, 1.1])
    held = hold_out(information, groups)
    assert unlike(information, held) == pytest.approx(np.max(np.abs(held_part(information, held) - SHARE)))
    assert unlike(np.zeros((4, 7)), np.array([1])) == 0.0


def test_reversals_and_speed_are_counted():
    time = np.linspace(0.0, 1.0, 500)
    speed = np.array([np.cos(2.0 * np.pi * 3.0 * time), np.full(500, 1.0)])
    found = describe(np.cumsum(speed, axis=1) / 500.0, speed)
    assert list(found[:, 2]) == [6.0, 0.0]
    assert found[:, 3:].sum(axis=1) == pytest.approx(found[:, 0])
