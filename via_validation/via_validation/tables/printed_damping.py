"""Algorithm 1 of the document exactly as printed, eqs. (66)-(69), (75)-(79); for comparison only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array


@dataclass(frozen=True)
class Printed:
    """Result of Algorithm 1: damping (N,) [N m s/rad], and smallest and largest eigenvalue of P (N,)."""

    damping: Array
    smallest: Array
    largest: Array


@dataclass(frozen=True)
class Forgetting:
    """Parameters of Algorithm 1."""

    error: float  # lambda_c
    least: float  # lambda_min
    sensitivity: float  # rho
    delta: float


def algorithm_1(velocity: Array, torque: Array, terms: int, forgetting: Forgetting) -> Printed:
    """Damping from velocity and torque (N,) [rad/s, N m], from P(0) = I, w(0) = 0, eta = 0.

    The algorithm stops when a number overflows; later entries are NaN.
    """
    P, w, energy = np.eye(terms), np.zeros(terms), 0.0
    powers = 2 * np.arange(terms) + 1
    damping, smallest, largest = (np.full(len(velocity), np.nan) for _ in range(3))
    with np.errstate(all="ignore"):
        for i, (speed, measured) in enumerate(zip(velocity, torque, strict=True)):
            v = speed**powers
            error = measured - v @ w
            energy = forgetting.error * energy + error**2
            scale = 2.0 ** -np.round(forgetting.sensitivity * error**2 / energy)
            factor = forgetting.least + (1.0 - forgetting.least) * scale
            r = v @ P @ v
            beta = factor - (1.0 - factor) / r if r > 0.0 else 1.0
            w = w + P @ v / (1.0 + r) * error
            damping[i] = powers * speed ** (powers - 1) @ w
            P = (np.eye(terms) - np.outer(P @ v, v) / (1.0 / beta + r)) @ P + forgetting.delta * np.eye(terms)
            if not np.all(np.isfinite(P)):
                break
            eigenvalues = np.linalg.eigvalsh(0.5 * (P + P.T))
            smallest[i], largest[i] = eigenvalues[0], eigenvalues[-1]
    return Printed(damping, smallest, largest)
