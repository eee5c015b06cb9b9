"""The two recursions with nine unknowns compared with C++ with Eigen, padasip and plain numpy, in one run.

All process the same rows, noisy equations of a polynomial with nine terms, from the same prior. The results must agree
before anything is timed. padasip has no QR recursion; its RLS is compared with both of ours.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from math import sqrt
from pathlib import Path

import numpy as np
from numba import njit
from padasip.filters import FilterRLS
from via_core.errors import ViaError
from via_core.signals import Array
from via_estimators import qr, rls

from via_validation.bench import eigen
from via_validation.bench.timing import Contender, take_turns
from via_validation.tables.rows import Row

N = eigen.N
PRIOR, ROOT_PRIOR, KEEP = 1e5, 1e-2, 0.995  # P(0), R(0) and the forgetting factor of the QR recursion
LOG, SLOW = 20_000, 500  # samples of the log, and of its part for contenders that take microseconds per sample
EIGEN_LIMIT, PADASIP_LIMIT = 3.0, 1.0 / 8.0  # estimation.md, Cost per sample


@njit(cache=True, error_model="numpy")
def fold_rls(rows: Array, y: Array, prior: float) -> Array:
    """w (n,) after `rls.update` for each of rows (N, n), y (N,)."""
    n = rows.shape[1]
    P, w, gain = np.empty((n, n)), np.empty(n), np.empty(n)
    rls.start(P, w, prior)
    for k in range(y.size):
        rls.update(P, w, rows[k], y[k], 1.0, gain)
    return w


@njit(cache=True, error_model="numpy")
def qr_update(R: Array, p: Array, x: Array, row: Array, y: float, root: float) -> None:
    """One sample of the QR recursion: forget, rotate in, solve. Overwrites R, p, x and `row`."""
    R *= root
    p *= root
    qr.rotate_in(R, p, row, y, 0)
    qr.solve_triangular(R, p, x)


@njit(cache=True, error_model="numpy")
def fold_qr(rows: Array, y: Array, prior: float, keep: float) -> Array:
    """x (n,) after `qr_update` for each of rows (N, n), y (N,)."""
    n = rows.shape[1]
    R, p, x, row = np.zeros((n, n)), np.zeros(n), np.zeros(n), np.empty(n)
    for j in range(n):
        R[j, j] = prior
    for k in range(y.size):
        row[:] = rows[k]
        qr_update(R, p, x, row, y[k], sqrt(keep))
    return x


def numpy_rls(rows: Array, y: Array, prior: float) -> Array:
    """`fold_rls` in plain numpy."""
    P, w = prior * np.eye(rows.shape[1]), np.zeros(rows.shape[1])
    for v, value in zip(rows, y, strict=True):
        g = P @ v
        part = g / (1.0 + v @ g)
        w += part * (value - v @ w)
        P -= np.outer(part, g)
    return w


def numpy_qr(rows: Array, y: Array, prior: float, keep: float) -> Array:
    """`fold_qr` in plain numpy: each step factorises the old factor with the new row appended."""
    n, root = rows.shape[1], sqrt(keep)
    stacked = np.zeros((n + 1, n + 1))
    stacked[:n, :n] = prior * np.eye(n)
    x = np.zeros(n)
    for v, value in zip(rows, y, strict=True):
        stacked[:n] *= root
        stacked[n, :n], stacked[n, n] = v, value
        stacked[:n] = np.linalg.qr(stacked, mode="r")[:n]
        x = np.linalg.solve(stacked[:n, :n], stacked[:n, n])
    return x


def python_rls(rows: Array, y: Array, prior: float) -> Array:
    """Our kernel, called from Python for every sample as in a node."""
    P, w, gain = np.empty((N, N)), np.empty(N), np.empty(N)
    rls.start(P, w, prior)
    for v, value in zip(rows, y, strict=True):
        rls.update(P, w, v, value, 1.0, gain)
    return w


def python_qr(rows: Array, y: Array, prior: float, keep: float) -> Array:
    """Our kernel, called from Python for every sample as in a node."""
    R, p, x, root = prior * np.eye(N), np.zeros(N), np.zeros(N), sqrt(keep)
    for v, value in zip(rows.copy(), y, strict=True):
        qr_update(R, p, x, v, value, root)
    return x


def padasip_rls(rows: Array, y: Array, prior: float) -> Array:
    """padasip's filter, from the same prior."""
    found = FilterRLS(n=N, mu=1.0, eps=1.0 / prior, w="zeros")
    for v, value in zip(rows, y, strict=True):
        found.adapt(value, v)
    return np.asarray(found.w)


