"""equilibrium_preset with the estimator in the loop, on a joint whose springs differ from the model."""

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_core.devices import load_device
from via_validation.control.stiffness_loop import StiffnessCourse, run_joint

NOMINAL, WANTED = load_device("qbmove_a"), 6.0  # [N m/rad]


def course(feedback: bool) -> StiffnessCourse:
    """Springs 15 % stiffer than nominal, the equilibrium in motion so that the estimator converges."""
    stiffer = tuple(replace(spring, k=1.15 * spring.k) for spring in NOMINAL.springs)
    real = NOMINAL.model_copy(update={"springs": stiffer})
    controller = EquilibriumPreset.from_device(NOMINAL)

    def targets(time):
        return 0.15 * np.sin(2.0 * np.pi * time) + 0.05 * np.sin(5.4 * np.pi * time), WANTED

    return run_joint(NOMINAL, real, controller, targets, 5.0, feedback)


def test_stiffness_feedback_removes_the_error():
    with_it, without = course(True), course(False)
    late = with_it.time > 4.0
    error, uncorrected = (np.abs(run.truth[late] / WANTED - 1.0).mean() for run in (with_it, without))
    assert uncorrected == pytest.approx(0.15, abs=0.01)
    assert error < 0.03
    assert with_it.factor[-1] == pytest.approx(1.15, abs=0.03)
    assert np.abs(np.diff(with_it.truth[200:])).max() < 0.05  # nothing jumps
    assert not with_it.saturated and np.isfinite(with_it.estimate).mean() > 0.8
