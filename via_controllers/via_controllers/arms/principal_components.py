"""Principal directions of a joint motion, updated sample by sample: eqs. (113)-(119) corrected.

    y_i = w_i' (q - q_0),   w_i <- w_i + gamma y_i (q - q_0 - y_i w_i - sum_{j<i} y_j w_j),   w on the right from before

converges for gamma max(y^2) << 1 to the p dominant eigenvectors, of unit length, of the covariance
E{(q - q_0) (q - q_0)'}, the most dominant first.

(116), (118): the gradient is that of S = 1/2 |q - q_0 - w w' (q - q_0)|^2 with |w| = 1, not of one quarter of it.
(119): printed with 2 sum_{j<i}. That belongs to w_j after the step; with w_j before the step the factor is one.
C: printed with q. The mean is no motion: the joints oscillate about the static equilibrium q_0.
gamma << 1: gamma has a unit, 1/rad^2; the step is stable for gamma y^2 < 2.
(113)-(115): modes q = w_1 y_1 + .. with orthonormal w are those of K^(1/2) q or of M^(1/2) q; in plain q the first
component is a mode if one mode dominates, and the others are none.
Source: the document's Section 6.2; T. D. Sanger, Neural Networks 2(6), 1989; E. Oja, J. Math. Biology 15, 1982.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from via_core.signals import Array

MOST = 0.5  # largest gamma |q - q_0|^2 of a step: larger steps would scatter the directions


@njit(cache=True, error_model="numpy")
def adapted(directions: Array, gain: float, motion: Array) -> Array:
    """w after one sample: `directions` (n, p) are columns, `gain` gamma >= 0 [1/rad^2], `motion` q - q_0 (n,) [rad]."""
    n, p = directions.shape
    squared = float(np.sum(motion**2))
    gamma = min(gain, MOST / squared) if squared > 0.0 else gain
    out, rest = np.empty((n, p)), motion.copy()
    for i in range(p):
        w = np.ascontiguousarray(directions[:, i])
        y = w @ motion
        rest = rest - y * w
        out[:, i] = w + gamma * y * rest
    return out
