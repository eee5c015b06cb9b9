"""The interval in which fits of effects start that begin and end."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import log_of, rigid
from hypothesis import given
from hypothesis import strategies as st
from via_gap.candidates.fit import Fit, fit_device_parameters
from via_gap.candidates.intervals import best_interval, largest_sum
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect

START, STOP = 5.3, 8.1
PUSH = Effect("external_torque", "environment", {"torque": 0.06, "start": START, "stop": STOP})
SMALL = Effect("external_torque", "environment", {"torque": 0.01, "start": 0.0, "stop": 1e6})


@given(st.lists(st.integers(-9, 9), min_size=1, max_size=12))
def test_the_largest_sum_of_neighbours_is_that_of_all_pairs_of_ends(values):
    total, first, last = largest_sum(np.array(values, dtype=float))
    assert total == sum(values[first : last + 1])
    assert total == max(sum(values[a : b + 1]) for a in range(len(values)) for b in range(a, len(values)))


def pushed(push: Effect = PUSH, *others: Effect) -> tuple[ResidualModel, Fit, np.ndarray]:
    """The model of all segments of a log, the fit of its device parameters, and the beginnings of the segments."""
    segments = cut_log(log_of(rigid(), (push, *others), seed=33))
    model = ResidualModel.of([segments], [np.flatnonzero(segments.valid)], robust=True)
    begins = segments.time[segments.valid] - segments.log.measured.time[0]
    return model, fit_device_parameters(model), begins


def test_it_is_that_of_the_push():
    model, base, begins = pushed()
    ((start, stop),) = best_interval(model, base, SMALL, begins)
    assert (start, stop) == pytest.approx((START, STOP), abs=0.3)


@pytest.mark.parametrize("where", [2.0, 6.5, 11.0])
def test_a_segment_that_nothing_explains_does_not_hide_it(where):
    """One segment with an error a hundred times that of the push, outside of it or inside."""
    model, base, begins = pushed()
    (owner,) = np.nonzero(model.segment_of_value() == np.argmin(np.abs(begins - where)))
    residual = base.residual.copy()
    residual[owner] += 100.0 * np.abs(residual).max() * np.cos(np.arange(len(owner)))
    ((start, stop),) = best_interval(model, replace(base, residual=residual), SMALL, begins)
    assert (start, stop) == pytest.approx((START, STOP), abs=0.3)


def test_the_sign_of_the_push_counts():
    """A push one way and, later, one the other way are no single push."""
    back = {"torque": -0.06, "start": 8.6, "stop": 10.0}
    model, base, begins = pushed()
    other = model.residual([model.row([PUSH, Effect("external_torque", "environment", back)], base.offsets)])[0]
    alone = model.residual([model.row([PUSH], base.offsets)])[0]
    both = replace(base, residual=base.residual + other - alone)
    ((_, stop),) = best_interval(model, both, SMALL, begins)
    assert stop == pytest.approx(STOP, abs=0.3)


def test_none_is_given_without_a_gain_or_without_segments():
    model, base, begins = pushed()
    silent = replace(base, residual=np.zeros_like(base.residual))
    assert best_interval(model, silent, SMALL, begins) == ()
    assert best_interval(model, base, SMALL, begins[:1]) == ()
