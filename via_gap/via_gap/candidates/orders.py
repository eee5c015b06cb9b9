"""Orders of a periodic effect: of a torque, from the missing torque of an equation over its angle; of an encoder error,
from the error of the simulation.

    missing(angle) = sum_k amplitude_k sin(order_k angle + phase_k) + rest

An encoder error also changes the start of every segment, so its sine and cosine of each order are simulated once.
Orders are added one by one: the one whose sine and cosine explain most of the rest, then all amplitudes are fitted
again (orthogonal matching pursuit). The selection ends if the next order explains less than MATERIAL of the rest.

Source: Y. C. Pati, R. Rezaiifar, P. S. Krishnaprasad, Orthogonal matching pursuit, Asilomar Conference (1993).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from math import atan2, hypot, pi

import numpy as np
from via_core.signals import Array

from via_gap.candidates.fit import Fit
from via_gap.candidates.scales import APART, ORDERS
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel

MATERIAL = 0.05  # share of the rest that one more order must explain
ENCODER_ORDERS = range(1, 41)  # periods per turn of the encoder
PASSES = 3  # of exchanges
SMALL = 0.1  # of the fitted amplitude: change that is simulated

Wave = tuple[float, float, float]  # amplitude, order, phase [rad]


def encoder_waves(problem: ResidualModel, fit: Fit, number: int, most: int) -> list[Wave]:
    """At most `most` orders of the encoder error `fit.effects[number]`, amplitudes in rad, from the error of `fit`."""
    pull = problem.weights(fit.residual)
    columns = _encoder_columns(problem, fit, number) * pull[:, None]
    if not columns.any():
        return []
    beside = problem.nuisance_jacobian(fit.effects, fit.offsets, fit.residual) * pull[:, None]
    rest, kept = fit.residual * pull, [0]  # order 1 is in the fit

    def best_beside(others: Sequence[int]) -> tuple[int, bool]:
        """The order that explains most beside others, and whether that is material."""
        basis = np.linalg.qr(np.column_stack([beside, *(columns[:, 2 * k : 2 * k + 2] for k in others)]))[0]
        left, free = rest - basis @ (basis.T @ rest), columns - basis @ (basis.T @ columns)
        gains = np.array([_gain(free[:, 2 * k : 2 * k + 2], left) for k in range(len(ENCODER_ORDERS))])
        gains[list(others)] = 0.0
        best = int(np.argmax(gains))
        return best, bool(gains[best] >= MATERIAL * float(left @ left))

    while len(kept) < most:
        order, material = best_beside(kept)
        if not material:
            break
        kept = _exchanged([*kept, order], lambda others: best_beside(others)[0])
    taken = np.column_stack([beside, *(columns[:, 2 * k : 2 * k + 2] for k in kept)])
    amounts = np.linalg.lstsq(taken, -rest, rcond=None)[0][beside.shape[1] :].reshape(-1, 2)
    own = fit.effects[number].parameters
    amounts[0] += own["amplitude"] * np.array([np.cos(own["phase"]), np.sin(own["phase"])])
    orders = [float(ENCODER_ORDERS[k]) for k in kept]
    found = [(hypot(s, c), order, atan2(c, s)) for order, (s, c) in zip(orders, amounts.tolist(), strict=True)]
    return sorted(found, key=lambda each: -each[0])


def _exchanged(kept: list[int], best_beside: Callable[[list[int]], int]) -> list[int]:
    """Orders, each but the first replaced by the best one beside the others until none changes.

    Over less than a turn neighbouring orders are alike, and the first choices may be wrong.
    """
    for _ in range(PASSES):
        before = list(kept)
        for i in range(1, len(kept)):
            kept[i] = best_beside(kept[:i] + kept[i + 1 :])
        if kept == before:
            break
    return kept


def _encoder_columns(problem: ResidualModel, fit: Fit, number: int) -> Array:
    """(R, 2 orders) change of the residual per rad of sine and cosine of each order of an encoder error; 0: invalid."""
    effect, rows = fit.effects[number], []
    size = SMALL * abs(effect.parameters["amplitude"])
    for order, phase in product(map(float, ENCODER_ORDERS), (0.0, 0.5 * pi)):
        more = {**effect.parameters, "amplitude_2": size, "order_2": order, "phase_2": phase}
        changed = [replace(effect, parameters=more) if each is effect else each for each in fit.effects]
        rows.append(problem.row_or_none(changed, fit.offsets))
    valid = [row for row in rows if row is not None]
    columns = np.zeros((len(fit.residual), len(rows)))
    if size > 0.0 and valid:
        columns[:, [row is not None for row in rows]] = (problem.residual(valid) - fit.residual).T / size
    return columns


def _gain(pair: Array, left: Array) -> float:
    """Squares of `left` (R,) that two columns (R, 2) explain."""
    basis = np.linalg.qr(pair)[0]
    return float(np.sum((basis.T @ left) ** 2))


def torque_waves(equations: ResidualModel, row: Array, axis: int, most: int) -> list[Wave]:
    """(amplitude [N m], order, phase [rad]) of at most `most` orders of the missing torque of a row on an axis."""
    angle, torque = _missing(equations, row, axis)
    if not len(torque):
        return []
    kept: list[float] = []
    rest = torque - torque.mean()
    weights = np.empty(0)
    while len(kept) < most:
        order = _strongest(angle, rest, kept)
        columns = [wave(each * angle) for each in (*kept, order) for wave in (np.sin, np.cos)]
        design = np.column_stack([*columns, np.ones_like(angle)])
        fitted = np.linalg.lstsq(design, torque, rcond=None)[0]
        left = torque - design @ fitted
        if left @ left > (1.0 - MATERIAL) * (rest @ rest):
            break
        kept, rest, weights = [*kept, order], left, fitted
    pairs = weights[: 2 * len(kept)].reshape(-1, 2)
    found = [(hypot(s, c), order, atan2(c, s)) for order, (s, c) in zip(kept, pairs.tolist(), strict=True)]
    return sorted(found, key=lambda each: -each[0])


def _missing(equations: ResidualModel, row: Array, axis: int) -> tuple[Array, Array]:
    """Angle (W,) [rad] in the middle of every window of an axis, and missing torque (W,) [N m] of the row there."""
    angles, torques = [np.empty(0)], [np.empty(0)]
    for view in equations.views:
        assert isinstance(view, InverseDynamics)
        windows = view.windows
        if axis not in windows.axes:
            continue
        at = windows.axes.index(axis)
        values = view.residual(row[None])[0].reshape(len(view.chosen), len(windows.axes), -1)[:, at]
        torques.append(values.ravel() * windows.floor[at])
        angles.append(view.segments.start[view.first.ravel() + windows.weights.shape[1] // 2, axis])
    return np.concatenate(angles), np.concatenate(torques)


def _strongest(angle: Array, rest: Array, taken: list[float]) -> float:
    """The order, not yet taken, whose sine and cosine explain most of the rest."""
    waves = np.exp(1j * ORDERS[:, None] * angle)
    waves -= waves.mean(axis=1, keepdims=True)
    power = np.abs(waves @ rest) ** 2 / np.maximum(np.sum(np.abs(waves) ** 2, axis=1), 1.0)
    power[[any(abs(order - other) < APART for other in taken) for order in ORDERS]] = 0.0
    return float(ORDERS[int(np.argmax(power))])
