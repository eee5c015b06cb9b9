"""Closed loop of base controller, stiffness estimator and simulated joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import Status
from via_estimators.contract import Live
from via_estimators.methods import estimator_for
from via_sim.joint.measurements import MEASURED, TRUTH
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

RATE = 1000.0  # [Hz]
TARGET_EVERY = 10  # ticks from one target to the next
METHOD = "modulated_torque"


@dataclass(frozen=True)
class StiffnessCourse:
    """N samples of a joint with two torque motors."""

    time: Array  # (N,) [s]
    q: Array  # (N,) [rad]
    truth: Array  # (N,) [N m/rad] of the real joint
    wanted: Array  # (N,) [N m/rad] target
    estimate: Array  # (N,) [N m/rad], NaN where its status is not OK
    factor: Array  # (N,) r [-] of the controller
    saturated: bool


def run_joint(
    nominal: Device,
    real: Device,
    controller: EquilibriumPreset,
    targets: Callable[[float], tuple[float, float]],
    duration: float,
    feedback: bool = True,
) -> StiffnessCourse:
    """Run a controller made for the device `nominal` on the joint `real` for `duration` [s].

    targets   equilibrium [rad] and stiffness [N m/rad] as a function of time [s]
    feedback  whether the controller gets the estimates; the estimator is set up for `nominal`
    """
    simulator = Simulator(JointPlant.from_device(real), RATE, Sensors.of_device(real))
    estimator = Live(estimator_for(nominal, METHOD))
    at = estimator.estimator.outputs.index("stiffness")
    body, state = simulator.init(seed=1), controller.init()
    measured, truth = simulator.sample(body)
    rows, saturated = [], False
    for tick in range(round(duration * RATE)):
        time, seen = tick / RATE, dict(zip(MEASURED._fields, measured, strict=True))
        angle, wanted = targets(time)
        if tick % TARGET_EVERY == 0:
            state = controller.with_reference(state, angle, wanted)
        state, out = controller.step(state, JointSample(time, seen["q"], np.array([seen["theta_1"], seen["theta_2"]])))
        status = estimator.take(np.array([[time, *(seen[name] for name in estimator.estimator.inputs)]]))
        value, sd = float(estimator.value[at]), float(estimator.standard_deviation[at])
        if feedback:
            state = controller.with_estimate(state, time, Status(status), value, sd)
        good = status == Status.OK
        rows.append((time, seen["q"], truth[TRUTH.stiffness], wanted, value if good else np.nan, state.factor))
        saturated |= out.saturated
        body, measured, truth = simulator.step(body, [*out.torque, 0.0, 0.0])
    stamps, q, true, target, found, factor = np.array(rows).T
    return StiffnessCourse(stamps, q, true, target, found, factor, saturated)
