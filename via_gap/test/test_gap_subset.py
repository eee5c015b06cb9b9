"""What a search looks at: some segments stand for all, those with the largest errors among them."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of, servo
from via_gap.candidates.subset import BUSIEST, EVEN, subset
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect

KNOCK = Effect("external_torque", "environment", {"torque": 0.1, "start": 12.1, "stop": 12.4})
FRICTION = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)


@pytest.fixture(scope="module")
def problem() -> ResidualModel:
    segments = cut_log(log_of(flexible(), (KNOCK,), seed=6, duration=24.0, tolerance=0.0))
    return ResidualModel.of([segments], [np.arange(len(segments))])


def test_a_part_leaves_what_the_whole_leaves_of_the_same_shots(problem):
    rows = [problem.row([]), problem.row([FRICTION])]
    part, indices = problem.part([np.array([0, 7, 8, 9, 40])])
    assert np.max(np.abs(part.residual(rows) - problem.residual(rows)[:, indices])) < 1e-6
    assert part.size == len(indices) == 5 * problem.views[0].size


def test_the_importance_of_segments_weighs_their_loss_and_follows_them_into_a_part(problem):
    both = ResidualModel.of([problem.views[0].segments] * 2, [np.arange(50), np.arange(60)], robust=True)
    importance = np.linspace(0.1, 2.0, 110)
    weighted = replace(both, importance=importance)
    residual = both.residual([both.row([FRICTION])])[0]
    assert np.allclose(weighted.losses(residual), importance * both.losses(residual))
    assert weighted.loss(residual) == pytest.approx(importance @ both.losses(residual))
    squared = (weighted.weights(residual) / both.weights(residual)) ** 2
    assert np.allclose(squared, importance[both.segment_of_value()])
    kept = [np.array([3, 20]), np.array([0, 7, 59])]
    part, indices = weighted.part(kept)
    assert np.array_equal(part.importance, importance[[3, 20, 50, 57, 109]])
    assert np.allclose(part.losses(residual[indices]), weighted.losses(residual)[[3, 20, 50, 57, 109]])


def test_shots_in_one_call_are_those_of_calls_of_their_own(problem):
    view = problem.views[0]
    rows = np.stack([problem.row([]), problem.row([FRICTION])])
    together = problem.residual(list(rows))
    for k, row in enumerate(rows):
        assert np.max(np.abs(problem.residual([row])[0] - together[k])) < 1e-6
    assert together.shape == (2, len(view.chosen) * view.size)


def test_the_shots_with_the_largest_errors_are_looked_at(problem):
    residual = problem.residual([problem.row([])])[0]
    few, indices = subset(problem, residual)
    chosen = few.views[0].chosen
    assert EVEN <= len(chosen) <= EVEN + BUSIEST
    worst = np.argsort(problem.per_segment(residual))[-2:]
    assert set(worst) <= set(chosen)
    assert chosen[0] == 0 and chosen[-1] >= len(problem.views[0].chosen) - 2
    assert np.allclose(few.per_segment(residual[indices]), problem.per_segment(residual)[chosen])


def test_ten_times_the_log_is_searched_on_no_more():
    segments = cut_log(log_of(flexible(), (KNOCK,), seed=6, duration=24.0, tolerance=0.0))
    many = ResidualModel.of([segments] * 5, [np.arange(len(segments))] * 5)
    few, _ = subset(many, np.ones(many.size))
    assert sum(len(view.chosen) for view in few.views) <= EVEN + BUSIEST


def test_short_logs_and_servos_are_searched_on_whole():
    for log in (log_of(flexible(), seed=5, duration=6.0), log_of(servo(), seed=5, duration=12.0)):
        segments = cut_log(log)
        whole = ResidualModel.of([segments], [np.arange(len(segments))])
        few, indices = subset(whole, np.ones(whole.size))
        assert few is whole and len(indices) == whole.size
