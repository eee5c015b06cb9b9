"""Nuisance parameters: the device's own numbers, which nobody knows exactly.

Every candidate cause is fitted together with them, each inside its tolerance, so that five percent of inertia are not
taken for an effect, and an effect is not bent to make up for them. They are bounded: equation and simulation error both
have a trivial way out (shrink every term), and a number far from what the file says is a finding, not a nuisance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array
from via_core.springs import EXPONENTIAL, N_COEFFICIENTS, ODD_POLYNOMIAL
from via_sim.parameters import DYNAMIC, NO_DAMPER, SERVO, P
from via_sim.plants import JointPlant

TOLERANCE = 0.05  # relative standard deviation of a device's number
BOUND = 1.3  # standard deviations to which a number may go
AXES = ("link", "motor 1", "motor 2")


@dataclass(frozen=True)
class Nuisance:
    """One number of the device; `apply(row, factor)` multiplies it in place."""

    name: str
    unit: str
    value: float  # the device file's
    tolerance: float  # relative standard deviation
    slots: tuple[int, ...]

    def apply(self, row: Array, factor: float) -> None:
        row[list(self.slots)] *= factor


def nuisances(plant: JointPlant, tolerance: float = TOLERANCE) -> tuple[Nuisance, ...]:
    """The numbers of a nominal plant that are not zero: inertias, frictions, springs, gravity, servos, damper."""
    row, device = plant.parameters, plant.device
    found: list[tuple[str, str, float, tuple[int, ...]]] = []
    for axis, name in enumerate(AXES):
        if row[P.axis_kind + axis] == DYNAMIC:
            found.append((f"{name} inertia", "kg m^2", row[P.inertia + axis], (P.inertia + axis,)))
            slot = P.viscous_friction + axis
            found.append((f"{name} viscous friction", "N m s/rad", row[slot], (slot,)))
            dry = (P.breakaway_friction + axis, P.kinetic_friction + axis)
            found.append((f"{name} dry friction", "N m", row[dry[0]], dry))
        if row[P.axis_kind + axis] == SERVO:
            slot = P.bandwidth + axis - 1
            found.append((f"{name} bandwidth", "rad/s", row[slot], (slot,)))
    for i in range(device.n_transmissions):
        start = P.spring + i * N_COEFFICIENTS
        kind = int(row[P.spring_kind + i])
        scaled = {ODD_POLYNOMIAL: range(N_COEFFICIENTS), EXPONENTIAL: range(2)}.get(kind, range(1))
        found.append((f"spring {i + 1} torque", "-", 1.0, tuple(start + k for k in scaled)))
    found.append(("gravity torque", "N m", row[P.gravity_torque], (P.gravity_torque,)))
    if row[P.damper_site] != NO_DAMPER:
        found.append(("damper", "-", 1.0, (P.damper, P.damper + 1)))
    return tuple(Nuisance(n, unit, float(value), tolerance, slots) for n, unit, value, slots in found if value != 0.0)


def apply_all(row: Array, each: tuple[Nuisance, ...], deviations: Array) -> None:
    """Every nuisance into a row in place; deviations (J,) in standard deviations."""
    for nuisance, deviation in zip(each, deviations, strict=True):
        nuisance.apply(row, 1.0 + nuisance.tolerance * float(deviation))


def bounded_step(
    jacobian: Array, residual: Array, start: Array, low: Array, high: Array, prior: Array, centre: Array
) -> Array:
    """argmin |residual - jacobian (x - start)|^2 + sum prior (x - centre)^2 inside [low, high]; x (J,).

    Coordinate descent on the normal equations: small, always finite, and exact enough after a few dozen sweeps.
    """
    normal = jacobian.T @ jacobian + np.diag(prior)
    gradient = jacobian.T @ residual + jacobian.T @ (jacobian @ start) + prior * centre
    return descend(normal, gradient, np.clip(start, low, high), low, high)


def descend(normal: Array, gradient: Array, start: Array, low: Array, high: Array) -> Array:
    """argmin x' N x - 2 g' x inside a box: Newton on the free coordinates, those at a bound that pull outwards stay."""
    x = start.copy()
    diagonal = np.diag(normal)
    regular = normal + np.diag(1e-10 * diagonal + 1e-14 * max(float(diagonal.max(initial=0.0)), 1e-300))
    for _ in range(4 * len(x) + 8):
        slope = gradient - regular @ x
        tight = 1e-9 * np.maximum(high - low, 1e-12)
        fixed = ((x <= low + tight) & (slope <= 0.0)) | ((x >= high - tight) & (slope >= 0.0))
        free = ~fixed
        if not free.any():
            break
        step = np.zeros_like(x)
        step[free] = np.linalg.solve(regular[np.ix_(free, free)], slope[free])
        room = np.where(
            step > 0.0,
            (high - x) / np.maximum(step, 1e-300),
            np.where(step < 0.0, (low - x) / np.minimum(step, -1e-300), np.inf),
        )
        share = min(1.0, float(room.min(initial=np.inf)))
        x = np.clip(x + share * step, low, high)
        if share >= 1.0:
            break
    return x
