"""Probabilities of how large the noise of an equation is, over the declared one, and whether the equation fails.

Source: `interacting_models`, steps 1 and 3.
"""

from __future__ import annotations

from math import exp, log, sqrt

from numba import njit
from via_core.signals import Array

LEVELS, DECLARED = 25, 12
NOISES = tuple(10.0 ** (-3.0 + 0.25 * k) for k in range(LEVELS))  # variances over the declared one, k = DECLARED
NEVER = 1e-300  # probability of what is excluded


@njit(cache=True, error_model="numpy")
def of_level(channel: int, channels: int, k: int) -> float:
    """Prior probability of a level: all alike, but for the last channel none below the declared noise."""
    if channel < channels - 1:
        return 1.0 / LEVELS
    return 1.0 / (LEVELS - DECLARED) if k >= DECLARED else 0.0


@njit(cache=True, error_model="numpy")
def weigh(
    v: float, known: float, within: float, force: float, weights: Array, failing: float, likely: Array
) -> tuple[float, float]:  # fmt: skip
    """Update the probabilities of the levels; returns the logarithm of the likelihood and the probability of failing.

    known  variance of v without the noise within
    """
    highest = -0.5 * v * v / (known + max(NOISES[LEVELS - 1] * within, force))
    held = 0.0
    for k in range(LEVELS):
        S = known + NOISES[k] * within
        likely[k] = weights[k] * exp(-0.5 * v * v / S - highest) / sqrt(S)
        held += likely[k]
    failed = failing * exp(-0.5 * v * v / (known + force) - highest) / sqrt(known + force) if force > 0.0 else 0.0
    total = (1.0 - failing) * held + failed
    if not total > 0.0:
        return log(NEVER), failing
    failed /= total
    if held > 0.0:
        for k in range(LEVELS):
            weights[k] += (1.0 - failed) * (likely[k] / held - weights[k])
    return highest + log(total), failed
