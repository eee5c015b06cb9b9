"""Time-varying damping from the dissipation torque: the document's Algorithm 1, stable at standstill.

Source: SAPHARI deliverable, Section 5, eqs. (56)-(79). Rows, velocity, statuses and standard errors are those of
`damping_equation`; the recursion is `directional_forgetting`, which lists the departures. Initial covariance,
correction and forgetting are in the document's units (1/(rad/s)^2 for a torque error in N m) and per sample of 1 ms, so
that the printed numbers apply.

While the window is not informative, nothing is learnt or forgotten. P continues to grow by the correction, so that a
new damping is found quickly afterwards, and the reported standard deviation grows back to the prior's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array

from via_estimators import damping_equation, directional_forgetting, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.damping_equation import LATEST, DampingParameters, known_of
from via_estimators.slots import row_of, slots

P = slots("error_forgetting", "least_forgetting", "sensitivity", "correction", "energy_floor", after=damping_equation.P)


@dataclass(frozen=True)
class DampingDirectionalParameters(DampingParameters):
    """Parameters of `DampingDirectional`; descriptions end with the symbols of Algorithm 1."""

    error_forgetting: float = parameter(0.99, "forgetting of the error's energy, lambda_c", "-", 0.0, 0.999999)
    least_forgetting: float = parameter(0.98, "smallest forgetting factor, lambda_min", "-", 0.5, 1.0)
    sensitivity: float = parameter(10.0, "sensitivity of the forgetting factor to errors, rho", "-", 0.0, 1e6)
    correction: float = parameter(1e-3, "added to the covariance per sample, delta", "1/(rad/s)^2", 0.0, 0.01)
    energy_floor: float = parameter(1e-6, "lower bound of the error's energy, under eta", "(N m)^2", 1e-12, 1e6)


@dataclass(frozen=True)
class DampingDirectional(Estimator):
    """Damping at the present velocity of a rigid joint with a damper and a sensor for its torque."""

    parameters: DampingDirectionalParameters = DampingDirectionalParameters()

    @classmethod
    def from_device(cls, device: Device) -> DampingDirectional:
        """Parameters of the device file (`damping_equation.known_of`); defaults for the rest."""
        return cls(replace(DampingDirectionalParameters(), **known_of(device)))

    def with_parameters(self, parameters: Parameters) -> DampingDirectional:
        return replace(self, parameters=expect(parameters, DampingDirectionalParameters))

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
        own, row = self.parameters, self._constants[0]
        n = own.terms + 1
        shared = damping_equation.size(n, own.window + 1)
        state = np.zeros(shared + 1 + n * n)
        damping_equation.start(row, state)
        _factor(state, n)[:, :] = sqrt(own.initial_covariance) * np.eye(n)
        state.flags.writeable = False
        return state

    def covariance(self, state: Array) -> Array:
        """P (n, n) of Algorithm 1 [1/(rad/s)^2], relative to the noise of a torque row."""
        R = _factor(state, self.parameters.terms + 1)
        return np.asarray(R.T @ R)

    def coefficients(self, state: Array) -> Array:
        """w (n,) [N m s/rad]."""
        return damping_equation.coefficients(state.copy(), self.parameters.terms + 1)

    def condition(self, state: Array) -> float:
        """Condition number of the root of P; 0/0 after a perfect fit is reported as 1e16."""
        R = _factor(state, self.parameters.terms + 1)
        found = np.linalg.svd(R, compute_uv=False)
        return float(found[0] / max(found[-1], 1e-16 * found[0], 1e-300))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _factor(state: Array, n: int) -> Array:
    """The view R (n, n) with P = R' R; eta of (79) precedes it."""
    return state[state.size - n * n :].reshape(n, n)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    n, length = int(par[P.terms]) + 1, int(par[P.length])
    R, w, latest = _factor(state, n), damping_equation.coefficients(state, n), damping_equation.latest_of(state)
    energy = state[state.size - n * n - 1 : state.size - n * n]
    psi, held, lagged = np.empty((3, length)), np.empty(length), np.empty(length)
    v, gain, slope, spare = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((2, n))
    for k in range(rows.shape[0]):
        made = damping_equation.enter(par, state, rows[k], psi, held, v)
        if made == damping_equation.MOVING:
            error = latest[LATEST.torque]
            for j in range(n):
                error -= v[j] * w[j]
            energy[0] = par[P.error_forgetting] * energy[0] + error * error
            keep = directional_forgetting.forgetting_factor(
                error, max(energy[0], par[P.energy_floor]), par[P.sensitivity], par[P.least_forgetting]
            )
            directional_forgetting.update(R, v, keep, par[P.covariance_limit], gain, spare[0], spare[1])
            for j in range(n):
                w[j] += gain[j] * error
            directional_forgetting.grow(R, par[P.correction], par[P.covariance_limit], spare[0], spare[1])
            damping_equation.follow(par, r, state, error, gain, v, lagged, spare)
        elif made != damping_equation.BAD:
            spare[:, :] = 0.0
            directional_forgetting.grow(R, par[P.correction], par[P.covariance_limit], spare[0], spare[1])
            damping_equation.rest(par, state)
        window.answer(state, damping_equation.report(par, r[0], state, made, slope), out[k])
    return int(out[-1, 1])
