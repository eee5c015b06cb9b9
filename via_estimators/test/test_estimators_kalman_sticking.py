"""The Kalman filters of a motor that sticks in its dry friction while the link behind its spring moves."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.status import Status
from via_estimators.extended_kalman import ExtendedKalman
from via_estimators.unscented_kalman import UnscentedKalman

STIFFNESS, INERTIA, DAMPING, FRICTION, STEP = 100.0, 0.05, 0.5, 0.1, 1e-4  # [SI], [rad]


def stopped(count: int = 7000) -> np.ndarray:
    """Samples (count, 4) at 1 kHz of a motor that a controller moves, and holds from 4 s on; the link goes on swinging.

    Integrated in steps of .1 ms; the impulse of dry friction stops the motor and does not turn it back.
    """
    q = w = theta = omega = torque = 0.0
    rows, h, most = np.empty((count, 4)), 1e-4, 1e-4 * FRICTION / INERTIA
    for k in range(count):
        rows[k] = 1e-3 * k, q, theta, torque
        turn = 2e-3 * np.pi * min(k, 4000) * min(1e-3 * k, 1.0)
        aim = 0.4 * np.sin(0.7 * turn) + 0.15 * np.sin(1.7 * turn)
        torque = 150.0 * (aim - theta) - 6.0 * omega
        for _ in range(10):
            spring = STIFFNESS * (q - theta)
            w += h * (-spring - 0.1 * w) / 0.15
            omega += h * (torque + spring - DAMPING * omega) / INERTIA
            omega -= min(max(omega, -most), most)
            q, theta = q + h * w, theta + h * omega
    rows[:, 1:3] = STEP * np.round(rows[:, 1:3] / STEP)
    rows[:, 3] += 0.02 * np.random.default_rng(1).normal(size=count)
    return rows


@pytest.mark.parametrize("method", [ExtendedKalman, UnscentedKalman])
def test_a_motor_that_sticks_does_not_spoil_the_stiffness(method: type[ExtendedKalman] | type[UnscentedKalman]) -> None:
    device = elastic(
        0.15,
        {"inertia": INERTIA, "viscous_friction": DAMPING, "coulomb_friction": FRICTION},
        {"stiffness": 1.05 * STIFFNESS, "max_deflection": 0.2},
        link_quantum=STEP,
        motor_quantum=STEP,
        torque_noise=0.02,
    )
    rows = stopped()
    _, estimates = method.from_device(device).run_rows(rows)
    value, sd = estimates.column("stiffness")
    held = rows[:, 0] > 4.5
    error = np.abs(value - STIFFNESS)[held]
    assert np.ptp((rows[:, 1] - rows[:, 2])[held]) > 0.002
    assert error.max() < 0.01 * STIFFNESS
    assert np.mean((error > 1.96 * sd[held]) & (estimates.status[held] == Status.OK)) < 0.1
