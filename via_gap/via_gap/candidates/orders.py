"""Orders of a periodic torque, selected from the missing torque of an equation over its angle.

    missing(angle) = sum_k amplitude_k sin(order_k angle + phase_k) + rest

Orders are added one by one: the one whose sine and cosine explain most of the rest, then all amplitudes are fitted
again (orthogonal matching pursuit). The selection ends if the next order explains less than MATERIAL of the rest.

Source: Y. C. Pati, R. Rezaiifar, P. S. Krishnaprasad, Orthogonal matching pursuit, Asilomar Conference (1993).
"""

from __future__ import annotations

from math import atan2, hypot

import numpy as np
from via_core.signals import Array

from via_gap.candidates.scales import APART, ORDERS
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel

MATERIAL = 0.05  # share of the rest that one more order must explain


def harmonics(equations: ResidualModel, row: Array, axis: int, most: int) -> list[tuple[float, float, float]]:
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
