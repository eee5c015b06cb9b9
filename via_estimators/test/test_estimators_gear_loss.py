"""A gear whose friction grows with its load is not taken for a softer spring."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.status import Status
from via_estimators.modulated_torque import ModulatedTorque

STIFFNESS, INERTIA, DAMPING = 150.0, 0.12, 2.0  # [N m/rad], [kg m^2], [N m s/rad]


def geared(share: float, count: int = 20000) -> np.ndarray:
    """Samples (count, 4) of a prescribed motion at 1 kHz; `share` of the spring's torque is friction of the gear."""
    t = 1e-3 * np.arange(count)
    turn = 2.0 * np.pi * t
    phi = 0.05 * np.sin(0.5 * turn) + 0.03 * np.sin(1.3 * turn + 0.4) + 0.01 * np.sin(2.1 * turn)
    theta = 0.3 * np.sin(0.5 * turn - 0.9) + 0.15 * np.sin(1.3 * turn + 0.9)
    speed = np.gradient(theta, 1e-3)
    built, moved = np.zeros(count), np.diff(theta) / 2e-3
    for k in range(1, count):  # Dahl's model over 2 mrad, not the model of the estimator
        built[k] = np.sign(moved[k - 1]) + (built[k - 1] - np.sign(moved[k - 1])) * np.exp(-abs(moved[k - 1]))
    load = STIFFNESS * phi
    torque = INERTIA * np.gradient(speed, 1e-3) + DAMPING * speed + share * np.abs(load) * built - load
    torque[1:] = 0.5 * (torque[1:] + torque[:-1])
    torque += 0.1 * np.random.default_rng(1).standard_normal(count)
    step = 2.0 * np.pi / 2**16
    q, theta = (step * np.round(angle / step) for angle in (phi + theta, theta))
    return np.column_stack([t, q, theta, torque])


@pytest.mark.parametrize("share", [0.0, 0.03, 0.1, 0.2])
def test_the_stiffness_behind_a_gear_with_losses_is_within_its_interval(share: float) -> None:
    device = elastic(
        1.0,
        {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING},
        {"stiffness": 1.05 * STIFFNESS, "max_deflection": 0.2},
        link_quantum=2.0 * np.pi / 2**16,
        motor_quantum=2.0 * np.pi / 2**16,
        torque_noise=0.1,
    )
    rows = geared(share)
    _, estimates = ModulatedTorque.from_device(device).run_rows(rows)
    value, sd = estimates.column("stiffness")
    later = (rows[:, 0] > 2.0) & (estimates.status == Status.OK)
    error = np.abs(value - STIFFNESS)[later]
    assert later.sum() > 0.95 * np.sum(rows[:, 0] > 2.0)
    assert np.median(error) < 0.005 * STIFFNESS and np.quantile(error, 0.95) < 0.04 * STIFFNESS
    assert np.mean(error <= 1.96 * sd[later]) >= 0.85
    assert np.median(sd[later]) < 0.015 * STIFFNESS
