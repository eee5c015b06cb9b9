"""Stiffness by the method of Section 3 of the document: the motor equation, differentiated and then modulated.

Source: SAPHARI deliverable, Section 3.2. The motor equation (5) is differentiated so that it contains stiffness (16),
stiffness is a Taylor polynomial in the deflection (17), and integration by parts moves all derivatives to a modulating
function of order h >= 3 (21):

    sum_j alpha_j <phi^(j+1)/(j+1)!, psi'> = B <theta, psi'''> - D <theta, psi''> - <tau, psi'>,    j = 0..N

B and D are known; alpha (N + 1,) follows by recursive least squares from alpha = 0 and P(0), with no forgetting.
Corrections of the printed equations (estimation.md, each with a test): the right side holds the motor torque tau, not
tau_e; w_33 has order 3, which suffices; (23) is divided by T^4; weights are 1/H on [0, 1]; the sample at m/H is k - H +
m; (30) begins with -6 w_03; the first estimate requires a full window, whereas the document sets missing samples to
zero.

Departures, none of which changes the estimate from the document's noise-free, equidistant samples by more than its
discretisation error: weights follow the actual stamps and are exact for polynomials (`via_core.weak_form`); the torque
is constant over the interval that ends at its stamp, as a drive reports it (see `modulated_torque`), so that <tau,
psi'> = sum tau_n (psi_n - psi_(n-1)) without error; the recursion runs on the triangular factor of P^-1, which gives
the same estimate (tested against `rls`) and lets `coloured` compute its standard deviation: torque noise enters through
psi', position noise through psi'' and psi'''. P(0) is meant for rows in the document's scale, (26) and (27).

P(0) does not express prior knowledge, and the document's 1e8 is narrow: on the qbmoves it keeps the highest powers near
0, which causes errors of stiffness of 3-20 %, compared with .1 % due to noise. Standard deviations include that: with d
the distance to the estimate from the same rows with the prior `stiffness_deviation` instead of P(0), and Cov its
covariance,

    d = C (1 - E) (x - x_0),   Cov = C (noise M + E) C,   C = (R'R - 1 + E)^-1,   E = 1 / beliefs,

x_0 being 0 or the target of the leak, they are the root of (slope' d)^2 + slope' Cov slope.

Not included: errors of B and D, which are assumed exact, and truncation at order N. `modulated_torque` estimates B and
D, includes its truncation error, and is 5-17 times more accurate in noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, factorial, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE
from via_core.weak_form import fill_third, fill_weights

from via_estimators import coloured, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.qr import solve_transposed, solve_triangular
from via_estimators.slots import row_of, slots
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 100.0  # [rad] larger deflections are bad samples
# `scale` [N m/rad^(j+1)] is the unit of the unknowns. B and D of motor 1 are followed by those of motor 2.
P = slots(
    "length", "transmissions", "terms", "modulating_order", "memory", "max_gap", "scale", "stiffness_deviation",
    "torque_noise", "position_noise", "minimum_motion", "range_margin",
    "motor_inertia_1", "motor_damping_1", "motor_inertia_2", "motor_damping_2",
)  # fmt: skip
KEPT = slots("squared_stiffness", after=VISITED)  # of each transmission, before its equation: mean over the rows
THETA, TAU, POWERS = range(3)  # columns of a transmission in the ring: theta, tau, phi, phi^2/2, ..


@dataclass(frozen=True)
class ModulatedStiffnessParameters(Parameters):
    """Parameters of `ModulatedStiffness`; the defaults are those of the document's simulations (Section 3.4)."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(500, "H, sampling intervals per window", "-", 20, 2000)
    modulating_order: int = parameter(3, "h of the modulating function w_hh", "-", 3, 9)
    taylor_order: int = parameter(2, "N, order of the stiffness polynomial", "-", 0, 9)
    initial_covariance: float = parameter(1e8, "P(0), for rows in the document's scale", "-", 1e-6, 1e15)
    sampling: float = parameter(1e-3, "expected sampling interval, which sets that scale", "s", 1e-5, 1.0)
    memory: float = parameter(1e9, "time after which a row has weight 1/e; document: infinite", "s", 0.05, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    motor_inertia_1: float = parameter(1e-4, "inertia of motor 1", "kg m^2", 0.0, 1e3)
    motor_inertia_2: float = parameter(1e-4, "inertia of motor 2", "kg m^2", 0.0, 1e3)
    motor_damping_1: float = parameter(1.27, "damping of motor 1", "N m s/rad", 0.0, 1e4)
    motor_damping_2: float = parameter(1.27, "damping of motor 2", "N m s/rad", 0.0, 1e4)
    stiffness_deviation: float = parameter(
        300.0, "standard deviation of stiffness per transmission before any data", "N m/rad", 1e-6, 1e9
    )
    deflection_scale: float = parameter(1.0, "deflection over which stiffness may vary by that", "rad", 1e-3, 10.0)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class ModulatedStiffness(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides, motors known."""

    parameters: ModulatedStiffnessParameters = ModulatedStiffnessParameters()

    @classmethod
    def from_device(cls, device: Device) -> ModulatedStiffness:
        """Motors and sensors from a device file; the document's window of half a second, and N = 4."""
        motors = transmissions.motors_of(device)
        return cls(
            ModulatedStiffnessParameters(
                **transmissions.known_of(device),
                window=int(np.clip(round(0.5 * device.sensors.rate), 20, 2000)),
                taylor_order=4,
                sampling=1.0 / device.sensors.rate,
                motor_inertia_1=motors[0].inertia,
                motor_inertia_2=motors[-1].inertia,
                motor_damping_1=motors[0].viscous_friction,
                motor_damping_2=motors[-1].viscous_friction,
                stiffness_deviation=transmissions.priors_of(device)["stiffness_deviation"],
            )
        )

    def with_parameters(self, parameters: Parameters) -> ModulatedStiffness:
        return replace(self, parameters=expect(parameters, ModulatedStiffnessParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions)

    @property
    def _terms(self) -> int:
        return self.parameters.taylor_order + 1

    @property
    def _width(self) -> float:
        """Standard deviation [N m/rad^(j+1)] of each alpha_j by P(0), if rows are as noisy as declared.

        Rows in the document's scale are T^3 / c_h times the rows here (c_h: `via_core.weak_form`), whose noise is
        the torque noise / T.
        """
        own, h = self.parameters, self.parameters.modulating_order
        span = own.window * own.sampling
        c = factorial(2 * h + 1) / factorial(h) ** 2
        return own.torque_noise * span**2 / c * sqrt(own.initial_covariance)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel and noise colours (3, 2 L); writable, since a locked array compiles again."""
        own = self.parameters
        row = row_of(P, own, length=own.window + 1, terms=self._terms, scale=self._width)
        return row, coloured.mirrored(coloured.colours(own.window, own.modulating_order, first=1))

    def init(self) -> Array:
        own, n = self.parameters, self._terms
        m, length = own.transmissions, own.window + 1
        each = KEPT.size + coloured.size(n, length)
        state = np.zeros(HEADER.size + 2 * (1 + m) + length * (1 + m * (POWERS + n)) + m * each)
        window.start(state)
        sd = window.outputs(state, 1 + m)[1]
        sd[0], sd[1:] = sqrt(m) * own.stiffness_deviation, own.stiffness_deviation
        believed = [own.stiffness_deviation * factorial(j) / own.deflection_scale**j / self._width for j in range(n)]
        for equation in self._equations(state):
            coloured.start(equation, n)
            coloured.beliefs(equation, n)[:] = np.square(believed)
        state.flags.writeable = False
        return state

    def coefficients(self, state: Array) -> Array:
        """alpha_j (transmissions, N + 1) [N m/rad^(j+1)] of a state: sigma(phi) = sum_j alpha_j phi^j / j!."""
        return self._width * np.stack([coloured.unknowns(each, self._terms) for each in self._equations(state)])

    def condition(self, state: Array) -> float:
        return max(float(np.linalg.cond(coloured.factor(each, self._terms))) for each in self._equations(state))

    def _equations(self, state: Array) -> list[Array]:
        """The part of a state that belongs to each transmission's equation."""
        m, each = self.parameters.transmissions, KEPT.size + coloured.size(self._terms, self.parameters.window + 1)
        return [part[KEPT.size :] for part in state[len(state) - m * each :].reshape(m, each)]

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _uncertainty(
    equation: Array, n: int, noise: float, first: float, second: float, slope: Array, work: Array
) -> float:
    """Expected squared error of slope' x, slope (n,): bias due to P(0), and noise.

    noise, first, second  variances of the three colours, as `coloured.noise` has and takes them
    work                  `coloured.scratch`, overwritten

    In units of the beliefs, where C^-1 = sqrt(b) (R'R - 1) sqrt(b) + 1 has no pivot below 1, b = beliefs.
    """
    R, M, b = coloured.factor(equation, n), coloured.middles(equation, n), coloured.beliefs(equation, n)
    T, weights = work[:n], work[n]
    x, pulled = coloured.unknowns(equation, n), equation[coloured.HEAD.size + 2 * n : coloured.HEAD.size + 3 * n]
    for i in range(n):  # T' T = C^-1
        for j in range(i, n):
            total = 0.0
            for k in range(i + 1):
                total += R[k, i] * R[k, j]
            total = sqrt(b[i]) * sqrt(b[j]) * (total - 1.0) + 1.0 if i == j else sqrt(b[i]) * sqrt(b[j]) * total
            for k in range(i):
                total -= T[k, i] * T[k, j]
            T[i, j] = sqrt(max(total, 1.0)) if i == j else total / T[i, i]
    for i in range(n):
        weights[i] = sqrt(b[i]) * slope[i]
    solve_transposed(T, weights, weights)
    solve_triangular(T, weights, weights)
    apart, variance = 0.0, 0.0
    for i in range(n):
        variance += weights[i] * weights[i]
        weights[i] *= sqrt(b[i])
        apart += weights[i] * (1.0 - 1.0 / b[i]) * (x[i] - pulled[i])
    for i in range(n):
        for j in range(n):
            variance += weights[i] * (noise * M[0, i, j] + first * M[1, i, j] + second * M[2, i, j]) * weights[j]
    return apart * apart + max(variance, 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def _store(sample: Array, slot: int, ring: Array, powers: Array) -> None:
    """Write theta, tau, phi^j / j! of each transmission into ring (m, 2 + n, L), the last into powers (m, 1 + n)."""
    for i in range(ring.shape[0]):
        own = ring[i]
        own[THETA, slot], own[TAU, slot] = sample[2 + 2 * i], sample[3 + 2 * i]
        for j in range(powers.shape[1] - 1):
            powers[i, j + 1] = powers[i, j] * (sample[1] - sample[2 + 2 * i]) / (j + 1.0)
            own[POWERS + j, slot] = powers[i, j + 1]


@njit(cache=True, error_model="numpy", forceinline=True)
def _weigh(par: Array, times: Array, slot: int, psi: Array, held: Array) -> float:
    """Weights of the full window into psi (4, L) and held (L,); returns its span T [s]."""
    order, oldest = int(par[P.modulating_order]), window.oldest_of(slot, times.size)
    fill_weights(order, times, oldest, psi)
    fill_third(order, times, oldest, psi)
    window.hold_slope(times, slot, psi[0], held)
    return times[slot] - times[oldest]


@njit(cache=True, error_model="numpy", forceinline=True)
def _learn(
    par: Array, slot: int, span: float, i: int, psi: Array, held: Array, lagged: Array, own: Array, part: Array,
    row: Array, work: Array,
) -> None:  # fmt: skip
    """Add equation (25) of the present window, times T / noise, and its middle to the deflections visited.

    With that factor, a row is as noisy as its kernel on a window of length 1.
    """
    n, length, scale = row.size, own.shape[1], span / par[P.torque_noise]
    B, D = par[P.motor_inertia_1 + 2 * i], par[P.motor_damping_1 + 2 * i]
    y = B * coloured.dot(psi[3], own[THETA]) - D * coloured.dot(psi[2], own[THETA]) - coloured.dot(held, own[TAU])
    for j in range(n):
        row[j] = scale * par[P.scale] * coloured.dot(psi[1], own[POWERS + j])
    coloured.take(part[KEPT.size :], n, slot, row, scale * y, lagged, work)
    middle = slot + length // 2 + 1
    transmissions.visit(part, own[POWERS, middle if middle < length else middle - length])


@njit(cache=True, error_model="numpy", forceinline=True)
def _evaluate(
    par: Array, r: Array, span: float, i: int, powers: Array, part: Array, slope: Array, work: Array
) -> tuple[float, float, float]:
    """Stiffness [N m/rad] at the deflection of powers (1 + n,), its derivative by phi and its variance."""
    n, width, noise, blur = slope.size, par[P.scale], par[P.torque_noise], par[P.position_noise]
    B, D = par[P.motor_inertia_1 + 2 * i], par[P.motor_damping_1 + 2 * i]
    equation = part[KEPT.size :]
    alpha = coloured.unknowns(equation, n)
    gain = (blur / noise) ** 2
    through = 2.0 * gain * part[KEPT.squared_stiffness]  # noise of both angles acts as torque through the spring
    first, second = gain * (D / span) ** 2, gain * (B / span**2) ** 2
    found = coloured.noise(equation, n, r, first, second, through, work)
    stiffness, bend = 0.0, 0.0
    for j in range(n):
        slope[j] = width * powers[j]
        stiffness += slope[j] * alpha[j]
        bend += width * powers[j - 1] * alpha[j] if j > 0 else 0.0
    uncertain = 2.0 * (bend * blur) ** 2  # the deflection of this very sample is noisy
    return stiffness, bend, uncertain + _uncertainty(equation, n, found, first, second, slope, work)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, n = int(par[P.length]), int(par[P.transmissions]), int(par[P.terms])
    value, sd = window.outputs(state, 1 + m)
    at, columns = HEADER.size + 2 * (1 + m), m * (POWERS + n)
    times, flat = window.rings(state, at, length, columns)
    ring, parts = flat.reshape(m, POWERS + n, length), state[at + length * (1 + columns) :].reshape(m, -1)
    psi, lagged, held = np.empty((4, length)), np.empty((3, length)), np.empty(length)
    row, slope, work = np.empty(n), np.empty(n), coloured.scratch(n)
    powers, joint = np.ones((m, n + 1)), np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        before = state[HEADER.last]
        entered = transmissions.enter(state, times, rows[k], 2, FURTHEST, par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, full, span = int(state[HEADER.slot]), state[HEADER.filled] == length, 1.0
        _store(rows[k], slot, ring, powers)
        elapsed = rows[k, 0] - before if state[HEADER.samples] > 1.0 else 0.0
        keep = exp(-max(elapsed, 0.0) / par[P.memory])  # also for the time in a gap or before the window is full
        if full:
            span = _weigh(par, times, slot, psi, held)
            coloured.lags(r, slot, keep, lagged)
        transmissions.begin(joint)
        for i in range(m):
            own, part = ring[i], parts[i]
            equation = part[KEPT.size :]
            if entered == window.RESTARTED:
                coloured.forget_rows(equation, n)
            moved = window.span_of(own[POWERS]) if full else 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], moved)
            moving = full and moved >= par[P.minimum_motion]
            coloured.forget(equation, n, keep, work)
            if moving:
                _learn(par, slot, span, i, psi, held, lagged, own, part, row, work)
            elif full:
                coloured.skip(equation, n, slot, length)
            warming = equation[coloured.HEAD.taken] < length
            stiffness, bend, uncertain = 0.0, 0.0, par[P.stiffness_deviation] ** 2
            if not warming:
                stiffness, bend, uncertain = _evaluate(par, r, span, i, powers[i], part, slope, work)
            if moving and not warming:
                counted = min(equation[coloured.HEAD.taken] - length + 1.0, equation[coloured.HEAD.weight])
                part[KEPT.squared_stiffness] += (stiffness * stiffness - part[KEPT.squared_stiffness]) / counted
            transmissions.update(value, sd, 1 + i, stiffness, sqrt(max(uncertain, 0.0)), warming or moving)
            transmissions.add(joint, stiffness, sd[1 + i], bend, par[P.position_noise] ** 2, 0.0)
            inside = transmissions.inside(part, own[POWERS, slot], par[P.range_margin])
            transmissions.grade(joint, warming, moving, inside)
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
