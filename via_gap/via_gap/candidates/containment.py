"""Device parameters that the effects of a model contain.

Example: the motion shows only the sum of the inertia in the device file and of `link_inertia`. A joint fit of both is
ill-conditioned and would stop anywhere. So while the effect is in the model, the device parameter keeps its filed
value, and the effect contains the error of that value. This is also where the loss is least, because the loss penalises
only the offset of the device parameter. The tolerance of the filed value is added to the covariance of the effect.

An effect contains a device parameter if it can reproduce every small change of it in the parameter row. Parameters
whose range ends at the neutral value (a mass, a dry friction) cannot compensate errors of both signs near that end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from via_core.signals import Array, Mask
from via_sim.effects.device_numbers import with_spring_scales

STEP = 1e-3  # of a coordinate
ROUNDING = 1e-6  # of a change of the row
SAME = 1e-13  # relative: closer numbers of two rows differ by rounding


def contained(row: Callable[[Array], Array | None], at: Array, two_sided: Mask) -> Array:
    """(J, p) changes of the effects' parameters that equal one standard deviation of each device parameter.

    row        parameter row at coordinates (J + p,) of a fit; None: invalid
    at         coordinates of effects; those of device parameters are 0
    two_sided  (p,) whether a parameter can take up errors of either sign

    0 for device parameters that the effects do not contain. All in coordinates of the fit.
    """
    count = len(at) - len(two_sided)
    found = np.zeros((count, len(two_sided)))
    here = row(at)
    own = count + np.flatnonzero(two_sided)
    if here is None or not len(own):
        return found
    before = with_spring_scales(here)
    slopes = np.stack([_slope(row, at, before, i) for i in (*range(count), *own)], axis=1)
    numbers, effects = slopes[:, :count], slopes[:, count:]
    sizes = np.linalg.norm(effects, axis=0)
    effects = effects / np.where(sizes > 0.0, sizes, 1.0)
    changes = np.linalg.lstsq(effects, numbers, rcond=None)[0]
    missed = np.linalg.norm(numbers - effects @ changes, axis=0)
    exact = missed < ROUNDING * np.linalg.norm(numbers, axis=0)
    found[np.ix_(exact, own - count)] = (changes / np.where(sizes > 0.0, sizes, 1.0)[:, None]).T[exact]
    return found


def _slope(row: Callable[[Array], Array | None], at: Array, before: Array, i: int) -> Array:
    """(N_PARAMETERS,) derivative of the row by coordinate `i`; 0 if a step is invalid to both sides.

    before  row at `at`, by `with_spring_scales`
    """
    for step in (STEP, -STEP):
        there = at.copy()
        there[i] += step
        moved = row(there)
        if moved is not None:
            after, change = with_spring_scales(moved), np.zeros_like(before)
            np.subtract(after, before, out=change, where=~np.isclose(after, before, SAME, 0.0))  # limits are infinite
            return change / step
    return np.zeros_like(before)
