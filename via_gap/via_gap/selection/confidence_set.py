"""Model confidence set: the models that held-out losses cannot distinguish from the best.

Models are eliminated one by one while the hypothesis that the remaining ones are equally good is rejected. With the
mean difference d_ij of the block losses of models i and j and its bootstrap standard deviation s_ij,

    T = max_ij (d_ij - margin) / s_ij,     eliminated first: argmax_i max_j (d_ij - margin) / s_ij

and T is rejected where it exceeds the 1 - alpha quantile of its bootstrap distribution, in which differences are
centred. Models closer than the margin count as equal for any amount of data, as in tests of equivalence.

Source: P. R. Hansen, A. Lunde, J. M. Nason, The Model Confidence Set, Econometrica 79 (2011), sections 2.1 and 3.1
(range statistic). Departure: the margin.
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array, Indices


def confidence_set(losses: Array, picks: Indices, margin: float, alpha: float) -> tuple[Indices, Array]:
    """Indices of the models kept, best first, and the p-value (K,) of each model's membership.

    losses  (K, B) of K models on B blocks
    picks   (R, B) resampled blocks
    """
    count = len(losses)
    means = losses.mean(axis=1)
    resampled = losses[:, picks].mean(axis=2) - means[:, None]  # (K, R), centred
    gap = means[:, None] - means[None, :]  # (K, K) how much worse i is than j
    varied = resampled[:, None] - resampled[None, :]  # (K, K, R)
    size = np.sqrt(np.mean(varied**2, axis=2)) + 1e-12
    statistic, noise = (gap - margin) / size, varied / size[:, :, None]
    kept, membership, highest = list(range(count)), np.ones(count), 0.0
    while len(kept) > 1:
        among = np.ix_(kept, kept)
        worst = statistic[among].max(axis=1)
        limit = noise[among].reshape(len(kept) ** 2, -1).max(axis=0)
        highest = max(highest, float(np.mean(limit >= worst.max())))
        if highest > alpha:
            break
        out = kept[int(np.argmax(worst))]
        membership[out] = highest
        kept.remove(out)
    for each in kept:
        membership[each] = max(highest, alpha) if len(kept) > 1 else 1.0
    best = min(kept, key=lambda k: means[k])
    membership[best] = 1.0
    return np.array(sorted(kept, key=lambda k: means[k]), dtype=np.intp), membership
