"""Recursive least squares on the triangular factor: rows are added by Givens rotations, without inversion.

Source: SAPHARI deliverable, eqs. (44)-(49) (QR-RLS). Departures: the forgetting factor there multiplies R and p, which
forgets lambda^2 per sample; here the caller multiplies by sqrt(lambda), the usual meaning. R starts with a small prior,
so no n rows are needed 'to set up a complete R'.
"""

from __future__ import annotations

from math import sqrt

from numba import njit
from via_core.signals import Array

NEGLIGIBLE = 1e-6  # steps that forget less than this share of the information are accumulated


@njit(cache=True, error_model="numpy")
def rotate_in(R: Array, p: Array, row: Array, y: float, first: int) -> float:
    """Add the equation row' x = y to R x = p, both overwritten; returns the residual (the star of (48)).

    R      (n, n) upper triangular, or (n, m), m > n, with further columns that are transformed alike
    p      (n,)
    row    (n,) or (m,), zero before column `first`; overwritten, with zeros up to n
    """
    for j in range(first, p.size):
        if row[j] == 0.0:
            continue
        per_length = 1.0 / sqrt(R[j, j] * R[j, j] + row[j] * row[j])
        c, s = R[j, j] * per_length, row[j] * per_length
        for i in range(j, row.size):
            above = R[j, i]
            R[j, i] = c * above + s * row[i]
            row[i] = c * row[i] - s * above
        above = p[j]
        p[j] = c * above + s * y
        y = c * y - s * above
    return y


@njit(cache=True, error_model="numpy")
def reflect_in(R: Array, p: Array, rows: Array, y: Array, first: int) -> float:
    """Add k equations rows' x = y at once, like k calls of `rotate_in`; returns the residual sum of squares.

    One reflection per column (Householder) instead of a rotation per row and column; since row i begins in
    column first + i, it involves only the rows that have begun.

    R      (n, m) as in `rotate_in`, with a diagonal > 0
    p      (n,)
    rows   (m, k) or more, one equation per column, no place first, .., n - 1 all zero; overwritten
    y      (k,) overwritten
    """
    for j in range(first, p.size):
        begun, here = min(j - first + 1, y.size), rows[j]
        squares = 0.0
        for i in range(begun):
            squares += here[i] * here[i]
        diagonal = R[j, j]
        length = sqrt(diagonal * diagonal + squares)
        grown, per, share = squares / (diagonal + length), 1.0 / length, (diagonal + length) / (length * squares)
        R[j, j] = length
        for c in range(j + 1, R.shape[1]):
            beside = rows[c]
            along = 0.0
            for i in range(begun):
                along += here[i] * beside[i]
            along = share * along - per * R[j, c]
            R[j, c] += grown * along
            for i in range(begun):
                beside[i] -= along * here[i]
        along = 0.0
        for i in range(begun):
            along += here[i] * y[i]
        along = share * along - per * p[j]
        p[j] += grown * along
        for i in range(begun):
            y[i] -= along * here[i]
    left = 0.0
    for i in range(y.size):
        left += y[i] * y[i]
    return left


@njit(cache=True, error_model="numpy")
def solve_triangular(R: Array, p: Array, x: Array) -> None:
    """x (n,) with R x = p, by back substitution; x may be p."""
    n = p.size
    for j in range(n - 1, -1, -1):
        total = p[j]
        for i in range(j + 1, n):
            total -= R[j, i] * x[i]
        x[j] = total / R[j, j]


@njit(cache=True, error_model="numpy")
def solve_transposed(R: Array, p: Array, x: Array) -> None:
    """x (n,) with R' x = p, by forward substitution; x may be p."""
    n = p.size
    for j in range(n):
        total = p[j]
        for i in range(j):
            total -= R[i, j] * x[i]
        x[j] = total / R[j, j]


@njit(cache=True, error_model="numpy")
def invert_triangular(R: Array, n: int, inverse: Array) -> None:
    """R^-1 into the first n rows and columns of `inverse`, R being upper triangular in those; zeros below."""
    for i in range(n - 1, -1, -1):
        each = 1.0 / R[i, i]
        for j in range(n):
            inverse[i, j] = 0.0
        for k in range(i + 1, n):
            share = each * R[i, k]
            for j in range(k, n):
                inverse[i, j] -= share * inverse[k, j]
        inverse[i, i] = each


@njit(cache=True, error_model="numpy")
def inverse_normal(R: Array, inverse: Array, P: Array) -> None:
    """P (n, n) = (R'R)^-1 and inverse (n, n) = R^-1 of the upper triangular R."""
    n = R.shape[0]
    invert_triangular(R, n, inverse)
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(j, n):
                total += inverse[i, k] * inverse[j, k]
            P[i, j] = total
            P[j, i] = total
