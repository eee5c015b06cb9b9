"""Error metrics of estimates and simulations against the truth or a measurement.

All take arrays (N,) of equal length and raise SignalError for empty, unequal or non-finite ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from via_core.errors import SignalError
from via_core.signals import Array

WIDTH_95 = 1.96  # half width of the 95 % interval of a Gaussian, in standard deviations


def alike(**given: ArrayLike) -> list[Array]:
    """The arrays (N,). Raises SignalError, which names the wrong one."""
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in given.items()}
    shapes = {array.shape for array in arrays.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        raise SignalError(
            f"need arrays (N,) of equal length, got {', '.join(f'{n} {a.shape}' for n, a in arrays.items())}"
        )
    for name, array in arrays.items():
        if array.size == 0:
            raise SignalError(f"'{name}' is empty")
        if not np.all(np.isfinite(array)):
            raise SignalError(f"'{name}' is not finite at sample {int(np.flatnonzero(~np.isfinite(array))[0])}")
    return list(arrays.values())


def nrmse(measured: ArrayLike, simulated: ArrayLike) -> float:
    """Root mean square error over the standard deviation of the measured signal [-]; 1 for predicting its mean.

    Raises SignalError where the measured signal is constant.
    """
    a, b = alike(measured=measured, simulated=simulated)
    scale = float(np.std(a))
    if scale == 0.0:
        raise SignalError("'measured' is constant: its standard deviation cannot scale the error")
    return float(np.sqrt(np.mean((a - b) ** 2)) / scale)


def coverage(truth: ArrayLike, estimate: ArrayLike, standard_deviation: ArrayLike, width: float = 2.0) -> float:
    """Fraction [0..1] of samples whose truth lies within `width` standard deviations; .954 for 2 if Gaussian.

    Raises SignalError for a negative standard deviation or a width that is not > 0.
    """
    a, b, sd = alike(truth=truth, estimate=estimate, standard_deviation=standard_deviation)
    if np.any(sd < 0.0):
        raise SignalError(f"'standard_deviation' is negative at sample {int(np.flatnonzero(sd < 0.0)[0])}")
    if not width > 0.0:
        raise SignalError(f"width must be > 0, got {width}")
    return float(np.mean(np.abs(a - b) <= width * sd))
