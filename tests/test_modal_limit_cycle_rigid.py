"""Limit cycle on one mode of a rigid arm in closed loop: convergence, and printed forms that do not converge."""

import numpy as np
import pytest
from via_controllers.arms import modal_limit_cycle
from via_validation.control.limit_cycle import limit_cycle_controller, rigid


@pytest.mark.parametrize("mode", [0, 1])
def test_the_cycle_converges_without_leaking_into_other_modes(mode):
    """Number 1: after a start beside the mode, H within 1e-4 and the other modes within 1e-6."""
    course = rigid(limit_cycle_controller(mode).cycle, 3.0)
    late = len(course.H) * 2 // 3
    assert abs(course.H[0]) > 0.5 and course.leak[0] > 0.1
    assert np.abs(course.H[late:]).max() < 1e-4
    assert course.leak[late:].max() < 1e-6


@pytest.mark.parametrize(("mode", "left"), [(0, 0.09), (1, 0.07)])
def test_with_the_printed_input_h_oscillates(mode, left, monkeypatch):
    """(102) as printed, with zd^2 for zd."""

    def printed(eigenvalue, rate, pull, z_velocity):
        return eigenvalue * (-pull * z_velocity + rate / (2.0 * eigenvalue**2) * z_velocity**2)

    monkeypatch.setattr(modal_limit_cycle, "orbit_input", printed)
    H = rigid(limit_cycle_controller(mode).cycle, 3.0).H
    assert left < np.abs(H[len(H) * 2 // 3 :]).max() < 0.25


@pytest.mark.parametrize("mode", [0, 1])
def test_without_the_algebraic_loop_the_modes_leak(mode, monkeypatch):
    """Wdd at qdd = 0: the share of the acceleration is not negligible."""
    modal = modal_limit_cycle._modal

    def open_loop(*args):
        return modal(*args)._replace(loop=np.eye(4))

    monkeypatch.setattr(modal_limit_cycle, "_modal", open_loop)
    course = rigid(limit_cycle_controller(mode).cycle, 3.0)
    late = len(course.H) * 2 // 3
    assert max(np.abs(course.H[late:]).max(), course.leak[late:].max()) > 0.02
