"""Damping from the dissipation torque, followed while it changes: the document's Algorithm 1, safe at standstill.

Source: SAPHARI deliverable, Section 5, eqs. (56)-(79). Rows, velocity, statuses and deviations are those of
`damping_equation`, the recursion is `directional_forgetting`, where the departures are told. With initial covariance,
correction and forgetting in the document's units (1/(rad/s)^2 for a torque error counted in N m) the numbers printed
there can be used as they are; they are meant per sample of 1 ms.

While the window tells nothing no row is taken and nothing is forgotten; P goes on growing by the faded correction, so
that a damping commanded meanwhile is found at once, and the reported deviation grows back to the prior's.
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
from via_estimators.damping_equation import DampingParameters, known_of

OWN = damping_equation.N_OWN
ERROR_FORGETTING, LEAST, SENSITIVITY, CORRECTION, FLOOR = range(OWN, OWN + 5)


@dataclass(frozen=True)
class DampingDirectionalParameters(DampingParameters):
    """Parameters of `DampingDirectional`; those of Algorithm 1 end their description in its letters."""

    error_forgetting: float = parameter(0.99, "forgetting of the error's energy, lambda_c", "-", 0.0, 0.999999)
    least_forgetting: float = parameter(0.98, "smallest forgetting factor, lambda_min", "-", 0.5, 1.0)
    sensitivity: float = parameter(10.0, "how soon an error lowers the forgetting factor, rho", "-", 0.0, 1e6)
    correction: float = parameter(1e-3, "added to the covariance per sample, delta", "1/(rad/s)^2", 0.0, 0.01)
    energy_floor: float = parameter(1e-6, "least energy of the error, under eta", "(N m)^2", 1e-12, 1e6)


@dataclass(frozen=True)
class DampingDirectional(Estimator):
    """Damping at the present velocity of a rigid joint with a damper and a sensor for its torque."""

    parameters: DampingDirectionalParameters = DampingDirectionalParameters()

    @classmethod
    def from_device(cls, device: Device) -> DampingDirectional:
        """What the device file tells (`damping_equation.known_of`); the rest stays as given."""
        return cls(replace(DampingDirectionalParameters(), **known_of(device)))

    def having(self, parameters: Parameters) -> DampingDirectional:
        return replace(self, parameters=expect(parameters, DampingDirectionalParameters))

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("q", "tau_link")

    @property
    def outputs(self) -> tuple[str, ...]:
        return ("damping",)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel and autocorrelation (L,) of the window; not locked, another type to compile."""
        own = self.parameters
        each = (own.error_forgetting, own.least_forgetting, own.sensitivity, own.correction, own.energy_floor)
        return np.array((*own.row(), *each)), own.colour()

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
        """Condition number of the root of P; 0/0 where a perfect fit has emptied it counts as 1e16."""
        R = _factor(state, self.parameters.terms + 1)
        found = np.linalg.svd(R, compute_uv=False)
        return float(found[0] / max(found[-1], 1e-16 * found[0], 1e-300))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _factor(state: Array, n: int) -> Array:
    """The view R (n, n) with P = R' R; before it stands eta of (79)."""
    return state[state.size - n * n :].reshape(n, n)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    n, length = int(par[damping_equation.TERMS]) + 1, int(par[damping_equation.LENGTH])
    R, w, count = _factor(state, n), damping_equation.coefficients(state, n), damping_equation.counters(state)
    energy = state[state.size - n * n - 1 : state.size - n * n]
    psi, held, lagged = np.empty((3, length)), np.empty(length), np.empty(length)
    v, gain, slope, spare = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((2, n))
    for k in range(rows.shape[0]):
        made = damping_equation.enter(par, state, rows[k], psi, held, v)
        if made == damping_equation.MOVING:
            error = count[damping_equation.TORQUE]
            for j in range(n):
                error -= v[j] * w[j]
            energy[0] = par[ERROR_FORGETTING] * energy[0] + error * error
            keep = directional_forgetting.forgetting_factor(
                error, max(energy[0], par[FLOOR]), par[SENSITIVITY], par[LEAST]
            )
            directional_forgetting.update(R, v, keep, par[damping_equation.LIMIT], gain, spare[0], spare[1])
            for j in range(n):
                w[j] += gain[j] * error
            directional_forgetting.grow(R, par[CORRECTION], par[damping_equation.LIMIT], spare[0], spare[1])
            damping_equation.follow(par, r, state, error, gain, v, lagged, spare)
        elif made != damping_equation.BAD:
            spare[:, :] = 0.0
            directional_forgetting.grow(R, par[CORRECTION], par[damping_equation.LIMIT], spare[0], spare[1])
            damping_equation.rest(par, state)
        window.answer(state, damping_equation.tell(par, r[0], state, made, slope), out[k])
    return int(out[-1, 1])
