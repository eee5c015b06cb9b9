"""A spring that reaches its stop shows no torque of its own there; elsewhere its stiffness is known."""

from __future__ import annotations

import numpy as np
from elastic_joints import elastic
from via_core.status import Status
from via_estimators.modulated_torque import ModulatedTorque

STIFFNESS, INERTIA, DAMPING, STOP = 100.0, 0.05, 0.5, 0.05  # [N m/rad], [kg m^2], [N m s/rad], [rad]
PERIOD = 1e-3  # [s]


def test_the_stiffness_is_known_although_the_spring_reaches_its_stop() -> None:
    """Beyond +-50 mrad a stop of 2000 N m/rad acts, in motion of +-70 mrad."""
    t = PERIOD * np.arange(12000)
    turn = 2.0 * np.pi * t
    theta = 0.4 * np.sin(0.7 * turn) + 0.2 * np.sin(1.7 * turn + 0.5)
    phi = 0.035 * np.sin(0.7 * turn + 2.5) + 0.035 * np.sin(0.4 * turn + 1.1)
    speed, beyond = np.gradient(theta, PERIOD), np.abs(phi) > STOP
    torque = INERTIA * np.gradient(speed, PERIOD) + DAMPING * speed - STIFFNESS * phi
    torque -= 2000.0 * np.where(beyond, phi - STOP * np.sign(phi), 0.0)
    torque[1:] = 0.5 * (torque[1:] + torque[:-1])
    torque += 0.02 * np.random.default_rng(1).standard_normal(len(t))
    device = elastic(
        0.15,
        {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING},
        {"stiffness": 1.05 * STIFFNESS, "max_deflection": STOP},
        torque_noise=0.02,
    )
    _, estimates = ModulatedTorque.from_device(device).run_rows(np.column_stack([t, phi + theta, theta, torque]))
    value, sd = estimates.column("stiffness")
    later = t > 4.0
    assert beyond[later].mean() > 0.1
    assert np.all(estimates.status[later & beyond] == Status.OUTSIDE_RANGE)
    good = later & (estimates.status == Status.OK)
    assert good.sum() > 0.7 * later.sum()
    error = np.abs(value - STIFFNESS)[good]
    assert error.max() < 0.01 * STIFFNESS and np.mean(error <= 1.96 * sd[good]) > 0.85
