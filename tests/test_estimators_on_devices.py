"""Simulated devices, parameters and sensors from their files: errors of stiffness, coverage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.methods import estimator_for
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate


def simulated(device, share, duration=20.0):
    """Measured and true signals under two-tone torques up to `share` of the spring torque at the stop."""
    t = np.arange(int(1e3 * duration) + 1) * 1e-3
    u = np.clip(t / 0.5, 0.0, 1.0)
    size = u * u * (3.0 - 2.0 * u) * share * float(device.springs[0].torque(device.springs[0].max_deflection))
    first = 1.0 + 0.6 * np.sin(2.0 * np.pi * 0.7 * t) + 0.3 * np.sin(2.0 * np.pi * 1.9 * t)
    second = 1.0 + 0.6 * np.sin(2.0 * np.pi * 1.1 * t) + 0.3 * np.sin(2.0 * np.pi * 2.3 * t + 1.0)
    torques = np.column_stack([size * first, -size * second])
    commands = Signals(t, {"motor": torques}, {"motor": "N m"}, frozenset({"motor"}))
    sensors = Sensors.of_device(device)
    return simulate(JointPlant.from_device(device), commands, duration, 1e3, sensors, InitialConditions(seed=3))


@pytest.mark.parametrize(
    ("name", "share", "median_error"),
    [
        ("cubic_demo", 0.1, 1e-3),
        ("cubic_aa_vsa", 0.25, 1e-3),
        ("qbmove_a", 0.25, 0.02),  # motors with dry friction, which the equation does not have
        ("qbmove_b", 0.25, 0.02),
        ("qbmove_alterego", 0.2, 0.01),
        ("dlr_bavs", 0.25, 0.02),  # a spring law that is not odd
        ("vsa2", 0.06, 0.03),  # deflections past the stop, towards the dead point of the linkage
    ],
)
def test_stiffness_of_a_simulated_device(name, share, median_error):
    device = load_device(name)
    run = simulated(device, share)
    estimates = estimator_for(device).run(run.measured)
    value, sd = estimates.column("stiffness")
    good = estimates.status == Status.OK
    miss = np.abs(value - run.truth["stiffness"])[good]
    assert good.mean() > 0.75
    assert np.median(miss / run.truth["stiffness"][good]) < median_error
    assert np.mean(miss <= 1.96 * sd[good]) > 0.9


def test_simulator_and_estimator_have_the_same_effort_convention():
    """Effort at a stamp acted over the interval that ends there: half a sample off would bias the motor's inertia."""
    device = load_device("cubic_demo")
    run = simulated(device, 0.1)
    rows = np.column_stack(
        [run.measured.time, run.measured["q"], run.measured["theta"][:, 0], run.measured["tau"][:, 0],
         run.measured["theta"][:, 1], run.measured["tau"][:, 1]]
    )  # fmt: skip
    early = rows.copy()
    early[:-1, [3, 5]] = rows[1:, [3, 5]]
    estimator, errors = estimator_for(device), []
    punctual = estimator.with_parameters(replace(estimator.parameters, delay_deviation=1e-9))  # no unknown delay
    for each in (rows, early):
        estimates = punctual.run_rows(each)[1]
        errors.append(abs(estimates.column("motor_damping_1")[0][-1] / device.motors[0].viscous_friction - 1.0))
    assert errors[0] < 1e-3 < 3e-3 < errors[1]
