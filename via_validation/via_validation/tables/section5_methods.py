"""Estimators of Section 5, and measures of a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from via_core.devices import load_device
from via_core.signals import Array
from via_estimators.contract import Estimates, Estimator, rows_of
from via_estimators.damping_directional import DampingDirectional
from via_estimators.damping_mixture import DampingMixture
from via_estimators.damping_rls import DampingRLS
from via_sim.simulate import Simulation

from via_validation.tables.vpda import CONVERGED, DEVICE

PERCENT = 100.0


def mixture() -> DampingMixture:
    """The device's default estimator, as shipped."""
    return DampingMixture.from_device(load_device(DEVICE))


def directional(terms: int, **changes: Any) -> DampingDirectional:
    """The directional-forgetting estimator with n = `terms`, and with these parameters changed."""
    base = DampingDirectional.from_device(load_device(DEVICE))
    return base.with_parameters(replace(base.parameters, terms=terms, **changes))


def least_squares(**changes: Any) -> DampingRLS:
    """The RLS estimator with these parameters changed."""
    base = DampingRLS.from_device(load_device(DEVICE))
    return base.with_parameters(replace(base.parameters, **changes))


def methods() -> dict[str, tuple[str, Estimator]]:
    """Id -> (description, estimator)."""
    return {
        "default": ("damping_mixture, the default", mixture()),
        "directional": ("damping_directional as shipped, n = 1 and dry friction", directional(1)),
        "directional_n2": ("damping_directional, but n = 2", directional(2)),
        "n1": ("Algorithm 1 made safe, n = 1", directional(1, dry_friction=0.0)),
        "n2": (
            "Algorithm 1 made safe, n = 2, powers equal at 4 rad/s",
            directional(2, dry_friction=0.0),
        ),
        "n2_printed_powers": (
            "Algorithm 1 made safe, n = 2, powers as printed",
            directional(2, velocity_scale=1.0, dry_friction=0.0),
        ),
        "rls": ("plain RLS (66)-(70)", least_squares()),
        "rls_stabilised": ("RLS with stability factor c = 10 (71)-(73)", least_squares(stability_factor=10.0)),
        "rls_forgetting": ("RLS with exponential forgetting .99 (74)", least_squares(forgetting=0.99)),
    }


def trend(run: Simulation) -> tuple[float, float]:
    """Slope [N m s/rad] of measured torque over velocity, and NRMSE of the torque about it."""
    moving = run.measured.time >= CONVERGED
    velocity, torque = run.truth["q_velocity"][moving], run.measured["tau_link"][moving]
    slope = float(velocity @ torque / (velocity @ velocity))
    return slope, float(np.sqrt(np.mean((torque - slope * velocity) ** 2)) / np.ptp(torque))


def torque_nrmse(run: Simulation, damping: Array) -> float:
    """NRMSE [-] of damping (N,) times velocity, compared with the measured torque."""
    counts = np.flatnonzero(run.measured.time >= CONVERGED)
    measured = run.measured["tau_link"][counts]
    misfit = measured - damping[counts] * run.truth["q_velocity"][counts]
    return float(np.sqrt(np.mean(misfit**2)) / np.ptp(measured))


def trace_limit(estimator: DampingDirectional | DampingMixture) -> float:
    """Sum of the largest variances that P may have: p_max of every unknown, or the prior's."""
    if isinstance(estimator, DampingMixture):
        return float(np.trace(estimator.covariance(estimator.init())))
    return estimator.parameters.covariance_limit * (estimator.parameters.terms + 1)


def watched(estimator: DampingDirectional | DampingMixture, run: Simulation) -> tuple[Estimates, float, float]:
    """Estimates, and smallest eigenvalue and largest trace of P, sampled every .1 s."""
    rows_in = rows_of(run.measured, estimator.inputs)
    state, parts, least, full = estimator.init(), [], np.inf, 0.0
    for start in range(0, len(rows_in), 100):
        state, part = estimator.run_rows(rows_in[start : start + 100], state)
        parts.append(part)
        eigenvalues = np.linalg.eigvalsh(estimator.covariance(state))
        least, full = min(least, float(eigenvalues[0])), max(full, float(eigenvalues.sum()))
    joined = (np.concatenate([getattr(part, key) for part in parts]) for key in ("time", "status", "value"))
    time, status, value = joined
    sd = np.concatenate([part.standard_deviation for part in parts])
    return Estimates(time, status, value, sd, estimator.outputs), least, full
