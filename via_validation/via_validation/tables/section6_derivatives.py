"""Section 6.1: closed forms of derivatives compared with differences, at random states of the reference arm."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from via_bringup.demo.reference import ARM, STIFFNESS
from via_controllers.arms.flexibility_torque import FlexibilityTorque, TorqueReference
from via_controllers.arms.modal_transform import first_basis, next_basis, rates_along
from via_controllers.contract import ArmSample

from via_validation.control.limit_cycle import (
    BANDWIDTH,
)
from via_validation.tables.rows import Row


def derivative_rows() -> list[Row]:
    """Rows of number 4: closed forms compared with differences, at random states of the reference arm."""
    random = np.random.default_rng(4)
    rates = [pair for pair in (_rates_off(random) for _ in range(200)) if pair is not None]
    steps = _crossing_steps()
    return [
        Row("6.1.residual", "(108): e'' + D_tau e' + (K_tau + sigma / B) e under (107), 100 random states",
            "over its largest term [-]", None, max(_residual(random) for _ in range(100)), 1e-10,
            "reference_4dof, angles within 1 rad, rates within 2 rad/s, references within 20 N m, N m/s, N m/s^2"),
        Row("6.1.rates.W", f"Wdot in closed form compared with differences, {len(rates)} random states",
            "largest difference over largest entry [-]", None, max(pair[0] for pair in rates), 1e-6,
            "differences over 2e-5 s; only states with eigenvalues 30 /s^2 apart, since differences need it"),
        Row("6.1.rates.lambda", f"rate of lambda compared with differences, {len(rates)} random states",
            "largest difference over largest entry [-]", None, max(pair[1] for pair in rates), 1e-6,
            "as above"),
        Row("6.1.crossing", "crossing of two eigenvalues: largest step of W", "step [1/sqrt(kg m^2)]", None,
            max(steps), 0.02, "3 x 3, 2000 steps through the crossing, one of them on it"),
    ]  # fmt: skip


def _residual(random: np.random.Generator) -> float:
    q, v, w, phi = random.uniform([[-1.0], [-2.0], [-2.0], [-0.3]], [[1.0], [2.0], [2.0], [0.3]], (4, 4))
    sample, wanted = (
        ArmSample(0.0, q, v, q - phi, w, np.full(4, np.nan)),
        TorqueReference(*random.uniform(-20, 20, (3, 4))),
    )
    tracking = FlexibilityTorque(ARM, BANDWIDTH)
    seen = tracking.observed(sample)
    qdd, thdd = ARM.accelerations(q, v, sample.theta, w, tracking.unlimited(sample, seen, wanted), np.zeros(4))
    second = seen.stiffness * (qdd - thdd) + seen.stiffness_slope * (v - w) ** 2
    error, rate = wanted.torque - seen.torque, wanted.rate - seen.rate
    pull = (BANDWIDTH**2 + seen.stiffness / ARM.motor_inertia) * error
    terms = np.array([wanted.second - second, 2.0 * BANDWIDTH * rate, pull])
    return float(np.abs(terms.sum(axis=0)).max() / np.abs(terms).max())


def _rates_off(random: np.random.Generator, h: float = 1e-5) -> tuple[float, float] | None:
    q, v = random.uniform([-1.0, -1.0, -1.0, 0.2], [1.0, 1.0, 1.0, 2.2]), random.uniform(-2.0, 2.0, 4)
    basis = first_basis(ARM.inertia(q), STIFFNESS)
    if np.diff(np.sort(basis.eigenvalues)).min() < 30.0:
        return None
    A, eigenvalue_rates = rates_along(basis.W, basis.eigenvalues, ARM.inertia_rate(q, v))
    ahead, behind = (next_basis(basis, ARM.inertia(q + s * v), STIFFNESS) for s in (h, -h))
    Wdot, ldot = (ahead.W - behind.W) / (2.0 * h), (ahead.eigenvalues - behind.eigenvalues) / (2.0 * h)
    return (
        float(np.abs(basis.W @ A - Wdot).max() / max(1.0, np.abs(Wdot).max())),
        float(np.abs(eigenvalue_rates - ldot).max() / max(1.0, np.abs(ldot).max())),
    )


def _crossing_steps() -> list[float]:
    """Steps of W through a crossing of M's eigenvalues 1 and 3."""
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    inertias = [turn @ np.diag([1.0 + 0.5 * t, 3.0, 1.0 - 0.5 * t]) @ turn.T for t in np.linspace(-1.0, 1.0, 2001)]
    bases = [first_basis(inertias[0], np.eye(3))]
    for M in inertias[1:]:
        bases.append(next_basis(bases[-1], M, np.eye(3)))
    return [float(np.abs(after.W - before.W).max()) for before, after in pairwise(bases)]
