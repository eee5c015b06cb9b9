"""Damping from the dissipation torque by recursive least squares, plain and with the document's stability factor.

Source: SAPHARI deliverable, Section 5, eqs. (62)-(73). Rows, velocity, statuses and standard errors are those of
`damping_equation`, the recursion is `rls`. It is the baseline of `damping_directional`: without forgetting it returns
the mean over the record. `forgetting` is (74), lambda per row, P / lambda after each; a full P (trace P = n p_max)
forgets no more, and without an equation nothing is forgotten.

The stability factor c of (73) does not compensate poor excitation: it is equivalent to P(0) -> c P(0) (see `rls`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array

from via_estimators import damping_equation, rls, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.damping_equation import LATEST, DampingParameters, known_of
from via_estimators.slots import row_of, slots

P = slots("stability_factor", "forgetting", after=damping_equation.P)


@dataclass(frozen=True)
class DampingRLSParameters(DampingParameters):
    """Parameters of `DampingRLS`."""

    stability_factor: float = parameter(1.0, "stability factor c; 1 is plain", "-", 1e-6, 1e6)
    forgetting: float = parameter(1.0, "weight of the past per row, lambda", "-", 0.5, 1.0)


@dataclass(frozen=True)
class DampingRLS(Estimator):
    """Damping at the present velocity of a rigid joint with a damper and a sensor for its torque."""

    parameters: DampingRLSParameters = DampingRLSParameters()

    @classmethod
    def from_device(cls, device: Device) -> DampingRLS:
        """Parameters of the device file (`damping_equation.known_of`) without friction: the document's powers alone."""
        return cls(replace(DampingRLSParameters(), **{**known_of(device), "dry_friction": 0.0}))

    def with_parameters(self, parameters: Parameters) -> DampingRLS:
        return replace(self, parameters=expect(parameters, DampingRLSParameters))

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("q", "tau_link")

    @property
    def outputs(self) -> tuple[str, ...]:
        return ("damping",)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel and autocorrelation (L,) of the window; both writable."""
        own = self.parameters
        return row_of(P, own, length=own.window + 1), own.colour()

    def init(self) -> Array:
        own, n = self.parameters, self.parameters.terms + 1
        state = np.zeros(damping_equation.size(n, own.window + 1) + n * n)
        damping_equation.start(self._constants[0], state)
        covariance = _covariance(state, n)
        covariance[:, :] = own.initial_covariance * np.eye(n)
        if own.dry_friction == 0.0:  # not observable: P would grow there until nothing is forgotten
            covariance[-1, -1] = 0.0
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        """Condition number of the triangular root of P."""
        live = self.parameters.terms + (self.parameters.dry_friction > 0.0)
        found = np.linalg.eigvalsh(_covariance(state, self.parameters.terms + 1)[:live, :live])
        return float(np.sqrt(found[-1] / max(found[0], 1e-32 * found[-1], 1e-300)))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _covariance(state: Array, n: int) -> Array:
    """The view P (n, n)."""
    return state[state.size - n * n :].reshape(n, n)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    n, length = int(par[P.terms]) + 1, int(par[P.length])
    covariance, w, latest = (
        _covariance(state, n),
        damping_equation.coefficients(state, n),
        damping_equation.latest_of(state),
    )
    psi, held, lagged = np.empty((3, length)), np.empty(length), np.empty(length)
    v, gain, slope, spare = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((2, n))
    for k in range(rows.shape[0]):
        made = damping_equation.enter(par, state, rows[k], psi, held, v)
        if made == damping_equation.MOVING:
            error = rls.update(covariance, w, v, latest[LATEST.torque], par[P.stability_factor], gain)
            if np.trace(covariance) < n * par[P.covariance_limit]:
                covariance /= par[P.forgetting]
            damping_equation.follow(par, r, state, error, gain, v, lagged, spare)
        elif made != damping_equation.BAD:
            damping_equation.rest(par, state)
        window.answer(state, damping_equation.report(par, r[0], state, made, slope), out[k])
    return int(out[-1, 1])
