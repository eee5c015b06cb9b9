"""A fit continued to convergence, with standard deviations that include what a fit in the search leaves out.

In the search, segments start from their measured states, and errors of these states are included to first order. Here
segments start from the most likely states under the fit (residual/likely_starts.py).
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array

from via_gap.candidates.covariance import clustered_covariance, clusters
from via_gap.candidates.fit import LEAST_STEP, Axes, Fit
from via_gap.candidates.refinement import fit_on
from via_gap.candidates.scales import Scales
from via_gap.residual.nuisance import BOUND
from via_gap.residual.residual_model import STEP, ResidualModel

FINE = 0.03  # of a step: the truncation of central differences then has 1e-4 of the information of a tolerance
TURNS = 2  # steps of `converged` at most


def converged(problem: ResidualModel, fit: Fit, scales: Scales) -> Fit:
    """A fit continued along directions in which the loss is nearly flat, with standard deviations that include them.

    Without a recorded torque, all torques and inertias of a joint may grow together without any change of the motion;
    only the tolerances of the device limit them. `refine` ends anywhere on such a line. Its one-sided differences bend
    the line, so that it seems well determined. Central differences do not, and one step with them is nearly exact. From
    the end of a tolerance differences are one-sided, and a second step is needed.
    """
    likely = problem.at_likely_starts(problem.row(fit.effects, fit.offsets))
    axes = Axes.of(likely, fit.members, scales, fitted=True)
    count = axes.count
    (here,) = likely.answer([axes.best([axes.coordinates(fit.offsets, fit.values)])])
    for _ in range(TURNS):
        begin, at = here, here.at
        slopes = _central_slopes(axes, at)
        normal, wanted = axes.step(here, slopes)
        for share in (1.0, 0.5, 0.25):
            (trial,) = likely.answer([axes.best([at + share * (wanted - at)])])
            if trial.loss < here.loss:
                here = trial
                break
        if np.all(np.abs(at[:count]) < BOUND):
            break
    covariance, pull = axes.covariance(here, normal), likely.weights(begin.residual)
    scored = slopes * pull[:, None], pull * here.residual, normal, count
    variance = np.diag(covariance)
    for cluster in clusters(likely):
        variance = np.maximum(variance, np.diag(clustered_covariance(likely, cluster, *scored)))
    covariance *= np.outer(*2 * (np.sqrt(variance / np.diag(covariance)),))
    known = np.any(slopes[:, count:] != 0.0, axis=0)
    sd = np.where(known, np.minimum(np.sqrt(np.diag(covariance)), axes.high - axes.low), axes.sd(fit))
    return fit_on(problem, axes.fit(here, covariance, sd))


def _central_slopes(axes: Axes, at: Array) -> Array:
    """(R, J + p) derivatives of the residual; 0 for times, fixed parameters and those without valid neighbours."""
    low, high = axes.box
    steps = FINE * np.append(
        STEP / np.array([each.tolerance for each in axes.problem.nuisances]),
        np.maximum(LEAST_STEP, 0.03 * np.abs(at[axes.count :])),
    )
    around = [np.clip(at + sign * steps, low, high) for sign in (1.0, -1.0)]
    moved = axes.problem.answer([axes.losses([*(at + np.diag(each - at))]) for each in around])
    ahead, behind = (residuals for _, residuals in moved)
    slopes = ((ahead - behind) / (around[0] - around[1])[:, None]).T
    known = np.isfinite(slopes[0]) & np.append(~axes.held, ~(axes.times | axes.fixed))
    slopes[:, ~known] = 0.0
    return np.asarray(slopes)
