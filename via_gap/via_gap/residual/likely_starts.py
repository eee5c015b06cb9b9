"""Most likely starts: of every segment under a model, and of motors without an encoder when a log begins.

Let d be the difference of a start from the measured one, in standard deviations, and e(d) the errors of the simulation,
in units of their noise. The most likely d minimises |e(d)|^2 + |d|^2. It is found by Gauss-Newton steps with finite
differences.

A linearisation about the measured start is not sufficient where the motion is sensitive to it. Example: a slow axis
with a torque ripple of many periods stops in one of them or in the next.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from via_core.signals import Array

STEP = 0.02  # standard deviations: finite difference of a start
ROUNDS, ENOUGH = 6, 1e-3  # steps at most; share of the loss from which one more is not worth it
SHARES = (1.0, 0.3, 0.1)  # of a step

Errors = Callable[[Array], Array]


def likely_starts(errors: Errors, segments: int, count: int) -> tuple[Array, Array]:
    """The most likely d (C, k) of each of C segments, and the derivatives (C, R, k) of its errors there.

    errors  of d (C, k): (C, R)
    """
    at = np.zeros((segments, count))
    now = errors(at)
    loss = np.sum(now**2, axis=1)
    slopes = _slopes(errors, at, now)
    for _ in range(ROUNDS):
        normal = np.einsum("cri,crj->cij", slopes, slopes) + np.eye(count)
        pull = np.einsum("cri,cr->ci", slopes, now) + at
        step = np.linalg.solve(normal, pull[..., None])[..., 0]
        before = loss.sum()
        for share in SHARES:
            trial = at - share * step
            found = errors(trial)
            reached = np.sum(found**2, axis=1) + np.sum(trial**2, axis=1)
            better = reached < loss
            at, now = np.where(better[:, None], trial, at), np.where(better[:, None], found, now)
            loss = np.where(better, reached, loss)
        slopes = _slopes(errors, at, now)
        if not before - loss.sum() > ENOUGH * loss.sum():
            break
    return at, slopes


def _slopes(errors: Errors, at: Array, now: Array) -> Array:
    """(C, R, k) derivatives of the errors `now` (C, R) at d (C, k)."""
    return np.stack([(errors(at + STEP * unit) - now) / STEP for unit in np.eye(at.shape[-1])], axis=-1)


def likely_start(errors: Errors, count: int) -> Array:
    """The most likely d (k,) that all segments share, with a loss that unexplained segments do not dominate.

    errors  of several d (M, k): (M, C, R)
    """
    at, loss = np.zeros(count), np.inf
    (now,) = errors(at[None])
    for _ in range(ROUNDS):
        squares = np.mean(now**2, axis=1)
        pull = np.sqrt(np.minimum(2.0 / (1.0 + squares), 1.0))[:, None]
        slopes = np.moveaxis((errors(at + STEP * np.eye(count)) - now) / STEP, 0, -1)
        flat, weighed = (slopes * pull[..., None]).reshape(-1, count), (now * pull).ravel()
        step = np.linalg.solve(flat.T @ flat + np.eye(count), flat.T @ weighed + at)
        tries = np.stack([at - share * step for share in SHARES])
        found = errors(tries)
        losses = [
            float(np.sum(np.log1p(np.mean(e**2, axis=1))) * now.shape[1] + a @ a)
            for a, e in zip(tries, found, strict=True)
        ]
        best = int(np.argmin(losses))
        gain = loss - losses[best]
        if gain > 0.0:
            at, now, loss = tries[best], found[best], losses[best]
        if not gain > ENOUGH * loss:
            break
    return at
