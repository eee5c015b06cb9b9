"""How much of a torque the angles alone predict: splines whose number of intervals held-out error decides.

A torque that a controller computes from the angle shows this controller, whatever the joint does.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from via_core.signals import Array

from via_gap.log import JointLog

PASSES = 8  # blocks of time, each predicted from the others
KNOTS = (6, 12, 24, 48)  # intervals of the splines over an angle; held-out error decides
LAGS = 6  # samples by which a recorded torque may follow the angle it was computed from
POINTS = 4000  # samples that a regression sees: enough for 48 intervals
RIDGE = 1e-9  # of the largest normal-equation term: intervals without samples
VISITED = 0.5  # share of samples whose angle other blocks visited, from which the rest is as they are


def left_by_angles(log: JointLog, tau: Array) -> tuple[float, float, float] | None:
    """Held-out mean square of a torque that splines over the angles leave, its variance, and the share of samples.

    Blocks of time are predicted from the others, where these visited the same angles. None where fewer than half of
    the samples were visited twice.
    """
    angles = [log.measured["q"]]
    if "theta" in log.measured and log.device.n_motors:
        angles += [*log.measured["theta"].T, *(log.measured["q"] - each for each in log.measured["theta"].T)]
    best: tuple[float, float, float] | None = None
    for lag in range(LAGS):
        x = np.column_stack(angles)[: len(tau) - lag]
        y = tau[lag:]
        good = np.isfinite(x).all(axis=1) & np.isfinite(y)
        every = max(1, int(good.sum()) // POINTS)
        x, y = x[good][::every], y[good][::every]
        if len(y) < 100 or np.any(np.ptp(x, axis=0) == 0.0):
            return None
        for knots in KNOTS:
            left = _held_out(x, y, knots)
            if left is not None and (best is None or left[0] < best[0]):
                best = left
    return best


def _held_out(x: Array, y: Array, knots: int) -> tuple[float, float, float] | None:
    low, high = x.min(axis=0), x.max(axis=0)
    unit = np.clip((x - low) / (high - low), 0.0, 1.0)
    grid = np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, knots + 1), np.ones(3)))
    design = np.hstack([BSpline.design_matrix(column, grid, 3).toarray() for column in unit.T])
    block = np.arange(len(y)) * PASSES // len(y)
    cell = np.minimum((unit[:, 0] * knots).astype(int), knots - 1)
    counted = np.zeros((PASSES, knots))
    np.add.at(counted, (block, cell), 1.0)
    others = counted.sum(axis=0) - counted
    known = others[block, cell] >= 4.0  # a cubic has four coefficients
    if known.mean() < VISITED:
        return None
    errors = np.empty(len(y))
    for k in range(PASSES):
        fit = block != k
        normal = design[fit].T @ design[fit]
        normal += RIDGE * np.max(np.diag(normal)) * np.eye(len(normal))
        errors[~fit] = y[~fit] - design[~fit] @ np.linalg.solve(normal, design[fit].T @ y[fit])
    return float(np.mean(errors[known] ** 2)), float(np.var(y[known])), float(known.mean())
