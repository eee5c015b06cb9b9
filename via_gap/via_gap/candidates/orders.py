"""Orders of a periodic effect: of a torque, from the missing torque of an equation over its angle; of an encoder error,
from the error of the simulation.

    missing(angle) = sum_k amplitude_k sin(order_k angle + phase_k) + rest

An encoder error also changes the start of every segment, so its sine and cosine of each order are simulated once.
Orders are added one by one (orthogonal matching pursuit). Each time, the order whose sine and cosine explain most of
the rest is added, and all amplitudes are fitted again. The selection ends if the next order explains less than MATERIAL
of the rest.

Source: Y. C. Pati, R. Rezaiifar, P. S. Krishnaprasad, Orthogonal matching pursuit, Asilomar Conference (1993).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from math import atan2, hypot, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from via_core.signals import Array

from via_gap.candidates.fit import Fit
from via_gap.candidates.scales import SCREENED, highest_order, power_of, strongest_order
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel

MATERIAL = 0.05  # share of the rest that one more order must explain
ENCODER_ORDERS = range(1, 41)  # periods per turn of the encoder
CHANCE = 0.05
MOST_HIGH = 80  # orders beyond SCREENED that are tried
PASSES = 3  # of exchanges
SMALL = 0.1  # of the fitted amplitude: change that is simulated

Wave = tuple[float, float, float]  # amplitude, order, phase [rad]


def encoder_waves(problem: ResidualModel, fit: Fit, number: int, most: int) -> list[Wave]:
    """Waves [rad] of at most `most` orders of the encoder error `fit.effects[number]`, from the error of `fit`."""
    pull = problem.weights(fit.residual)
    columns = _encoder_columns(problem, fit, number) * pull[:, None]
    if not columns.any():
        return []
    beside = problem.nuisance_jacobian(fit.effects, fit.offsets, fit.residual) * pull[:, None]
    rest = fit.residual * pull
    kept = _pursued(columns, beside, rest, most, [0])  # order 1 is in the fit
    taken = np.column_stack([beside, _of(columns, kept)])
    amounts = np.linalg.lstsq(taken, -rest, rcond=None)[0][beside.shape[1] :].reshape(-1, 2)
    own = fit.effects[number].parameters
    amounts[0] += own["amplitude"] * np.array([np.cos(own["phase"]), np.sin(own["phase"])])
    return _waves([float(ENCODER_ORDERS[k]) for k in kept], amounts)


def _pursued(
    columns: Array, beside: Array, target: Array, most: int, given: Sequence[int] = (), share: float = MATERIAL
) -> list[int]:
    """Indices of at most `most` orders, `given` first, that explain `target` (R,) beside columns (R, b).

    share    of the rest that one more order must explain
    columns  (R, 2 n): sine and cosine of n orders in turn. Their triangular factor has the same inner products in fewer
    rows.
    """
    together = np.linalg.qr(np.column_stack([beside, columns, target]), mode="r")
    beside, columns, target = np.split(together, np.cumsum([beside.shape[1], columns.shape[1]]), axis=1)
    target = target[:, 0]
    pairs_of, kept = range(columns.shape[1] // 2), list(given)

    def best_beside(others: Sequence[int]) -> tuple[int, bool]:
        """The order that explains most beside others, and whether that is material."""
        basis = np.linalg.qr(np.column_stack([beside, _of(columns, others)]))[0]
        left, free = target - basis @ (basis.T @ target), columns - basis @ (basis.T @ columns)
        gains = np.array([np.sum((np.linalg.qr(free[:, 2 * k : 2 * k + 2])[0].T @ left) ** 2) for k in pairs_of])
        gains[list(others)] = 0.0
        best = int(np.argmax(gains))
        return best, bool(gains[best] >= share * float(left @ left))

    while len(kept) < min(most, len(pairs_of)):
        order, material = best_beside(kept)
        if not material:
            break
        kept = _exchanged([*kept, order], lambda others: best_beside(others)[0], len(given))
    return kept


def _of(columns: Array, orders: Sequence[int]) -> Array:
    """(R, 2 n) sine and cosine of these orders in turn."""
    return columns[:, [2 * k + part for k in orders for part in (0, 1)]]


def _waves(orders: Sequence[float], amounts: NDArray[Any]) -> list[Wave]:
    """Waves by amplitude, largest first, from amounts (n, 2) of sine and cosine."""
    found = [(hypot(s, c), order, atan2(c, s)) for order, (s, c) in zip(orders, amounts.tolist(), strict=True)]
    return sorted(found, key=lambda each: -each[0])


def _exchanged(kept: list[int], best_beside: Callable[[list[int]], int], given: int) -> list[int]:
    """Orders, each but the first `given` replaced by the best one beside the others until none changes.

    Over less than a turn neighbouring orders are alike, and the first choices may be wrong.
    """
    for _ in range(PASSES):
        before = list(kept)
        for i in range(given, len(kept)):
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


def torque_waves(equations: ResidualModel, row: Array, axis: int, most: int) -> list[list[Wave]]:
    """Waves of at most `most` orders of the missing torque of a row on an axis, amplitudes in N m, in two ways.

    Whole orders, and free ones: those of a rotor behind a gear need not be whole on the angle that is measured. Over
    less than a turn, several neighbouring whole orders are much like one between them.
    """
    angle, torque = _missing(equations, row, axis)
    if not len(torque):
        return []
    chosen = [_whole_orders(angle, torque, most), _free_orders(angle, torque, most)]
    return [_fitted_waves(angle, torque, each) for each in chosen if each]


def _whole_orders(angle: Array, torque: Array, most: int) -> list[float]:
    """At most `most` whole orders of torque (W,).

    Orders beyond SCREENED, of which there can be more than windows, only explain what the others leave, and more of it
    than chance.
    """
    low, constant = np.arange(1.0, SCREENED + 1.0), np.ones((len(angle), 1))
    kept = low[_pursued(_columns(angle, low), constant, torque, most)]
    high = np.arange(SCREENED + 1.0, highest_order(angle))
    power = power_of(high, angle, _left(angle, torque, kept.tolist()))
    orders = np.append(kept, high[np.argsort(-power, kind="stable")[:MOST_HIGH]])
    share = _beyond_chance(len(high), len(angle))
    return orders[_pursued(_columns(angle, orders), constant, torque, most, range(len(kept)), share)].tolist()


def _free_orders(angle: Array, torque: Array, most: int) -> list[float]:
    """At most `most` orders of torque (W,), on a grid finer than whole numbers; high ones as in `_whole_orders`."""
    kept: list[float] = []
    rest = torque - torque.mean()
    most_of_all = highest_order(angle)
    bands = ((SCREENED, MATERIAL), (most_of_all, _beyond_chance(most_of_all - SCREENED, len(angle))))
    for highest, share in bands:
        while len(kept) < most:
            more = [*kept, strongest_order(angle, rest, kept, highest)]
            left = _left(angle, torque, more)
            if left @ left > (1.0 - share) * (rest @ rest):
                break
            kept, rest = more, left
    return kept


def _beyond_chance(orders: float, windows: int) -> float:
    """Share of noise that the best of so many orders explains with a probability of CHANCE, MATERIAL at least.

    A sine and a cosine explain more than a share s of n independent values with probability (1 - s)^(n / 2). Windows
    overlap by half: half of them are independent.
    """
    return max(MATERIAL, 1.0 - (CHANCE / max(orders, 1.0)) ** (4.0 / windows))


def _columns(angle: Array, orders: Array) -> Array:
    """(W, 2 n) sine and cosine of each order in turn."""
    return np.stack([wave(orders * angle[:, None]) for wave in (np.sin, np.cos)], axis=2).reshape(len(angle), -1)


def _left(angle: Array, torque: Array, orders: Sequence[float]) -> Array:
    """What these orders and a constant leave of torque (W,)."""
    design = _design(angle, orders)
    return np.asarray(torque - design @ np.linalg.lstsq(design, torque, rcond=None)[0])


def _fitted_waves(angle: Array, torque: Array, orders: Sequence[float]) -> list[Wave]:
    fitted = np.linalg.lstsq(_design(angle, orders), torque, rcond=None)[0]
    return _waves(orders, fitted[: 2 * len(orders)].reshape(-1, 2))


def _design(angle: Array, orders: Sequence[float]) -> Array:
    """(W, 2 n + 1) sine and cosine of each order, and a constant."""
    columns = [wave(each * angle) for each in orders for wave in (np.sin, np.cos)]
    return np.column_stack([*columns, np.ones_like(angle)])


def _missing(equations: ResidualModel, row: Array, axis: int) -> tuple[Array, Array]:
    """Angle (W,) [rad] in the middle of every window of an axis, and missing torque (W,) [N m] of the row there."""
    angles, torques = [np.empty(0)], [np.empty(0)]
    for view in equations.views:
        assert isinstance(view, InverseDynamics)
        if axis in view.windows.axes:
            missing = view.torques(view.residual(row[None])[0])
            torques.append(missing[:, view.windows.axes.index(axis)].ravel())
            angles.append(view.segments.start[view.middle.ravel(), axis])
    return np.concatenate(angles), np.concatenate(torques)
