"""equilibrium_preset with the estimator in the loop, on a joint whose springs differ from the model."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from via_controllers.contract import JointSample
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_core.devices import load_device
from via_core.status import Status
from via_estimators.contract import Live
from via_estimators.methods import estimator_for
from via_sim.joint.measurements import MEASURED, TRUTH
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

NOMINAL, WANTED = load_device("qbmove_a"), 6.0  # [N m/rad]
RATE, DURATION = 1000.0, 5.0  # [Hz], [s]
TARGET_EVERY = 10  # ticks from one target to the next


class Course(NamedTuple):
    """N samples of the joint, (N,) each."""

    time: np.ndarray  # [s]
    truth: np.ndarray  # [N m/rad] of the real joint
    estimate: np.ndarray  # [N m/rad], NaN where its status is not OK
    factor: np.ndarray  # r [-] of the controller
    saturated: np.ndarray


def course(feedback: bool) -> Course:
    """Springs 15 % stiffer than nominal, the equilibrium in motion so that the estimator converges."""
    stiffer = tuple(replace(spring, k=1.15 * spring.k) for spring in NOMINAL.springs)
    real = NOMINAL.model_copy(update={"springs": stiffer})
    controller = EquilibriumPreset.from_device(NOMINAL)
    simulator = Simulator(JointPlant.from_device(real), RATE, Sensors.of_device(real))
    estimator = Live(estimator_for(NOMINAL, "modulated_torque"))
    at = estimator.estimator.outputs.index("stiffness")
    body, state = simulator.init(seed=1), controller.init()
    measured, truth = simulator.sample(body)
    rows = []
    for tick in range(round(DURATION * RATE)):
        time, seen = tick / RATE, dict(zip(MEASURED._fields, measured, strict=True))
        if tick % TARGET_EVERY == 0:
            angle = 0.15 * np.sin(2.0 * np.pi * time) + 0.05 * np.sin(5.4 * np.pi * time)
            state = controller.with_reference(state, angle, WANTED)
        state, out = controller.step(state, JointSample(time, seen["q"], np.array([seen["theta_1"], seen["theta_2"]])))
        status = estimator.take(np.array([[time, *(seen[name] for name in estimator.estimator.inputs)]]))
        value, sd = float(estimator.value[at]), float(estimator.standard_deviation[at])
        if feedback:
            state = controller.with_estimate(state, time, Status(status), value, sd)
        estimate = value if status == Status.OK else np.nan
        rows.append((time, truth[TRUTH.stiffness], estimate, state.factor, out.saturated))
        body, measured, truth = simulator.step(body, [*out.torque, 0.0, 0.0])
    return Course(*np.array(rows).T)


def test_stiffness_feedback_removes_the_error():
    with_it, without = course(True), course(False)
    late = with_it.time > 4.0
    error, uncorrected = (np.abs(run.truth[late] / WANTED - 1.0).mean() for run in (with_it, without))
    assert uncorrected == pytest.approx(0.15, abs=0.01)
    assert error < 0.03
    assert with_it.factor[-1] == pytest.approx(1.15, abs=0.03)
    assert np.abs(np.diff(with_it.truth[200:])).max() < 0.05  # nothing jumps
    assert not with_it.saturated.any() and np.isfinite(with_it.estimate).mean() > 0.8
