"""Estimates of joints whose parts dissipate energy, also where the motor's controller resembles a joint."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_joints import elastic
from scipy.stats import norm
from via_core.status import Status
from via_estimators.modulated_torque import ModulatedTorque
from via_estimators.passive import FAR, ratio, restrict
from via_estimators.rows import at_rate

STIFFNESS, INERTIA, DAMPING, STEP = 150.0, 0.12, 2.0, 2.0 * np.pi / 2**16


def test_the_ratio_of_density_and_distribution_has_all_digits():
    """Far below the limit too, where the distribution itself has none."""
    for b in (3.0, 0.0, -1.0, FAR + 1e-9, FAR - 1e-9, -30.0, -1e3):
        exact = np.exp(norm.logpdf(b) - norm.logcdf(b)) if b > -300.0 else -b - 1.0 / b
        assert ratio(b) == pytest.approx(exact, rel=2e-6)


def test_the_mean_becomes_that_of_the_part_above_the_limits():
    """Against draws of the Gaussian of which those below the limit are left out; the covariance stays."""
    x, P = np.array([0.4, 2.0]), np.array([[1.0, 0.6], [0.6, 2.0]])
    drawn, before = np.random.default_rng(1).multivariate_normal(x, P, 400_000), P.copy()
    assert restrict(x, P, np.array([0.0, -np.inf])) == 1.0
    assert x == pytest.approx(drawn[drawn[:, 0] > 0.0].mean(axis=0), abs=0.01)
    assert np.array_equal(P, before)


def test_far_below_a_limit_the_others_follow_and_are_as_uncertain_as_the_equation_is_wrong():
    """Three unknowns, the first eight standard deviations below its limit: x_1 follows by its correlation."""
    x, P = np.array([-8.0, 1.0, 30.0]), np.array([[1.0, -0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 2.0]])
    assert restrict(x, P, np.array([0.0, -np.inf, 0.0])) == pytest.approx((64.0 + 1.0 + 1.0) / 3.0)
    assert 0.0 < x[0] < 0.15 and x[1] == pytest.approx(1.0 - 0.5 * (x[0] + 8.0)) and x[2] == pytest.approx(30.0)


def test_the_most_unlikely_unknown_is_restricted_first():
    """Once the second is at its limit, the first is far above its own one, and not below it any more."""
    x, P = np.array([-1.0, -5.0]), np.array([[1.0, 0.9], [0.9, 1.0]])
    assert restrict(x, P, np.zeros(2)) == pytest.approx((25.0 + 1.0) / 2.0)
    assert 0.0 < x[1] < 0.3 and x[0] == pytest.approx(-1.0 + 0.9 * (x[1] + 5.0), abs=1e-3)


def held(friction: float, count: int = 12000) -> np.ndarray:
    """Samples of a series elastic joint at 1 kHz whose motor is held by its controller while the link is pushed.

    The friction of the gear is LuGre's, built up over half a milliradian, which is not the model of the estimator.
    """
    inertia, damping, substeps, h = 0.3, 0.3, 5, 1e-3
    bristles, dt, random = 2e3 * friction, h / substeps, np.random.default_rng(1)
    slope = np.sqrt(bristles * INERTIA)
    frequency, phase = random.uniform(0.3, 1.5, 4), random.uniform(0.0, 6.28, 4)
    time = h * np.arange(count)
    push = 2.5 * np.sin(2.0 * np.pi * frequency * time[:, None] + phase).sum(axis=1)
    q = theta = speed = of_link = bent = 0.0
    rows = np.empty((count, 4))
    for k in range(count):
        torque = -400.0 * theta - 20.0 * speed
        rows[k] = time[k], q, theta, torque
        for _ in range(substeps):
            rate = speed - abs(speed) * bristles / friction * bent
            bent += dt * rate
            spring = STIFFNESS * (q - theta)
            speed += dt / INERTIA * (torque - DAMPING * speed - bristles * bent - 0.6 * slope * rate + spring)
            theta += dt * speed
            of_link += dt / inertia * (push[k] - damping * of_link - spring)
            q += dt * of_link
    rows[1:, 3] = rows[:-1, 3].copy()  # a torque is that of the interval before its stamp
    rows[:, 1:3] = STEP * np.round(rows[:, 1:3] / STEP)
    rows[:, 3] += 0.05 * random.standard_normal(count)
    return rows


@pytest.mark.parametrize("friction", [1.0, 3.0])
@pytest.mark.parametrize("declared", [False, True])
def test_a_held_motor_is_not_a_motor_without_a_spring(friction: float, declared: bool) -> None:
    """Its torque is a function of its angle, as that of a spring and damper with negative signs would be."""
    motor = {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING} | (
        {"coulomb_friction": friction} if declared else {}
    )
    device = elastic(
        1.0, motor, {"stiffness": 1.05 * STIFFNESS, "max_deflection": 0.2},
        link_quantum=STEP, motor_quantum=STEP, torque_noise=0.05,
    )  # fmt: skip
    rows = held(friction)
    _, estimates = ModulatedTorque.from_device(at_rate(device, 1000.0)).run_rows(rows)
    value, sd = estimates.column("stiffness")
    later = (rows[:, 0] > 3.0) & (estimates.status == Status.OK)
    error = np.abs(value - STIFFNESS)[later]
    assert later.sum() > 0.9 * np.sum(rows[:, 0] > 3.0)
    assert np.median(error) < 0.02 * STIFFNESS and np.median(sd[later]) < 0.05 * STIFFNESS
    assert friction < 3.0 or np.median(sd[later]) > 0.02 * STIFFNESS  # its friction is not that of the equation
    assert np.mean(error <= 1.96 * sd[later]) >= 0.85
