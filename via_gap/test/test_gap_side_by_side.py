"""Fits that take their steps side by side: each as if it were alone, ended early by the same rivals."""

from functools import cache

import numpy as np
import pytest
from gap_logs import flexible, log_of
from gap_models import BACKLASH, COULOMB, DAMPING, INERTIA, VISCOUS
from via_gap.candidates.fit import fit_device_parameters
from via_gap.candidates.refinement import FINISHING, GIVE_UP, raced, refine, refine_all
from via_gap.candidates.scales import scales_of
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect

PLANTED = Effect("coulomb_friction", "motor", {"torque": 0.1}, 1)
LAG = Effect("actuator_lag", "command", {"time_constant": 0.01})
STARTS = [(BACKLASH, [0.01]), (COULOMB, [0.05]), (DAMPING, [0.05]), (INERTIA, [0.001]), (VISCOUS, [0.05])]


@cache
def problem():
    segments = cut_log(log_of(flexible(), (PLANTED,), seed=3, duration=4.0, tolerance=0.0))
    model = ResidualModel.of([segments], [np.arange(1, len(segments))])
    base = fit_device_parameters(model)
    scales = scales_of([segments], [None])
    return model, [(base, [start]) for start in STARTS], scales


def same(one, other):
    assert one.locations == other.locations
    assert one.values == pytest.approx(other.values, rel=1e-6)
    assert one.loss == pytest.approx(other.loss, rel=1e-6)
    assert one.sd == pytest.approx(other.sd, rel=1e-4)


def test_fits_side_by_side_end_where_each_ends_alone():
    model, starts, scales = problem()
    for together, (base, members) in zip(refine_all(model, starts, scales, FINISHING), starts, strict=True):
        same(together, refine(model, base, members, scales, FINISHING))


@pytest.mark.parametrize("cause_first", [True, False])
def test_only_slow_fits_far_above_an_earlier_one_end_early(cause_first):
    """Whatever the order: a fit is never ended by a later one, though that may have ended before."""
    model, starts, scales = problem()
    order = sorted(starts, key=lambda start: (start[1][0][0] == COULOMB) != cause_first)
    alone = [refine(model, *each, scales) for each in order]
    found = raced(model, order, scales)
    assert len(found) == len(order)
    rivals = [min((fit.loss for fit in found[:k]), default=np.inf) for k in range(len(found))]
    for fit, whole, rival in zip(found, alone, rivals, strict=True):
        if whole.loss <= GIVE_UP * rival:
            same(fit, whole)
        else:
            assert fit.locations == whole.locations and fit.loss >= whole.loss * (1.0 - 1e-6)
    early = [fit.loss > whole.loss * (1.0 + 1e-9) for fit, whole in zip(found, alone, strict=True)]
    assert not early[0] and any(early) == cause_first


def test_a_segment_is_simulated_alike_alone_and_behind_others():
    """Rows without a lag begin anew in each segment; the lag of others goes on from the segment before."""
    model, _, _ = problem()
    (view,) = model.views
    assert isinstance(view, Rollout)
    rows = np.stack([view.segments.nominal, view.segments.nominal])
    LAG.write(rows[1])
    whole, last = view.motion(rows), view.part(np.array([len(view.chosen) - 1])).motion(rows)
    assert np.array_equal(whole[0, -1], last[0, 0])
    assert whole[1, -1] == pytest.approx(last[1, 0], abs=1e-3)
    assert not np.allclose(whole[1, -1], whole[0, -1], atol=1e-6)


def test_the_lag_of_a_drive_goes_on_from_segment_to_segment():
    segments = cut_log(log_of(flexible(), (LAG,), seed=3, duration=4.0, tolerance=0.0))
    model = ResidualModel.of([segments], [np.arange(1, len(segments))])
    left = model.per_segment(model.residual([model.row((LAG,))])[0])
    assert np.mean(left) < 1.5
