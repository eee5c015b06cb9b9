"""Bound on the achievable error of inverse dynamics: what a flexible torque model explains of the missing torque.

On every axis, a weighted sum of the functions of `Basis` of the measured motion, and of waves of the angle, is
subtracted from the missing torque. The weights are fitted to the fitted segments by ridge regression. The ridge is
chosen on blocks left out. Functions of commands are not used, because they would reproduce the torque of the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from via_core.signals import Array

from via_gap.candidates.scales import power_of
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.selection.basis import Basis, Wave, ticks_of

RIDGES = np.geomspace(1e-6, 1e1, 8)  # of the mean squared size of a function
FOLDS = 4
BLOCK = 4  # segments that are left out together
ORDERS = range(1, 61)  # waves per turn that are searched
WAVES = 12  # of them that are used: those that explain most, each alone


def torque_bound(
    fitted: Sequence[InverseDynamics], left: Sequence[Array], held: Sequence[InverseDynamics], rest: Sequence[Array]
) -> Array:
    """(S,) mean squared whitened missing torque of the held-out segments that the flexible model leaves.

    fitted, held  views of the same logs; left, rest  their whitened residuals (C, w a)
    """
    basis = Basis.of([each.segments for each in fitted], commanded=False)
    basis = replace(
        basis, waves=tuple(Wave(0, order, signed) for order in _orders(fitted, left) for signed in (False, True))
    )
    functions = [_functions(each, basis) for each in fitted]
    others = [_functions(each, basis) for each in held]
    axes = len(fitted[0].windows.axes)
    remaining = [np.empty_like(each) for each in rest]
    for axis in range(axes):
        target = np.concatenate([_axis(each, axis, axes).ravel() for each in left])
        design = np.concatenate([each.reshape(-1, each.shape[-1]) for each in functions])
        groups = np.concatenate([np.repeat(np.arange(len(f)) // BLOCK % FOLDS, f.shape[1]) for f in functions])
        weights = _ridge(design, target, groups)
        for out, values, each in zip(remaining, rest, others, strict=True):
            width = values.shape[1] // axes
            out[:, axis * width : (axis + 1) * width] = _axis(values, axis, axes) - each @ weights
    return np.concatenate([np.mean(each**2, axis=1) for each in remaining])


def _axis(values: Array, axis: int, axes: int) -> Array:
    """(C, w) of the values (C, w a) of all axes."""
    width = values.shape[1] // axes
    return values[:, axis * width : (axis + 1) * width]


def _functions(view: InverseDynamics, basis: Basis) -> Array:
    """(C, w, K) modulated functions of the motion."""
    every = ticks_of(view.segments)
    values = np.repeat(basis.values(view.segments), every, axis=0)[: len(view.segments.angles)]
    weights = view.windows.weights[0]
    ticks = view.first[..., None] + np.arange(len(weights))
    out = np.empty((*view.first.shape, values.shape[1]))
    for segment, index in enumerate(ticks):
        out[segment] = np.einsum("wtk,t->wk", values[index], weights)
    return out


def _orders(views: Sequence[InverseDynamics], left: Sequence[Array]) -> list[int]:
    """The orders over the angle of the first axis that explain most of its missing torque, each alone."""
    axes = len(views[0].windows.axes)
    angle = np.concatenate([_middle(each).ravel() for each in views])
    values = np.concatenate([_axis(each, 0, axes).ravel() for each in left])
    worth = power_of(np.array(ORDERS, dtype=np.float64), angle, values - values.mean())
    return [ORDERS[k] for k in np.argsort(-worth)[:WAVES]]


def _middle(view: InverseDynamics) -> Array:
    """(C, w) [rad] angle of the first axis in the middle of each window."""
    axis = view.windows.axes[0]
    return view.segments.start[view.first + view.windows.weights.shape[1] // 2, axis]


def _ridge(design: Array, target: Array, groups: Array) -> Array:
    """(K,) weights with the ridge that gives the best predictions of groups left out."""
    scale = np.sqrt(np.mean(design**2, axis=0)) + 1e-12
    scaled = design / scale
    parts = [(scaled[groups == g], target[groups == g]) for g in range(FOLDS)]
    normals, pulls = [a.T @ a for a, _ in parts], [a.T @ b for a, b in parts]
    normal, pull, eye = sum(normals), sum(pulls), np.eye(len(scale)) * len(design)
    errors = np.zeros(len(RIDGES))
    for (a, b), n, p in zip(parts, normals, pulls, strict=True):
        for k, ridge in enumerate(RIDGES):
            w = cho_solve(cho_factor(normal - n + (ridge + 1e-9) * eye), pull - p)
            errors[k] += float(np.sum((b - a @ w) ** 2))
    best = RIDGES[int(np.argmin(errors))]
    return np.asarray(cho_solve(cho_factor(normal + (best + 1e-9) * eye), pull)) / scale
