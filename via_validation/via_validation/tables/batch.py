"""Batch least squares on the integrated motor equation: one spring law for a whole record, offline.

Source: SAPHARI deliverable, eqs. (36)-(43), the 'standard LS' of Table 3, with the corrections of
`via_estimators.integral`: a constant beside the integrals, and the minus of (39). Integrated as in `signal_based`:
torques are constant over the interval that ends at their stamp, f_j(phi) by trapezoids, both from the first sample on.

Standard deviations: white torque noise of variance r^2 is a random walk in the integrals. With the rows F and the sums
S_n = sum of F_k, k >= n, of all rows that the error e_n of sample n enters,

    F'e = sum_n dt_n e_n S_n,   Cov(x) = r^2 P (sum_n dt_n^2 S_n S_n') P,   P = (F'F)^-1

r^2 is measured on the increments of the equation, whose errors are white. Not included: the truncation of the basis,
drift of the spring law (a batch estimate is a mean over the record), and errors of angles and velocities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from via_core.errors import ParameterError, SignalError
from via_core.signals import Array
from via_estimators.basis import BASES, fill_basis


@dataclass(frozen=True)
class BatchLaw:
    """Spring law and motor parameters of one transmission.

    coefficients  (m + 2,) B [kg m^2], D [N m s/rad], a_1.. [N m/rad]
    covariance    (m + 2, m + 2) of the coefficients
    torque_noise  [N m] measured standard deviation of the torque noise
    condition     [-] condition number of the rows, columns scaled to unit length
    basis, scale  name in BASES, deflection scale [rad]
    """

    coefficients: Array
    covariance: Array
    torque_noise: float
    condition: float
    basis: str
    scale: float

    @property
    def inertia(self) -> float:
        """B [kg m^2]."""
        return float(self.coefficients[0])

    @property
    def damping(self) -> float:
        """D [N m s/rad]."""
        return float(self.coefficients[1])

    def stiffness(self, deflection: ArrayLike) -> tuple[Array, Array]:
        """sigma(phi) [N m/rad] by (43) and its standard deviation, both shaped as `deflection` [rad]."""
        phi = np.asarray(deflection, dtype=np.float64)
        slopes = _terms(self.basis, phi.ravel(), self.scale, len(self.coefficients) - 2)[1]
        value = slopes @ self.coefficients[2:]
        variance = np.einsum("ni,ij,nj->n", slopes, self.covariance[2:, 2:], slopes)
        return value.reshape(phi.shape), np.sqrt(np.maximum(variance, 0.0)).reshape(phi.shape)


def integral_rows(record: Array, basis: str, terms: int, scale: float) -> tuple[Array, Array]:
    """Rows (N, m + 3) for (c, B, D, a_1..) and right sides (N,) of the integrated equation, eqs. (38), (40), (41).

    record  (N, 5) time [s], q, theta [rad], its velocity [rad/s], tau [N m]
    """
    time, q, theta, theta_velocity, tau = record.T
    f = _terms(basis, q - theta, scale, terms)[0]
    step = np.diff(time)[:, None]
    integrals = np.vstack([np.zeros(terms), np.cumsum(0.5 * step * (f[1:] + f[:-1]), axis=0)])
    pushed = np.concatenate([[0.0], np.cumsum(step[:, 0] * tau[1:])])
    return np.column_stack([np.ones(len(time)), theta_velocity, theta - theta[0], -integrals]), pushed


def batch_law(record: Sequence[ArrayLike], basis: str = "powers", terms: int = 7, scale: float = 1.0) -> BatchLaw:
    """The spring law of one transmission.

    record  arrays (N,) of time [s], q, theta [rad], motor velocity [rad/s] and motor torque [N m]
    terms   of the basis; scale [rad]

    Raises SignalError for arrays that are not finite, not of one length, too short, or not informative; ParameterError
    for an unknown basis.
    """
    if basis not in BASES:
        raise ParameterError(f"no basis '{basis}'; there are: {', '.join(BASES)}")
    arrays = [np.asarray(values, dtype=np.float64) for values in record]
    if len({array.shape for array in arrays}) != 1 or arrays[0].ndim != 1 or len(arrays[0]) < terms + 4:
        raise SignalError(f"need arrays (N,) of one length > {terms + 3}, got {[array.shape for array in arrays]}")
    if not all(np.all(np.isfinite(array)) for array in arrays) or not np.all(np.diff(arrays[0]) > 0.0):
        raise SignalError("a record must be finite and its time strictly increasing")
    rows, right = integral_rows(np.column_stack(arrays), basis, terms, scale)
    size = np.linalg.norm(rows, axis=0)
    if not np.all(size > 0.0):
        raise SignalError(f"column {int(np.argmin(size))} of the record's rows is 0: that unknown cannot be determined")
    _, singular, directions = np.linalg.svd(rows / size, full_matrices=False)
    if singular[-1] <= 1e-14 * singular[0]:
        raise SignalError("the record's rows are linearly dependent: its unknowns cannot be distinguished")
    x = np.linalg.lstsq(rows / size, right, rcond=None)[0] / size
    P = (directions.T / singular**2) @ directions / np.outer(size, size)
    step = np.diff(arrays[0])
    reached = np.cumsum(rows[::-1], axis=0)[::-1][1:] * step[:, None]
    white = (np.diff(right) - np.diff(rows, axis=0) @ x) / step
    noise = float(np.sqrt(np.sum(white**2) / (len(white) - terms - 2)))
    covariance = noise**2 * P @ (reached.T @ reached) @ P
    return BatchLaw(x[1:], covariance[1:, 1:], noise, float(singular[0] / singular[-1]), basis, scale)


def _terms(basis: str, phi: Array, scale: float, terms: int) -> tuple[Array, Array]:
    """f (N, m) [rad] and g (N, m) [-] at deflections (N,)."""
    f, g, bend = np.empty((len(phi), terms)), np.empty((len(phi), terms)), np.empty(terms)
    for k, value in enumerate(phi):
        fill_basis(BASES[basis], value, scale, f[k], g[k], bend)
    return f, g
