"""Estimators of Section 5, and measures of a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from via_core.devices import load_device
from via_core.signals import Array
from via_estimators.contract import Estimates, Estimator, rows_of
from via_estimators.damping_directional import DampingDirectional, DampingDirectionalParameters
from via_estimators.damping_rls import DampingRLS
from via_sim.simulate import Simulation

from via_validation.tables.vpda import CONVERGED, DEVICE

PERCENT = 100.0


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
        "default": ("VIA's default, n = 1 and dry friction", directional(1)),
        "default_n2": ("VIA's default, but n = 2 and dry friction", directional(2)),
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
    """NRMSE [-] of damping (N,) times velocity, compared with the measured torque, both half a window earlier."""
    late = DampingDirectionalParameters().window // 2
    counts = np.flatnonzero(run.measured.time >= CONVERGED)
    measured = run.measured["tau_link"][counts - late]
    misfit = measured - damping[counts] * run.truth["q_velocity"][counts - late]
    return float(np.sqrt(np.mean(misfit**2)) / np.ptp(measured))


def watched(estimator: DampingDirectional, run: Simulation) -> tuple[Estimates, float, float]:
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
