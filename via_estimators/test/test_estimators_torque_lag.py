"""A torque that a drive reports behind a low-pass filter is not taken for a late one."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.status import Status
from via_estimators.modulated_torque import ModulatedTorque

STIFFNESS, INERTIA, DAMPING = 100.0, 0.05, 0.5  # [N m/rad], [kg m^2], [N m s/rad]
STEP, PERIOD = 2.0 * np.pi / 2**16, 1e-3  # [rad] of the encoders, [s]


def filtered(torque: np.ndarray, time: float) -> np.ndarray:
    """The torque behind a first-order low-pass filter of that time constant [s], held between samples."""
    behind, share = np.zeros(len(torque)), 1.0 - np.exp(-PERIOD / time)
    for k in range(1, len(torque)):
        behind[k] = behind[k - 1] + share * (torque[k] - behind[k - 1])
    return behind


def moved(change: np.ndarray) -> np.ndarray:
    """Samples (N, 4) of a prescribed motion; the spring is `change` (N,) times STIFFNESS."""
    t = PERIOD * np.arange(len(change))
    turn = 2.0 * np.pi * t
    theta = 0.4 * np.sin(0.7 * turn) + 0.2 * np.sin(1.7 * turn + 0.5)
    phi = 0.05 * np.sin(0.7 * turn + 2.5) + 0.03 * np.sin(1.7 * turn + 1.1) + 0.01 * np.sin(4.3 * turn)
    speed = np.gradient(theta, PERIOD)
    torque = INERTIA * np.gradient(speed, PERIOD) + DAMPING * speed - change * STIFFNESS * phi
    torque[1:] = 0.5 * (torque[1:] + torque[:-1])
    return np.column_stack([t, phi + theta, theta, torque])


@pytest.mark.parametrize("swing", [0.0, 0.2])
@pytest.mark.parametrize("time", [0.005, 0.02])
def test_the_stiffness_behind_a_filter_is_within_its_interval(time: float, swing: float) -> None:
    device = elastic(
        0.15,
        {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING},
        {"stiffness": 1.05 * STIFFNESS, "max_deflection": 0.2},
        link_quantum=STEP,
        motor_quantum=STEP,
        torque_noise=0.02,
    )
    change = 1.0 + swing * np.sin(2.0 * np.pi * 0.15 * PERIOD * np.arange(12000))
    rows = moved(change)
    rows[:, 3] = filtered(rows[:, 3], time) + 0.02 * np.random.default_rng(1).standard_normal(len(rows))
    rows[:, 1:3] = STEP * np.round(rows[:, 1:3] / STEP)
    _, estimates = ModulatedTorque.from_device(device).run_rows(rows)
    value, sd = estimates.column("stiffness")
    later = (rows[:, 0] > 3.0) & (estimates.status == Status.OK)
    assert later.sum() > 0.95 * np.sum(rows[:, 0] > 3.0)
    error = np.abs(value - change * STIFFNESS)[later]
    assert np.mean(error) < (0.015 if swing else 0.004) * STIFFNESS
    assert np.mean(error <= 1.96 * sd[later]) >= 0.85
    assert np.median(sd[later]) < (0.02 if swing else 0.004) * STIFFNESS
