"""Runs of several logs in the same blocks of lanes: each as if it were alone, whatever its length."""

import numpy as np
import pytest
from gap_logs import flexible, log_of, servo
from via_gap.residual import legs
from via_gap.residual.rollout import Rollout, residuals
from via_gap.residual.segments import cut_log, whole_log
from via_gap.residual.threads import THREADS, per_call
from via_sim.effects import Effect
from via_sim.lockstep.pack import LANES

EFFECTS = (
    Effect("coulomb_friction", "link", {"torque": 0.02}),  # its lanes leave the block when the link stops
    Effect("actuator_lag", "command", {"time_constant": 0.1}),  # its state goes on from segment to segment
)


def models(case):
    """A rollout of each of several logs: whole runs of different length, or chains of segments in parts of a log."""
    if case == "whole runs":
        segments = [whole_log(log_of(servo(), seed=seed, duration=1.0 + 0.3 * seed)) for seed in range(1, 5)]
        return [Rollout.of(each, np.arange(1)) for each in segments]
    cut = [cut_log(log_of(flexible(), seed=seed, duration=2.0 + seed)) for seed in range(1, 4)]
    return [Rollout.of(each, np.array([0, 1, 4, 5, 6])) for each in cut]


@pytest.mark.parametrize("case", ["whole runs", "segments"])
def test_logs_side_by_side_have_the_bits_of_each_alone(case, monkeypatch):
    views = models(case)
    calls = []
    compute = legs._compute
    monkeypatch.setattr(legs, "_compute", lambda some: (calls.append(len(some)), compute(some)))
    rows = []
    for view in views:
        nominal = view.segments.nominal
        loaded = nominal.copy()
        for effect in EFFECTS:
            effect.write(loaded)
        rows.append(np.stack([nominal, loaded]))
    together = residuals(views, rows)
    assert max(calls) > 1  # they did share a block
    for view, own, found in zip(views, rows, together, strict=True):
        assert np.array_equal(found, view.residual(own))
        assert not np.array_equal(found[0], found[1])


def test_a_block_is_filled_before_another_begins():
    for runs in range(1, 200):
        size = per_call(runs, LANES)
        assert size % LANES == 0
        calls, blocks = -(-runs // size), -(-runs // LANES)
        assert calls >= min(THREADS, blocks)  # no thread waits for one that has several
        assert sum(-(-min(size, runs - k) // LANES) for k in range(0, runs, size)) == blocks


def test_a_state_continues_only_into_the_segment_that_follows():
    """With a gap between them, segments are two chains, although nothing else was chosen between them."""
    begins = np.array([0, 100, 200, 350, 450, 600])
    chains, runs = legs.runs_of(begins, 100, np.array([True, False]))
    continued = chains[runs[runs[:, 0] == 0, 1]]
    assert sorted(continued.tolist()) == [[0, 3], [3, 2], [5, 1]]
    alone = chains[runs[runs[:, 0] == 1, 1]]
    assert sorted(alone.tolist()) == [[k, 1] for k in range(6)]
