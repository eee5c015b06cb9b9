"""Runs of arms unlike the controller's model: measured in the modes and states of the arm that moved."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh
from via_bringup.demo.reference import ARM, EQUILIBRIUM, LEVEL, STIFFNESS
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_validation.control.limit_cycle import in_modes, limit_cycle_controller, start
from via_validation.control.model_error import ModelError, run_with_error
from via_validation.tables import model_errors

AMPLITUDE, ALONG = np.sqrt(2.0 * LEVEL), 1e-6  # [sqrt(kg m^2) rad], [s]


def modal(arm: VsaArm, q: Array) -> tuple[Array, Array]:
    """|z| and lambda (n,) at `q` (n,), softest first, by a general solver."""
    values, W = eigh(STIFFNESS, arm.inertia(q))
    return np.abs(np.linalg.solve(W, q - EQUILIBRIUM)), values


@pytest.mark.parametrize("key", ["payload50", "encoders14"])
def test_H_and_leak_are_those_of_the_real_arm(monkeypatch, key):
    monkeypatch.setattr(model_errors, "DURATION", 0.3)
    run, course = model_errors.cycle_run.__wrapped__(key, 0, False)
    arm, own = model_errors.BY_KEY[key].error.plant(ARM), run.quantity("H") / LEVEL - 1.0
    for tick in (100, 200, 299):
        q, v = run.q[tick], run.velocity[tick]
        z, values = modal(arm, q)
        rate = (modal(arm, q + ALONG * v)[0][0] - modal(arm, q - ALONG * v)[0][0]) / (2.0 * ALONG)
        assert course.H[tick] == pytest.approx(0.5 * (rate**2 / values[0] + z[0] ** 2) / LEVEL - 1.0, abs=1e-6)
        assert course.leak[tick] == pytest.approx(z[1:].max() / AMPLITUDE)
    assert np.abs(course.H - own).max() > 0.02  # what the controller believes is another quantity


def test_without_an_error_the_controller_is_right():
    controller = limit_cycle_controller(0)
    run = run_with_error(ARM, controller, start(controller), ModelError(), 0.2)
    course = in_modes(controller.cycle, run.q, run.velocity)
    assert run.finished and pytest.approx(run.quantity("H") / LEVEL - 1.0, abs=1e-12) == course.H


def test_a_run_ends_where_the_supervisor_stops_the_motors():
    controller = limit_cycle_controller(0)
    run = run_with_error(ARM, controller, start(controller), ModelError(delay=0.05), 2.0)
    assert not run.finished and run.time[-1] < 1.9 and np.isnan(run.values[-1]).all()
