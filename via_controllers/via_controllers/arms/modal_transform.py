"""Modal coordinates of an arm: W(q) and lambda(q) of eqs. (84)-(89), and their rates, in closed form.

    W' M W = I,   W' K_d W = diag(lambda),   z = W^-1 (q - q_d),   W^-1 = W' M

With K_d constant and N = W' Mdot W the derivatives of both conditions determine one matrix A = W^-1 Wdot:

    A_ij = lambda_j N_ij / (lambda_i - lambda_j),   A_ii = -N_ii / 2,   lambdad_i = -lambda_i N_ii
    Wdot = W A,   Wdd = W (A A + Ad),   Nd = A' N + N A + W' Mdd W

written below as A = N o (F - 1/2), entry by entry, F_ij = m g / (g^2 + (TINY m)^2) with g = lambda_i - lambda_j and
m their mean. F equals the formula until two eigenvalues agree to a millionth. There the rotation of the eigenvectors is
undetermined, and F = 0 means no rotation. W is never differenced in time.

Eigenvectors have no natural order or sign: each is assigned to the closest one, by the inner product of M, of a basis
just before, so that modes keep their numbers through crossings. Where eigenvalues are so close that the decomposition
returns arbitrary mixtures of their vectors, the mixture closest to that basis is taken, pair by pair.
Source: the document's Section 6.1; the derivatives follow from (88) and (89).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from via_core.signals import Array

TINY = 1e-6  # relative gap of eigenvalues below which the rotation of their vectors is undetermined
MIXED = 1e-8  # relative gap of eigenvalues below which the decomposition mixes their vectors


@dataclass(frozen=True)
class ModalBasis:
    """W (n, n) [1/sqrt(kg m^2)] of one configuration, modes as columns, and lambda (n,) [1/s^2]."""

    W: Array
    eigenvalues: Array


@njit(cache=True, error_model="numpy")
def _basis(M: Array, K: Array) -> tuple[Array, Array]:
    """W and lambda in ascending order, by Cholesky: M = L L', L^-1 K L^-T = U diag(lambda) U', W = L^-T U."""
    L = np.linalg.cholesky(M)
    inner = np.linalg.solve(L, np.ascontiguousarray(np.linalg.solve(L, K).T))
    values, U = np.linalg.eigh(0.5 * (inner + inner.T))
    return np.linalg.solve(np.ascontiguousarray(L.T), np.ascontiguousarray(U)), values


@njit(cache=True, error_model="numpy")
def _tracked(W: Array, values: Array, near: Array, M: Array) -> tuple[Array, Array]:
    """W and lambda with the order and signs of `near`, and its mixture of vectors where eigenvalues agree."""
    n = len(values)
    product = W.T @ (M @ near)
    free = np.abs(product)
    out, order = np.empty_like(W), np.empty_like(values)
    for _ in range(n):  # best match first
        best = np.argmax(free)
        row, column = best // n, best % n
        sign = 1.0 if product[row, column] >= 0.0 else -1.0
        for i in range(n):
            out[i, column] = sign * W[i, row]
        order[column] = values[row]
        free[row, :] = -1.0
        free[:, column] = -1.0
    for i in range(n):
        for j in range(i + 1, n):
            if abs(order[i] - order[j]) > MIXED * (order[i] + order[j]):
                continue
            G = out.T @ (M @ near)
            angle = np.arctan2(G[j, i] - G[i, j], G[i, i] + G[j, j])
            first, second = out[:, i].copy(), out[:, j].copy()
            out[:, i] = np.cos(angle) * first + np.sin(angle) * second
            out[:, j] = np.cos(angle) * second - np.sin(angle) * first
    return out, order


@njit(cache=True, error_model="numpy")
def basis_near(near: Array, M: Array, K: Array) -> tuple[Array, Array]:
    """W (n, n) and lambda (n,), modes as in `near` (n, n): compiled form of `next_basis`."""
    W, values = _basis(M, K)
    return _tracked(W, values, near, M)


@njit(cache=True, error_model="numpy")
def _pairs(values: Array) -> tuple[Array, Array]:
    """Difference and mean of each pair of `values` (n,), (n, n) each."""
    column = values.copy().reshape(-1, 1)
    return column - values, 0.5 * (column + values)


@njit(cache=True, error_model="numpy")
def turning(values: Array) -> Array:
    """F (n, n) [-] of eigenvalues (n,): A = N o (F - 1/2)."""
    g, m = _pairs(values)
    return m * g / (g * g + (TINY * m) ** 2)


@njit(cache=True, error_model="numpy")
def _turning_rate(values: Array, rates: Array) -> Array:
    """Fdot (n, n) [1/s]."""
    (g, m), (gd, md) = _pairs(values), _pairs(rates)
    below = g * g + (TINY * m) ** 2
    return (md * g + m * gd) / below - 2.0 * m * g * (g * gd + TINY**2 * m * md) / below**2


@njit(cache=True, error_model="numpy")
def rates_along(W: Array, values: Array, Mdot: Array) -> tuple[Array, Array]:
    """A = W^-1 Wdot (n, n) [1/s] and lambdad (n,) [1/s^3] of a motion that changes M at Mdot (n, n) [kg m^2/s]."""
    N = W.T @ (Mdot @ W)
    return N * (turning(values) - 0.5), -values * np.diag(N)


@njit(cache=True, error_model="numpy")
def second_along(W: Array, values: Array, Mdot: Array, Mdd: Array) -> Array:
    """W^-1 Wdd = A A + Ad (n, n) [1/s^2] from Mdot [kg m^2/s] and Mdd [kg m^2/s^2], (n, n) each."""
    N = W.T @ (Mdot @ W)
    F = turning(values) - 0.5
    A = N * F
    Nd = A.T @ N + N @ A + W.T @ (Mdd @ W)
    return A @ A + Nd * F + N * _turning_rate(values, -values * np.diag(N))


def first_basis(inertia: Array, stiffness: Array) -> ModalBasis:
    """W and lambda with the softest mode first, each mode's largest component positive.

    inertia    M (n, n) [kg m^2], symmetric and positive definite
    stiffness  K_d (n, n) [N m/rad], likewise
    """
    W, values = _basis(np.ascontiguousarray(inertia), np.ascontiguousarray(stiffness))
    largest = W[np.argmax(np.abs(W), axis=0), np.arange(len(values))]
    return ModalBasis(W * np.sign(largest), values)


def next_basis(near: ModalBasis, inertia: Array, stiffness: Array) -> ModalBasis:
    """W and lambda with modes in the order of `near`, the basis just before; arguments as for `first_basis`."""
    return ModalBasis(*basis_near(near.W, np.ascontiguousarray(inertia), np.ascontiguousarray(stiffness)))
