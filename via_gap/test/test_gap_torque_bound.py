"""The bound of inverse dynamics: torques that repeat with the motion are explained by any name; noise is not."""

from __future__ import annotations

import numpy as np
import pytest
from gap_logs import log_of, rigid
from via_core.signals import Array
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.segments import cut_log
from via_gap.selection.torque_bound import torque_bound
from via_sim.effects import Effect

DRAG = Effect("quadratic_drag", "link", {"coefficient": 0.05})
RIPPLE = Effect("torque_ripple", "motor", {"amplitude": 0.05, "order": 11.0, "phase": 0.3}, 1)


def sides(*effects: Effect) -> tuple[InverseDynamics, InverseDynamics]:
    """The segments fitted and those held out of one log."""
    segments = cut_log(log_of(rigid(), effects, seed=8, duration=16.0, tolerance=0.0))
    every = np.flatnonzero(segments.valid)
    held = every % 5 == 2
    return InverseDynamics.of(segments, every[~held]), InverseDynamics.of(segments, every[held])


def of(view: InverseDynamics) -> Array:
    """(C, w a) missing torque under the nominal device."""
    return view.residual(view.nominal[None])[0]


@pytest.mark.parametrize("effect", [DRAG, RIPPLE], ids=["smooth", "periodic"])
def test_a_torque_that_repeats_with_the_motion_is_explained(effect):
    fitted, held = sides(effect)
    before = float(np.mean(of(held) ** 2))
    bound = torque_bound([fitted], [of(fitted)], [held], [of(held)])
    assert bound.shape == (len(held.chosen),)
    assert before > 20.0
    assert float(np.mean(bound)) < 0.1 * before


def test_noise_is_not_explained_nor_made_much_larger():
    fitted, held = sides()
    rng = np.random.default_rng(6)
    noise = [3.0 * rng.normal(size=of(view).shape) for view in (fitted, held)]
    bound = torque_bound([fitted], [noise[0]], [held], [noise[1]])
    assert float(np.mean(bound)) == pytest.approx(float(np.mean(noise[1] ** 2)), rel=0.15)
