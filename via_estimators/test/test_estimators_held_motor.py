"""Dry friction that holds a motor against its spring is not taken for a softer spring."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.status import Status
from via_estimators.modulated_torque import ModulatedTorque

STIFFNESS, INERTIA, DAMPING, HELD = 10.0, 0.02, 0.3, 100.0  # [N m/rad], [kg m^2], [N m s/rad], gain [N m/rad]
SWING = 0.2  # [rad] of the link
STEP, PERIOD, SUBSTEPS = 2.0 * np.pi / 2**16, 1e-3, 10


def held(friction: float, count: int = 20000) -> np.ndarray:
    """Samples (count, 4) of a motor that a position loop holds, while others move the link by SWING.

    friction  [N m] of the motor; the torque of its spring reaches 2 N m
    """
    t, h = PERIOD * np.arange(count), PERIOD / SUBSTEPS
    q = 0.12 * np.sin(4.0 * t) + 0.08 * np.sin(9.3 * t + 0.4)
    random, angle, speed = np.random.default_rng(3), 0.0, 0.0
    theta, torque = np.zeros(count), np.zeros(count)
    for k in range(1, count):
        torque[k] = -HELD * angle - 2.0 * speed
        for j in range(SUBSTEPS):
            link = q[k - 1] + (q[k] - q[k - 1]) * j / SUBSTEPS
            push = torque[k] + STIFFNESS * (link - angle) - DAMPING * speed
            if speed == 0.0 and abs(push) <= friction:
                continue
            direction = np.sign(speed) if speed != 0.0 else np.sign(push)
            after = speed + h * (push - friction * direction) / INERTIA
            speed = 0.0 if after * speed < 0.0 else after
            angle += h * speed
        theta[k] = angle
    torque += 0.01 * random.standard_normal(count)
    q, theta = (STEP * np.round(angle / STEP) for angle in (q, theta))
    return np.column_stack([t, q, theta, torque])


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0, 1.6, 3.0])
def test_the_stiffness_behind_a_held_motor_is_within_its_interval(friction: float) -> None:
    device = elastic(
        0.1,
        {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING, "coulomb_friction": friction},
        {"stiffness": 1.1 * STIFFNESS, "max_deflection": 0.4},
        link_quantum=STEP,
        motor_quantum=STEP,
        torque_noise=0.01,
    )
    rows = held(friction)
    _, estimates = ModulatedTorque.from_device(device).run_rows(rows)
    value, sd = estimates.column("stiffness")
    later = (rows[:, 0] > 2.0) & (estimates.status == Status.OK)
    assert later.any()
    assert np.mean(np.abs(value - STIFFNESS)[later] <= 1.96 * sd[later]) >= 0.9
    assert np.median(sd[later]) < 0.05 * STIFFNESS + 2.0 * friction / SWING
