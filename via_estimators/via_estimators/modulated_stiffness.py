"""Stiffness as Section 3 of the document estimates it: the motor equation differentiated, then modulated.

Source: SAPHARI deliverable, Section 3.2. The motor equation (5) is differentiated so that stiffness appears in it (16),
stiffness is a Taylor polynomial in the deflection (17), and a modulating function of order h >= 3 takes all derivatives
upon itself (21):

    sum_j alpha_j <phi^(j+1)/(j+1)!, psi'> = B <theta, psi'''> - D <theta, psi''> - <tau, psi'>,    j = 0..N

B and D are known, alpha (N + 1,) follows by recursive least squares from alpha = 0 and P(0), with no forgetting.
Against the print (errata of estimation.md, a test each): the right side holds the motor torque tau, not tau_e; w_33 has
order 3 and is enough; (23) is divided by T^4; weights are 1/H on [0, 1]; the sample at m/H is k - H + m; (30) begins
with -6 w_03; and the first estimate waits for a full window where the document sets what was not measured to zero.

Departures, none of which changes the estimate on the document's own clean, equidistant samples by more than its
discretisation error: weights follow the actual stamps and are exact for polynomials (`via_core.weak_form`); the torque
is held over the interval that ends at its stamp, as a drive reports it (see `modulated_torque`), so that <tau, psi'> =
sum tau_n (psi_n - psi_(n-1)) without error; the recursion runs on the triangular factor of P^-1, which is the same
estimate (a test shows it against `rls`), so that `coloured` can tell its standard deviation: torque noise comes in
through psi', position noise through psi'' and psi'''. P(0) is meant for rows in the document's scale, (26) and (27).

P(0) is no belief, and 1e8 of the document's is narrow: on the qbmoves it holds the highest powers at 0 for good, which
costs 3-20 % of stiffness where noise costs .1 %. Standard deviations tell: with d the way to the estimate that believes
`stiffness_deviation` in place of P(0), of the same rows, and Cov the covariance of that one,

    d = C (1 - E) (x - x_0),   Cov = C (noise M + E) C,   C = (R'R - 1 + E)^-1,   E = 1 / beliefs,

x_0 being 0 or where the leak pulls to, they are the root of (slope' d)^2 + slope' Cov slope.

What standard deviations leave out: errors of B and D, which are taken for certain, and a law that is no polynomial of
order N. `modulated_torque` finds B and D itself, tells what its basis cuts off, and is 5-17 times better in noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, factorial, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import Status
from via_core.weak_form import fill_third, fill_weights

from via_estimators import coloured, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.qr import solve_transposed, solve_triangular

BEYOND = 100.0  # [rad] deflections larger than that are no deflections
LENGTH, TRANSMISSIONS, TERMS, ORDER, MEMORY, MAX_GAP, WIDTH, UNKNOWN, TORQUE_NOISE, POSITION_NOISE = range(10)
MINIMUM_MOTION, MARGIN, MOTORS = range(10, 13)  # then B and D of each motor
# Smallest and largest deflection visited, whether any was, mean of the squared stiffness there.
LOW, HIGH, ANY, SQUARED, N_VISITED = range(5)
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class ModulatedStiffnessParameters(Parameters):
    """Parameters of `ModulatedStiffness`; the defaults are those of the document's simulations (Section 3.4)."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(500, "H, sampling intervals per window", "-", 20, 2000)
    modulating_order: int = parameter(3, "h of the modulating function w_hh", "-", 3, 9)
    taylor_order: int = parameter(2, "N, order of the stiffness polynomial", "-", 0, 9)
    initial_covariance: float = parameter(1e8, "P(0), for rows in the document's scale", "-", 1e-6, 1e15)
    sampling: float = parameter(1e-3, "sampling interval to expect, which sets that scale", "s", 1e-5, 1.0)
    memory: float = parameter(1e9, "time after which a row counts 1/e; the document forgets nothing", "s", 0.05, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    motor_inertia_1: float = parameter(1e-4, "inertia of motor 1", "kg m^2", 0.0, 1e3)
    motor_inertia_2: float = parameter(1e-4, "inertia of motor 2", "kg m^2", 0.0, 1e3)
    motor_damping_1: float = parameter(1.27, "damping of motor 1", "N m s/rad", 0.0, 1e4)
    motor_damping_2: float = parameter(1.27, "damping of motor 2", "N m s/rad", 0.0, 1e4)
    stiffness_deviation: float = parameter(
        300.0, "standard deviation of stiffness per transmission before any data", "N m/rad", 1e-6, 1e9
    )
    deflection_scale: float = parameter(1.0, "deflection over which stiffness may vary by that", "rad", 1e-3, 10.0)
    torque_noise: float = parameter(0.1, "standard deviation of torque noise expected", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "range of deflection below which a window tells nothing", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "share of the visited range that counts as visited beyond it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class ModulatedStiffness(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides, motors known."""

    parameters: ModulatedStiffnessParameters = ModulatedStiffnessParameters()

    @classmethod
    def from_device(cls, device: Device) -> ModulatedStiffness:
        """Motors and sensors from a device file; the document's window of half a second, and N = 4."""
        motors, law = transmissions.motors_of(device), device.spring_laws[0]
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
                stiffness_deviation=3.0 * float(law.stiffness(np.linspace(0.0, law.max_deflection, 65)).max()),
            )
        )

    def having(self, parameters: Parameters) -> ModulatedStiffness:
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
        """Standard deviation [N m/rad^(j+1)] that P(0) amounts to for each alpha_j, if rows are as noisy as declared.

        Rows in the document's scale are T^3 / c_h times ours, c_h of `via_core.weak_form`; ours carry torque noise / T.
        """
        own, h = self.parameters, self.parameters.modulating_order
        span = own.window * own.sampling
        c = factorial(2 * h + 1) / factorial(h) ** 2
        return own.torque_noise * span**2 / c * sqrt(own.initial_covariance)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel, noise colours (3, 2 L) by slot; not locked, which would be another type."""
        own = self.parameters
        row = np.array([
            own.window + 1, own.transmissions, self._terms, own.modulating_order, own.memory, own.max_gap,
            self._width, own.stiffness_deviation, own.torque_noise, own.position_noise, own.minimum_motion,
            own.range_margin, own.motor_inertia_1, own.motor_damping_1, own.motor_inertia_2, own.motor_damping_2,
        ])  # fmt: skip
        return row, coloured.mirrored(coloured.colours(own.window, own.modulating_order, first=1))

    def init(self) -> Array:
        own = self.parameters
        length, n, m = own.window + 1, self._terms, own.transmissions
        each = N_VISITED + coloured.size(n, length)
        columns = m * (n + 2)
        state = np.zeros(window.HEADER + 2 * (1 + m) + length * (1 + columns) + m * each)
        window.start(state)
        spread = state[window.HEADER + 1 + m : window.HEADER + 2 * (1 + m)]
        spread[0], spread[1:] = sqrt(m) * own.stiffness_deviation, own.stiffness_deviation
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
        m, each = self.parameters.transmissions, N_VISITED + coloured.size(self._terms, self.parameters.window + 1)
        start = len(state) - m * each
        return [state[start + i * each + N_VISITED : start + (i + 1) * each] for i in range(m)]

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def hold_slope(times: Array, newest: int, weights: Array, held: Array) -> None:
    """Weights (L,) for <f, psi'> of values held over the interval that ends at their stamp: psi_n - psi_(n-1), by slot.

    weights  (L,) of <f, psi> for sampled curves, that is psi_n times half the two steps at n
    """
    last = times.size - 1
    window.densities(times, newest, weights, held)
    across = held[last]
    for n in range(last, 0, -1):
        held[n] = 2.0 * (held[n] - held[n - 1])
    held[0] = 2.0 * (held[0] - across)
    held[newest + 1 if newest < last else 0] = 0.0


@njit(cache=True, error_model="numpy")
def _uncertainty(
    equation: Array, n: int, noise: float, first: float, second: float, slope: Array, work: Array
) -> float:
    """Expected square of the error of slope' x, slope (n,): where P(0) holds x apart from what is believed, and noise.

    noise, first, second  variances of the three colours, as `coloured.noise` has and takes them
    work                  `coloured.scratch`, overwritten

    In units of what is believed, where C^-1 = sqrt(b) (R'R - 1) sqrt(b) + 1 has no pivot below 1, b = beliefs.
    """
    R, M, b = coloured.factor(equation, n), coloured.middles(equation, n), coloured.beliefs(equation, n)
    T, weights = work[:n], work[n]
    x, pulled = coloured.unknowns(equation, n), equation[coloured.HEAD + 2 * n : coloured.HEAD + 3 * n]
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


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, n, order = int(par[LENGTH]), int(par[TRANSMISSIONS]), int(par[TERMS]), int(par[ORDER])
    width, noise, blur = par[WIDTH], par[TORQUE_NOISE], par[POSITION_NOISE]
    at = window.HEADER
    now, spread = state[at : at + 1 + m], state[at + 1 + m : at + 2 * (1 + m)]
    at += 2 * (1 + m)
    times = state[at : at + length]
    at += length
    columns = m * (n + 2)
    ring = state[at : at + length * columns].reshape(columns, length)  # theta, tau, phi, phi^2/2.. per transmission
    at += length * columns
    each = N_VISITED + coloured.size(n, length)
    psi, lagged, held = np.empty((4, length)), np.empty((3, length)), np.empty(length)
    row, slope, work = np.empty(n), np.empty(n), coloured.scratch(n)
    powers = np.ones((m, n + 1))  # phi^j / j!
    for k in range(rows.shape[0]):
        before = state[window.LAST]
        entered = transmissions.enter(state, times, rows[k], m, BEYOND, par[MAX_GAP])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, q = int(state[window.SLOT]), rows[k, 1]
        for i in range(m):
            own = ring[i * (n + 2) : (i + 1) * (n + 2)]
            own[0, slot], own[1, slot] = rows[k, 2 + 2 * i], rows[k, 3 + 2 * i]
            for j in range(n):
                powers[i, j + 1] = powers[i, j] * (q - rows[k, 2 + 2 * i]) / (j + 1.0)
                own[2 + j, slot] = powers[i, j + 1]
        full, span = state[window.FILLED] == length, 1.0
        elapsed = rows[k, 0] - before if state[window.SAMPLES] > 1.0 else 0.0
        keep = exp(-max(elapsed, 0.0) / par[MEMORY])  # time in a gap, or until a window is full, counts like any other
        if full:
            oldest = slot + 1 if slot + 1 < length else 0
            span = times[slot] - times[oldest]
            fill_weights(order, times, oldest, psi)
            fill_third(order, times, oldest, psi)
            hold_slope(times, slot, psi[0], held)
            coloured.lags(r, slot, keep, lagged)
        middle = slot + length // 2 + 1
        middle = middle if middle < length else middle - length
        worst, motion, total, variance, bends = OK, np.inf, 0.0, 0.0, 0.0
        for i in range(m):
            B, D = par[MOTORS + 2 * i], par[MOTORS + 2 * i + 1]
            visited = state[at + i * each : at + i * each + N_VISITED]
            equation = state[at + i * each + N_VISITED : at + (i + 1) * each]
            alpha = coloured.unknowns(equation, n)
            own = ring[i * (n + 2) : (i + 1) * (n + 2)]
            if entered == window.RESTARTED:
                coloured.forget_rows(equation, n)
            moved = window.spread(own[2]) if full else 0.0
            motion = min(motion, moved)
            moving = full and moved >= par[MINIMUM_MOTION]
            coloured.forget(equation, n, keep, work)
            if moving:
                # (25), times T / noise: a row is as noisy as its kernel on a window of length 1
                scale = span / noise
                y = B * coloured.dot(psi[3], own[0]) - D * coloured.dot(psi[2], own[0]) - coloured.dot(held, own[1])
                for j in range(n):
                    row[j] = scale * width * coloured.dot(psi[1], own[2 + j])
                coloured.take(equation, n, slot, row, scale * y, lagged, work)
                reached = own[2, middle]
                visited[LOW] = min(visited[LOW], reached) if visited[ANY] > 0.0 else reached
                visited[HIGH] = max(visited[HIGH], reached) if visited[ANY] > 0.0 else reached
                visited[ANY] = 1.0
            elif full:
                coloured.skip(equation, n, slot, length)

            warming = equation[coloured.TAKEN] < length
            stiffness, bend, uncertain = 0.0, 0.0, par[UNKNOWN] ** 2
            if not warming:
                gain = (blur / noise) ** 2
                through = 2.0 * gain * visited[SQUARED]  # noise of both angles, a torque by way of the spring
                first, second = gain * (D / span) ** 2, gain * (B / span**2) ** 2
                found = coloured.noise(equation, n, r, first, second, through, work)
                for j in range(n):
                    slope[j] = width * powers[i, j]
                    stiffness += slope[j] * alpha[j]
                    bend += width * powers[i, j - 1] * alpha[j] if j > 0 else 0.0
                uncertain = 2.0 * (bend * blur) ** 2  # the deflection of this very sample is noisy
                uncertain += _uncertainty(equation, n, found, first, second, slope, work)
            if moving and not warming:
                counted = min(equation[coloured.TAKEN] - length + 1.0, equation[coloured.WEIGHT])
                visited[SQUARED] += (stiffness * stiffness - visited[SQUARED]) / counted
            # Forgetting without motion trades data for the leak, which knows no more than they did: never narrower.
            floor = 0.0 if warming or moving else 1.0
            now[1 + i] = stiffness
            spread[1 + i] = max(sqrt(max(uncertain, 0.0)), floor * spread[1 + i])
            total += stiffness
            variance += spread[1 + i] ** 2 + 2.0 * bends * bend * blur**2  # both share the noise of q
            bends += bend

            reached = own[2, slot]
            margin = par[MARGIN] * (visited[HIGH] - visited[LOW])
            if warming:
                worst = WARMING_UP
            elif worst != WARMING_UP and not moving:
                worst = NOT_EXCITED
            elif worst == OK and not visited[LOW] - margin <= reached <= visited[HIGH] + margin:
                worst = OUTSIDE_RANGE
        now[0], spread[0] = total, sqrt(max(variance, 0.0))
        state[window.MOTION], state[window.STATUS] = motion, worst
        window.answer(state, worst, out[k])
    return int(out[-1, 1])
