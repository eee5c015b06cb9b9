"""The default stiffness estimator: the modulated torque equation of each motor, solved recursively.

Source: SAPHARI deliverable, Sections 2-4. The motor equation (5), B thdd + D thd - tau_e(phi) = tau, is multiplied by a
modulating function psi that vanishes with its derivatives at both ends of a sliding window (Prop. 1):

    <tau, psi> = B <theta, psi''> - D <theta, psi'> - sum_p a_p <f_p(phi), psi>,   f_p = s (phi/s)^p / p, f_0 = s

so that sigma(phi) = sum_p a_p (phi/s)^(p-1), with a_p [N m/rad] in units of stiffness at the deflection scale s. Powers
are odd, p = 1, 3, ..; a spring law that is not odd (springs pretensioned against each other) also needs 0, 2, 4, ..

Departures from the document, each with a measured benefit (estimation.md): the equation is not differentiated first; B
and D are unknowns; the basis is odd; psi is w_55 by default instead of w_33; the update is QR with a prior; the
standard errors account for the autocorrelation of the noise (`coloured`).

Samples need not be equidistant: the weights follow the stamps (via_core.weak_form). A constant added to q and theta has
no effect.

Standard deviations include noise and the truncation of the basis: the last term estimates the size of the first one
left out (`truncation`). So give the basis one term more than needed, or set truncation to 0 if it is exact.

Effort convention: the effort in a sample stamped t_n is the torque that acted over the interval ENDING at t_n,
(t_(n-1), t_n], as a simulator or drive reports what it has just applied. A torque command is constant over exactly such
an interval (zero-order hold), so <tau, psi> = sum tau_n (t_n - t_(n-1)) (psi_n + psi_(n-1))/2. Treating it as a sampled
curve would delay the torque by half a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.springs import SpringLaw
from via_core.status import BAD_SAMPLE

from via_estimators import coloured, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.slots import row_of, slots
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

MOST_TERMS = 6
FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
# Followed by the means (n,) and the standard deviations (n,) of the prior.
P = slots(
    "length", "transmissions", "order", "even_terms", "memory", "max_gap", "torque_noise", "position_noise",
    "deflection_scale", "minimum_motion", "range_margin", "truncation", "modulating_order",
)  # fmt: skip
# Of each transmission, before its equation; deflections count by size if the basis is odd.
KEPT = slots("squared_stiffness", after=VISITED)  # mean over the rows [(N m/rad)^2]
THETA, TAU, BASIS = range(3)  # columns of a transmission in the ring: theta, tau, f_1, ..


@dataclass(frozen=True)
class ModulatedTorqueParameters(Parameters):
    """Parameters of `ModulatedTorque`; the prior is so wide that data soon replace it."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals per window", "-", 20, 2000)
    modulating_order: int = parameter(5, "h of the modulating function w_hh", "-", 2, 9)
    order: int = parameter(3, "odd terms of the spring law", "-", 1, MOST_TERMS)
    even_terms: int = parameter(0, "even terms in addition, the constant first", "-", 0, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over the last term; 0: the basis is exact", "-", 0.0, 10.0)
    memory: float = parameter(20.0, "time after which a row has weight 1/e", "s", 0.05, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class ModulatedTorque(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    parameters: ModulatedTorqueParameters = ModulatedTorqueParameters()

    @classmethod
    def from_device(cls, device: Device) -> ModulatedTorque:
        """Scales and priors of the order of magnitude that the device file states."""
        known = {**transmissions.priors_of(device), **transmissions.known_of(device)}
        order, even = _terms_for(device.spring_laws)
        return cls(ModulatedTorqueParameters(**known, order=order, even_terms=even))

    def with_parameters(self, parameters: Parameters) -> ModulatedTorque:
        return replace(self, parameters=expect(parameters, ModulatedTorqueParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @property
    def _unknowns(self) -> int:
        """Number of unknowns: B, D and the coefficients of the spring law."""
        return 2 + self.parameters.order + self.parameters.even_terms

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel and noise colours (3, 2 L); writable, since a locked array compiles again."""
        own = self.parameters
        prior = transmissions.prior_rows(own, self._unknowns - 2)
        row = np.concatenate([row_of(P, own, length=own.window + 1), *prior])
        return row, coloured.mirrored(coloured.colours(own.window, own.modulating_order))

    def init(self) -> Array:
        own = self.parameters
        m, n, length, k = own.transmissions, self._unknowns, own.window + 1, len(self.outputs)
        state = np.zeros(HEADER.size + 2 * k + length * (1 + m * n) + m * _part_size(n, length))
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(own, "inertia", "damping")
        for part in _parts(state, m, n, length):
            coloured.start(part[KEPT.size :], n)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        own, n = self.parameters, self._unknowns
        parts = _parts(state, own.transmissions, n, own.window + 1)
        return max(1.0, *(float(np.linalg.cond(coloured.factor(part[KEPT.size :], n))) for part in parts))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


def _terms_for(springs: tuple[SpringLaw, ...]) -> tuple[int, int]:
    """Numbers of odd and even terms that fit the spring laws to 1 % of their largest torque, plus one each."""
    share = np.linspace(-1.0, 1.0, 129)
    torques = np.stack([each.torque(share * each.max_deflection) for each in springs], axis=1)
    largest = np.abs(torques).max()
    odd = np.abs(torques + torques[::-1]).max() <= 1e-6 * largest
    for order in range(1, MOST_TERMS):
        terms = share[:, None] ** (2 * np.arange(order) + 1 if odd else np.arange(2 * order))
        misfit = torques - terms @ np.linalg.lstsq(terms, torques, rcond=None)[0]
        if np.abs(misfit).max() <= 0.01 * largest:
            return order + 1, 0 if odd else order + 1
    return MOST_TERMS, 0 if odd else MOST_TERMS


@njit(cache=True, error_model="numpy")
def _power(term: int, order: int) -> int:
    """Power of phi in a term: odd powers first, then even ones from 0."""
    return 2 * term + 1 if term < order else 2 * (term - order)


@njit(cache=True, error_model="numpy")
def _tail(term: int, order: int, far: float, mean: Array, width: Array, x: Array, work: Array) -> float:
    """Squared stiffness [(N m/rad)^2] of the terms left out, bounded by the size of the last term without its noise.

    Over the deflections visited, |phi| <= far s, a power n of phi contains 2^(1-n) far^n of the Chebyshev polynomial
    T_n, and the Chebyshev coefficients of a smooth function decrease.

    work  as `coloured.blur` leaves it
    """
    j = 2 + term
    n = _power(term, order) - 1
    size = 2.0 ** (1 - n) * far**n if n > 0 else 0.0
    share, variance = mean[j] + width[j] * x[j], width[j] * width[j] * coloured.variance_of(x.size, j, work)
    return size * size * max(share * share - 4.0 * variance, 0.0)


@njit(cache=True, error_model="numpy")
def _part_size(n: int, length: int) -> int:
    """Numbers in the state of one transmission."""
    return KEPT.size + coloured.size(n, length)


@njit(cache=True, error_model="numpy")
def _parts(state: Array, m: int, n: int, length: int) -> Array:
    """The view (m, ..) of each transmission's KEPT and equation, at the end of the state."""
    each = _part_size(n, length)
    return state[state.size - m * each :].reshape(m, each)


@njit(cache=True, error_model="numpy", forceinline=True)
def _store(par: Array, sample: Array, slot: int, ring: Array, powers: Array) -> None:
    """Write theta, tau and f_p of each transmission into ring (m, n, L), and (phi/s)^p into powers (m, ..)."""
    order, scale = int(par[P.order]), par[P.deflection_scale]
    for i in range(ring.shape[0]):
        ring[i, THETA, slot], ring[i, TAU, slot] = sample[2 + 2 * i], sample[3 + 2 * i]
        ratio = (sample[1] - sample[2 + 2 * i]) / scale
        for p in range(1, 2 * MOST_TERMS):
            powers[i, p] = powers[i, p - 1] * ratio
        for term in range(ring.shape[1] - BASIS):
            p = _power(term, order)
            ring[i, BASIS + term, slot] = scale * powers[i, p] / max(p, 1)


@njit(cache=True, error_model="numpy", forceinline=True)
def _fill_row(par: Array, psi: Array, held: Array, own: Array, row: Array) -> float:
    """Write the regressors of the modulated equation into row (n,) and return its right side, both scaled."""
    n, noise = row.size, par[P.torque_noise]
    y = coloured.dot(held, own[TAU])
    row[0], row[1] = coloured.dot(psi[2], own[THETA]), -coloured.dot(psi[1], own[THETA])
    for j in range(2, n):
        row[j] = -coloured.dot(psi[0], own[j])
    for j in range(n):
        y -= row[j] * par[P.size + j]
        row[j] *= par[P.size + n + j] / noise
    return y / noise


@njit(cache=True, error_model="numpy", forceinline=True)
def _visit(kept: Array, phi: float, even: int) -> None:
    """Extend the range visited; it always includes 0 on the positive side."""
    transmissions.visit(kept, phi if even else abs(phi))
    kept[VISITED.high] = max(kept[VISITED.high], 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def _evaluate(
    par: Array, mean: Array, width: Array, x: Array, powers: Array, warming: bool, slope: Array
) -> tuple[float, float]:
    """Stiffness [N m/rad] and its derivative by phi at the deflection of `powers`; slope (n,) = d stiffness / dx."""
    order, scale = int(par[P.order]), par[P.deflection_scale]
    stiffness, bend = 0.0, 0.0
    for j in range(2, x.size):
        p = _power(j - 2, order)
        share = mean[j] + (0.0 if warming else width[j] * x[j])
        rise = powers[p - 1] if p > 0 else 0.0
        slope[j] = width[j] * rise
        stiffness += share * rise
        bend += share * (p - 1) * powers[p - 2] / scale if p > 1 else 0.0
    return stiffness, bend


@njit(cache=True, error_model="numpy", forceinline=True)
def _truncation(par: Array, mean: Array, width: Array, kept: Array, x: Array, work: Array) -> float:
    """Variance of stiffness [(N m/rad)^2] due to the terms left out, of either parity."""
    order, even = int(par[P.order]), int(par[P.even_terms])
    if not par[P.truncation] > 0.0:
        return 0.0
    far = max(abs(kept[VISITED.low]), abs(kept[VISITED.high])) / par[P.deflection_scale]
    tail = _tail(order - 1, order, far, mean, width, x, work)
    if even > 1:
        tail += _tail(order + even - 1, order, far, mean, width, x, work)
    return par[P.truncation] ** 2 * tail


@njit(cache=True, error_model="numpy", forceinline=True)
def _set_covariance(
    par: Array, r: Array, B: float, D: float, span: float, kept: Array, equation: Array, work: Array
) -> None:
    """Leave the covariance of the unknowns in `work`: torque noise as measured, position noise as declared."""
    n = (par.size - P.size) // 2
    gain = (par[P.position_noise] / par[P.torque_noise]) ** 2
    through = 2.0 * gain * kept[KEPT.squared_stiffness]  # noise of both angles acts as torque through the spring
    first, second = gain * (D / span) ** 2, gain * (B / span**2) ** 2
    found = coloured.noise(equation, n, r, first, second, through, work)
    coloured.blur(equation, n, found, first, second, work)


@njit(cache=True, error_model="numpy", forceinline=True)
def _learn(
    par: Array, slot: int, psi: Array, held: Array, lagged: Array, own: Array, kept: Array, equation: Array,
    row: Array, work: Array,
) -> None:  # fmt: skip
    """Add the equation of the present window, and its middle to the deflections visited."""
    n, length = row.size, own.shape[1]
    y = _fill_row(par, psi, held, own, row)
    coloured.take(equation, n, slot, row, y, lagged, work)
    middle = slot + length // 2 + 1
    _visit(kept, own[BASIS, middle if middle < length else middle - length], int(par[P.even_terms]))


@njit(cache=True, error_model="numpy", forceinline=True)
def _report(
    par: Array, r: Array, span: float, powers: Array, kept: Array, equation: Array, i: int, moving: bool,
    value: Array, sd: Array, joint: Array, slope: Array, work: Array,
) -> bool:  # fmt: skip
    """Write the outputs of transmission i and add it to the joint; returns whether it is still warming up."""
    n, m, length = slope.size, int(par[P.transmissions]), int(par[P.length])
    mean, width, blur = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n], par[P.position_noise]
    x = coloured.unknowns(equation, n)
    warming = equation[coloured.HEAD.taken] < length
    stiffness, bend = _evaluate(par, mean, width, x, powers, warming, slope)
    B, D = mean[0], mean[1]
    uncertain, of_B, of_D = 2.0 * (bend * blur) ** 2, 1.0, 1.0  # the deflection of this very sample is noisy
    if warming:
        for j in range(2, n):
            uncertain += slope[j] * slope[j]
    else:
        B, D = mean[0] + width[0] * x[0], mean[1] + width[1] * x[1]
        _set_covariance(par, r, B, D, span, kept, equation, work)
        of_B, of_D = coloured.variance_of(n, 0, work), coloured.variance_of(n, 1, work)
        uncertain += coloured.variance(n, slope, work)
        uncertain += _truncation(par, mean, width, kept, x, work)
    if moving and not warming:
        counted = min(equation[coloured.HEAD.taken] - length + 1.0, equation[coloured.HEAD.weight])
        kept[KEPT.squared_stiffness] += (stiffness * stiffness - kept[KEPT.squared_stiffness]) / counted
    transmissions.update(value, sd, 1 + i, stiffness, sqrt(uncertain), warming or moving)
    transmissions.update(value, sd, 1 + m + i, B, width[0] * sqrt(of_B), warming or moving)
    transmissions.update(value, sd, 1 + 2 * m + i, D, width[1] * sqrt(of_D), warming or moving)
    transmissions.add(joint, stiffness, sd[1 + i], bend, blur**2)
    return warming


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, even = int(par[P.length]), int(par[P.transmissions]), int(par[P.even_terms])
    n, outputs = int(par[P.order]) + even + 2, 1 + 3 * m
    value, sd = window.outputs(state, outputs)
    times, columns = window.rings(state, HEADER.size + 2 * outputs, length, m * n)
    ring, parts = columns.reshape(m, n, length), _parts(state, m, n, length)
    psi, lagged, held = np.empty((3, length)), np.empty((3, length)), np.empty(length)
    row, slope, work = np.empty(n), np.zeros(n), coloured.scratch(n)
    powers, joint = np.ones((m, 2 * MOST_TERMS)), np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        before = state[HEADER.last]
        entered = transmissions.enter(state, times, rows[k], 2, FURTHEST * par[P.deflection_scale], par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot = int(state[HEADER.slot])
        _store(par, rows[k], slot, ring, powers)
        full, span = state[HEADER.filled] == length, 1.0
        elapsed = rows[k, 0] - before if state[HEADER.samples] > 1.0 else 0.0
        keep = exp(-max(elapsed, 0.0) / par[P.memory])  # also for the time in a gap or before the window is full
        if full:
            span = window.weigh(int(par[P.modulating_order]), times, slot, psi, held)
            coloured.lags(r, slot, keep, lagged)
        transmissions.begin(joint)
        for i in range(m):
            own, part = ring[i], parts[i]
            kept, equation = part[: KEPT.size], part[KEPT.size :]
            if entered == window.RESTARTED:
                coloured.forget_rows(equation, n)
            moved = window.span_of(own[BASIS]) if full else 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], moved)
            moving = full and moved >= par[P.minimum_motion]
            coloured.forget(equation, n, keep, work)
            if moving:
                _learn(par, slot, psi, held, lagged, own, kept, equation, row, work)
            elif full:
                coloured.skip(equation, n, slot, length)
            warming = _report(par, r, span, powers[i], kept, equation, i, moving, value, sd, joint, slope, work)
            reached = own[BASIS, slot] if even else abs(own[BASIS, slot])
            transmissions.grade(joint, warming, moving, transmissions.inside(kept, reached, par[P.range_margin]))
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