def log(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Rows (count, 9) of powers of a moving deflection, and y (count,) with noise."""
    rng = np.random.default_rng(seed)
    phi = np.sin(0.01 * np.arange(count)) + 0.2 * rng.standard_normal(count)
    rows = np.ascontiguousarray(np.polynomial.legendre.legvander(np.clip(phi, -1.2, 1.2), N - 1))
    return rows, rows @ (1.0 + np.arange(N)) + 0.1 * rng.standard_normal(count)


def kernel_rows(turns: int) -> list[Row]:
    """Rows of the times per sample and of the ratios that have a limit."""
    rows, y = log(LOG)
    few, y_few = rows[:SLOW].copy(), y[:SLOW].copy()
    with tempfile.TemporaryDirectory() as folder:
        reference = eigen.build(Path(folder))
        found: list[Row] = []
        calls: dict[str, tuple[Callable[..., Array], Callable[..., Array], Callable[..., Array], tuple[float, ...]]]
        calls = {"rls": (fold_rls, python_rls, numpy_rls, (PRIOR,)),
                 "qr": (fold_qr, python_qr, numpy_qr, (ROOT_PRIOR, KEEP))}  # fmt: skip
        for name, (fold, single, plain, settings) in calls.items():
            contenders = {
                "fold": Contender(LOG, partial(fold, rows, y, *settings)),
                "call": Contender(SLOW, partial(single, few, y_few, *settings)),
                "numpy": Contender(SLOW, partial(plain, few, y_few, *settings)),
                "padasip": Contender(SLOW, partial(padasip_rls, few, y_few, PRIOR)),
            }
            agreeing = [single(few, y_few, *settings), plain(few, y_few, *settings)]
            if name == "rls":
                agreeing.append(padasip_rls(few, y_few, PRIOR))
            if isinstance(reference, eigen.Reference):
                work: Callable[..., Array] = reference.rls if name == "rls" else reference.qr_rls
                contenders["eigen"] = Contender(LOG, partial(work, rows, y, *settings))
                agreeing.append(work(few, y_few, *settings))
            expected = fold(few, y_few, *settings)
            for other in agreeing:
                if not np.allclose(other, expected, rtol=1e-6, atol=1e-6):
                    raise ViaError(f"contenders of {name} disagree: {other} and {expected}")
            found += _rows(name, contenders, reference, turns)
    return found


def _rows(name: str, contenders: dict[str, Contender], reference: eigen.Reference | str, turns: int) -> list[Row]:
    label, times = ("QR-RLS" if name == "qr" else "RLS"), take_turns(contenders, turns)
    settings = f"n = {N}, median of {turns} alternating turns, one thread"
    unit = "time per sample [ns]"
    rows = [
        Row(f"kernel.{name}.{who}", f"{label}: {what}", unit, None, times[who].nanoseconds, None, settings)
        for who, what in (
            ("fold", "our kernel over a log"), ("call", "our kernel, one call from Python"),
            ("numpy", "plain numpy"), ("padasip", "padasip FilterRLS, one call"),
            ("eigen", "C++ with Eigen over a log"),
        )
        if who in times
    ]  # fmt: skip
    ratio = times["fold"].over(times["eigen"]) if "eigen" in times else None
    remark = "" if isinstance(reference, eigen.Reference) else reference
    rows.append(Row(f"kernel.{name}.fold_over_eigen", f"{label}: our kernel over a log, over C++ with Eigen",
                    "ratio of times [-]", None, ratio, EIGEN_LIMIT if ratio is not None else None, settings, 0,
                    remark))  # fmt: skip
    rows.append(Row(f"kernel.{name}.call_over_padasip", f"{label}: our one call over padasip's", "ratio of times [-]",
                    None, times["call"].over(times["padasip"]), PADASIP_LIMIT, settings))  # fmt: skip
    return rows
