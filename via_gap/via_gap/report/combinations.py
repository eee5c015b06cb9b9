"""Combinations of an effect's parameters that the data may determine better than the single parameters.

A motion may determine only m l and m l^2 of a payload, or only the deflection at which an element slips. The
standard deviation of a combination f(p) follows from the covariance C of the parameters by the delta method,

    sd(f)^2 = grad f(p)' C grad f(p)

The combinations of an effect are reported if the relative standard deviation of one is below that of every single
parameter.
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array
from via_sim.effects import Effect

from via_gap.report.report import Combination

SMALLEST = 1e-300  # divisor


def combinations(effect: Effect, covariance: Array) -> tuple[Combination, ...]:
    """The combinations of an effect, if one is known better than its parameters.

    covariance  (p, p) of the parameters in their order, in their units
    """
    names = list(effect.parameters)
    found, better = [], False
    for form in effect.kind.forms:
        which = [names.index(name) for name in form.names]
        values = [effect.parameters[name] for name in form.names]
        gradient = np.asarray(form.gradient(*values))
        own = covariance[np.ix_(which, which)]
        sd, value = float(np.sqrt(max(gradient @ own @ gradient, 0.0))), float(form.value(*values))
        single = np.sqrt(np.diag(own)) / np.maximum(np.abs(values), SMALLEST)
        better |= bool(sd / max(abs(value), SMALLEST) < np.min(single))
        found.append(Combination(expression=form.expression, value=value, sd=sd, unit=form.unit))
    return tuple(found) if better else ()
