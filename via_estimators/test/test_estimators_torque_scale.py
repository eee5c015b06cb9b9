"""A drive whose reported torque changes its scale is not taken for a spring that changes."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.status import Status
from via_estimators.modulated_torque import ModulatedTorque

STIFFNESS, INERTIA, DAMPING, FRICTION = 30.0, 0.02, 0.3, 0.1  # [N m/rad], [kg m^2], [N m s/rad], [N m]
STEP, PERIOD, BEGIN, END = 2.0 * np.pi / 2**16, 1e-3, 10.0, 15.0


def moved(scale: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Samples (N, 4) of a prescribed motion; factors (N,) on the torque that is reported and on the spring."""
    t = PERIOD * np.arange(len(scale))
    turn = 2.0 * np.pi * t
    theta = 0.3 * np.sin(0.7 * turn) + 0.15 * np.sin(1.7 * turn + 0.5)
    phi = 0.12 * np.sin(0.7 * turn + 2.5) + 0.08 * np.sin(1.7 * turn + 1.1)
    speed = np.gradient(theta, PERIOD)
    torque = INERTIA * np.gradient(speed, PERIOD) + DAMPING * speed + FRICTION * np.sign(speed)
    torque -= STIFFNESS * stiffness * phi
    torque[1:] = 0.5 * (torque[1:] + torque[:-1])
    torque = scale * torque + 0.02 * np.random.default_rng(1).standard_normal(len(t))
    q, theta = (STEP * np.round(angle / STEP) for angle in (phi + theta, theta))
    return np.column_stack([t, q, theta, torque])


def estimated(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stiffness, standard deviation [N m/rad] and status (N,)."""
    device = elastic(
        0.1,
        {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING, "coulomb_friction": FRICTION},
        {"stiffness": 1.05 * STIFFNESS, "max_deflection": 0.4},
        link_quantum=STEP,
        motor_quantum=STEP,
        torque_noise=0.02,
    )
    _, estimates = ModulatedTorque.from_device(device).run_rows(rows)
    return (*estimates.column("stiffness"), estimates.status)


def pulse(factor: float) -> np.ndarray:
    t = PERIOD * np.arange(20000)
    return np.where((t > BEGIN) & (t < END), factor, 1.0)


DRIFT = np.interp(PERIOD * np.arange(20000), [BEGIN, 2.0 * BEGIN], [1.0, 0.75])


@pytest.mark.parametrize("scale", [pulse(0.8), pulse(1.2), pulse(1.5), DRIFT], ids=["0.8", "1.2", "1.5", "drift"])
def test_the_stiffness_stays_while_the_torque_changes_its_scale(scale: np.ndarray) -> None:
    value, sd, status = estimated(moved(scale, np.ones(len(scale))))
    later = (np.arange(len(value)) * PERIOD > 5.0) & (status == Status.OK)
    error = np.abs(value - STIFFNESS)[later]
    assert later.sum() > 14500
    assert np.median(error) < 0.02 * STIFFNESS and np.mean(error > 0.1 * STIFFNESS) < 0.05
    assert np.mean(error <= 1.96 * sd[later]) >= 0.85


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_spring_that_changes_is_still_followed(factor: float) -> None:
    value, sd, status = estimated(moved(np.ones(20000), pulse(factor)))
    t = np.arange(len(value)) * PERIOD
    later = (t > BEGIN + 0.5) & (t < END) & (status == Status.OK)
    error = np.abs(value - factor * STIFFNESS)[later]
    assert later.sum() > 4400
    assert np.median(error) < 0.03 * STIFFNESS and np.mean(error <= 1.96 * sd[later]) >= 0.85
