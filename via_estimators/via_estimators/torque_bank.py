"""The equations of the present window of a joint, given to the bank of filters of `interacting_models`.

Equations: `modulated_torque`; their regressors: `torque_equation`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators import interacting_models, torque_equation, transmissions, window
from via_estimators.interacting_models import Bank, Work
from via_estimators.slots import slots
from via_estimators.torque_equation import LINK, PHI, P, U
from via_estimators.transmissions import VISITED

ROWS_PER_WINDOW = 2  # equations per window length: the noise of neighbours then has a correlation of .04
SLOW_FORCE = 1.0  # [s] how long forces at the link last that exceed its noise
# Of each transmission: range of the deflection in the last window [rad], 1 if it was informative; equations taken.
KEPT = slots("moved", "moving", "taken", after=VISITED)


@njit(cache=True, error_model="numpy")
def unroll(ring: Array, oldest: int, out: Array) -> None:
    """Copy a ring (.., L) into out (.., L), oldest first."""
    length = ring.shape[-1]
    for i in range(ring.shape[0]):
        for k in range(length):
            at = oldest + k
            out[i, k] = ring[i, at if at < length else at - length]


@njit(cache=True, error_model="numpy")
def _learn_motor(
    par: Array, times: Array, psi: Array, held: Array, late: Array, own: Array, i: int, bank: Bank, row: Array,
    none: Array, work: Work,
) -> None:  # fmt: skip
    """Add the equation of motor i in the present window `own`; `row`, `none` (n,) are overwritten."""
    n, length, m = row.size, times.size, int(par[P.transmissions])
    block = (n - m - LINK.size) // m
    part = slice(i * block, (i + 1) * block)
    mean, width = par[P.size : P.size + n][part], par[P.size + n : P.size + 2 * n][part]
    x, covariance = bank.x[-1][part], bank.P[-1][part, part]
    row[:], none[:] = 0.0, 0.0
    own_row, span, dry = row[part], times[length - 1] - times[0], slice(U.friction, U.slow + 1)
    y, unknown = torque_equation.fill_motor(par, psi, held, late, own, span, width[U.delay] * x[U.delay], own_row)
    stiffness = torque_equation.stiffness(par, mean, width, x, own[PHI, length // 2], none[part])[0]
    none[:] = 0.0
    inertia, damping, friction = mean[:3] + width[:3] * x[:3]
    within = angles = 0.0
    for k in range(length):
        of_link = stiffness * psi[0, k]
        of_motor = inertia * psi[2, k] - damping * psi[1, k] + of_link
        within += held[k] * held[k]
        angles += of_motor * of_motor + of_link * of_link
    friction += mean[U.slow] + width[U.slow] * x[U.slow]
    any_friction = friction**2 + interacting_models.quadratic(covariance[dry, dry], width[dry])
    beside = par[P.position_noise] ** 2 * angles + unknown**2 * any_friction
    for j in range(block):
        y -= own_row[j] * mean[j]
        own_row[j] *= width[j]
    within *= par[P.torque_noise] ** 2
    interacting_models.take(bank, i, row, y, within, beside, none, 0.0, 0.0, (0, 0), work)


@njit(cache=True, error_model="numpy")
def _learn_link(
    par: Array, times: Array, psi: Array, own: Array, bank: Bank, row: Array, noisy: Array, work: Work
) -> None:  # fmt: skip
    """Add the equation of the link in the present windows `own` (m, 3, L); `row`, `noisy` (n,) are overwritten."""
    n, length, m = row.size, times.size, own.shape[0]
    first = n - m - LINK.size
    block, link = first // m, slice(first, first + LINK.size)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    x, covariance, span = bank.x[-1], bank.P[-1], times[length - 1] - times[0]
    row[:], noisy[:] = 0.0, 0.0
    unknown = torque_equation.fill_link(par, psi, own[0], span, row[link])
    stiff, slopes, of_link = np.empty(m), np.empty(m), mean[link] + width[link] * x[link]
    for i in range(m):
        part = slice(i * block, (i + 1) * block)
        torque_equation.fill_spring(par, psi, own[i, PHI], 1.0, row[part])
        middle = own[i, PHI, length // 2]
        stiff[i] = torque_equation.stiffness(par, mean[part], width[part], x[part], middle, noisy[part])[0]
    doubt = width[first] ** 2 * covariance[first, first]
    within = torque_equation.link_noise(par, psi, of_link, doubt, stiff, noisy[first:], slopes)
    for i in range(m):
        noisy[i * block : (i + 1) * block] *= slopes[i]
    noisy[link] *= width[link]
    noisy /= within
    dry = slice(first + LINK.friction, first + LINK.slow + 1)
    friction = of_link[LINK.friction] + of_link[LINK.slow]
    any_friction = friction**2 + interacting_models.quadratic(covariance[dry, dry], width[dry])
    y = springs = 0.0
    for j in range(first + LINK.size):
        y -= row[j] * mean[j]
        springs += row[j] * (mean[j] + width[j] * x[j]) if j < first else 0.0
        row[j] *= width[j]
    force = par[P.force_deviation] ** 2 + springs**2  # a contact may take up all that the springs exert
    interacting_models.take(
        bank, m, row, y, within, unknown**2 * any_friction, noisy, SLOW_FORCE / (0.5 * span), force,
        (first, first + LINK.size), work,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def learn(
    par: Array, times: Array, psi: Array, held: Array, late: Array, ring: Array, slot: int, own: Array, parts: Array,
    bank: Bank, directions: Array, row: Array, spare: Array, work: Work,
) -> None:  # fmt: skip
    """Add the equations of the present window, and its middle part to the deflections visited, which include 0."""
    n, length, m = row.size, times.size, own.shape[0]
    block, oldest = (n - m - LINK.size) // m, window.oldest_of(slot, length)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    span, any_moving = times[length - 1] - times[0], False
    directions[:] = 0.0
    for i in range(m):
        unroll(ring[i], oldest, own[i])
        kept, moved = parts[i], window.span_of(own[i, PHI])
        kept[KEPT.moved], kept[KEPT.moving] = moved, 1.0 if moved >= par[P.minimum_motion] else 0.0
        any_moving = any_moving or kept[KEPT.moving] > 0.0
        for j in range(i * block + U.size, (i + 1) * block):
            directions[i, j] = mean[j] / width[j] + bank.x[-1, j]
    if not any_moving:
        return
    middle = times[length // 2]
    interacting_models.begin(bank, middle, par[P.memory], par[P.steadiness], directions, span, work)
    for i in range(m):
        kept = parts[i]
        if kept[KEPT.moving] > 0.0:
            _learn_motor(par, times, psi, held, late, own[i], i, bank, row, spare, work)
            kept[KEPT.taken] += 1.0
            quarter = length // (2 * ROWS_PER_WINDOW)
            for k in range(quarter, length - quarter):
                transmissions.visit(kept, own[i, PHI, k] if par[P.even_terms] > 0.0 else abs(own[i, PHI, k]))
            kept[VISITED.high] = max(kept[VISITED.high], 0.0)
    _learn_link(par, times, psi, own, bank, row, spare, work)
    interacting_models.combine(bank)
