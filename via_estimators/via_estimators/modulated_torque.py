"""The default stiffness estimator: the undifferentiated modulated torque equation of each motor, solved recursively.

Source: SAPHARI deliverable, Sections 2-4. The motor equation (5), B thdd + D thd - tau_e(phi) = tau, is multiplied by a
modulating function psi that vanishes with its derivatives at both ends of a sliding window (Prop. 1):

    <tau, psi> = B <theta, psi''> - D <theta, psi'> - sum_p a_p <f_p(phi), psi>,   f_p = s (phi/s)^p / p, f_0 = s

so that sigma(phi) = sum_p a_p (phi/s)^(p-1): every a_p [N m/rad] is a share of stiffness at deflection scale s. Odd
powers p = 1, 3, ..; a law that is not skew-symmetric (springs pretensioned against each other) needs 0, 2, 4, .. too.
Departures from the document, each measured to help (estimation.md): the equation is not differentiated first, B and D
are unknowns, the basis is odd, psi is w_55 by default and not w_33, the update is QR with a prior, and standard
deviations know the colour of the noise (`coloured`).

Samples need not be equidistant: the stamps make the weights (via_core.weak_form), and a constant added to q and theta
changes nothing.

Standard deviations hold noise, and what the basis cuts off: the last term of the law is a guess at the first one
missing (`truncation`). So give the basis one term to spare, or say that it is exact.

Effort convention: the effort in a sample stamped t_n is the torque that acted over the interval ENDING at t_n,
(t_(n-1), t_n], as a simulator or drive reports what it has just applied. A torque command is held over exactly such an
interval, so <tau, psi> = sum tau_n (t_n - t_(n-1)) (psi_n + psi_(n-1))/2. Taking it for a sampled curve instead would
delay the torque by half a sample.
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
from via_core.status import Status

from via_estimators import coloured, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter

MOST_TERMS = 6
BEYOND = 10.0  # deflections larger than so many scales are no deflections
LENGTH, TRANSMISSIONS, ORDER, EVEN, MEMORY, MAX_GAP, TORQUE_NOISE, POSITION_NOISE, SCALE = range(9)
MINIMUM_MOTION, MARGIN, TRUNCATION, MODULATING, PRIOR = range(9, 14)
# Smallest and largest deflection visited (its size, if odd), whether any was, mean of the squared stiffness there.
LOW, HIGH, ANY, SQUARED, N_VISITED = range(5)
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class ModulatedTorqueParameters(Parameters):
    """Parameters of `ModulatedTorque`; the deviations are those of the prior, wide enough to be forgotten at once."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals per window", "-", 20, 2000)
    modulating_order: int = parameter(5, "h of the modulating function w_hh", "-", 2, 9)
    order: int = parameter(3, "odd terms of the torque law", "-", 1, MOST_TERMS)
    even_terms: int = parameter(0, "even terms besides, the constant first", "-", 0, MOST_TERMS)
    truncation: float = parameter(1.0, "share of the last term that a law cut off may hide; 0: none is", "-", 0.0, 10.0)
    memory: float = parameter(20.0, "time after which a row counts 1/e", "s", 0.05, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which the terms of the law count alike", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of that", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of that", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of that", "N m s/rad", 1e-9, 1e4)
    torque_noise: float = parameter(0.1, "standard deviation of torque noise expected", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "range of deflection below which a window tells nothing", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "share of the visited range that counts as visited beyond it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class ModulatedTorque(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    parameters: ModulatedTorqueParameters = ModulatedTorqueParameters()

    @classmethod
    def from_device(cls, device: Device) -> ModulatedTorque:
        """Scales and priors from a device file: its numbers say the order of magnitude, not the answer."""
        motor, law = transmissions.motors_of(device)[0], device.spring_laws[0]
        stiffness = law.stiffness(np.linspace(0.0, law.max_deflection, 65))
        order, even = _terms_for(device.spring_laws)
        return cls(
            ModulatedTorqueParameters(
                **transmissions.known_of(device),
                order=order,
                even_terms=even,
                stiffness_prior=float(stiffness.mean()),
                stiffness_deviation=3.0 * float(stiffness.max()),
                inertia_prior=motor.inertia,
                inertia_deviation=motor.inertia,
                damping_prior=motor.viscous_friction,
                damping_deviation=max(motor.viscous_friction, 1e-6),
            )
        )

    def having(self, parameters: Parameters) -> ModulatedTorque:
        return replace(self, parameters=expect(parameters, ModulatedTorqueParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel, noise colours (3, 2 L) by slot; not locked, which would be another type."""
        own = self.parameters
        n = own.order + own.even_terms + 2
        row = np.zeros(PRIOR + 2 * n)
        row[:PRIOR] = (
            own.window + 1, own.transmissions, own.order, own.even_terms, own.memory, own.max_gap, own.torque_noise,
            own.position_noise, own.deflection_scale, own.minimum_motion, own.range_margin, own.truncation,
            own.modulating_order,
        )  # fmt: skip
        row[PRIOR : PRIOR + 3] = own.inertia_prior, own.damping_prior, own.stiffness_prior
        row[PRIOR + n :] = own.inertia_deviation, own.damping_deviation, *((n - 2) * (own.stiffness_deviation,))
        return row, coloured.mirrored(coloured.colours(own.window, own.modulating_order))

    def init(self) -> Array:
        own = self.parameters
        length, n = own.window + 1, own.order + own.even_terms + 2
        columns = own.transmissions * n
        each = N_VISITED + coloured.size(n, length)
        state = np.zeros(window.HEADER + 2 * len(self.outputs) + length * (1 + columns) + own.transmissions * each)
        window.start(state)
        m, row = own.transmissions, self._constants[0]
        (B, D, k), (dB, dD, dk) = row[PRIOR : PRIOR + 3], row[PRIOR + n : PRIOR + n + 3]
        held = (m * k, *(m * (k,)), *(m * (B,)), *(m * (D,)), sqrt(m) * dk, *(m * (dk,)), *(m * (dB,)), *(m * (dD,)))
        state[window.HEADER : window.HEADER + len(held)] = held
        for i in range(m):
            coloured.start(state[len(state) - (i + 1) * each + N_VISITED : len(state) - i * each], n)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        own = self.parameters
        n = own.order + own.even_terms + 2
        each = N_VISITED + coloured.size(n, own.window + 1)
        found = 1.0
        for i in range(own.transmissions):
            R = coloured.factor(state[len(state) - (i + 1) * each + N_VISITED : len(state) - i * each], n)
            found = max(found, float(np.linalg.cond(R)))
        return found

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


def _terms_for(laws: tuple[SpringLaw, ...]) -> tuple[int, int]:
    """Odd and even terms that follow the laws to 1 % of their largest torque, and one to spare to tell whether."""
    share = np.linspace(-1.0, 1.0, 129)
    torques = np.stack([law.torque(share * law.max_deflection) for law in laws], axis=1)
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
    """The power of phi in a term: odd ones first, then the even ones from 0."""
    return 2 * term + 1 if term < order else 2 * (term - order)


@njit(cache=True, error_model="numpy")
def _tail(term: int, order: int, far: float, mean: Array, width: Array, x: Array, work: Array) -> float:
    """Squared stiffness [N m/rad] that a law this basis cuts off may still hide: the size of the last term there is.

    Over the deflections visited, |phi| <= far s, a power n of phi holds 2^(1-n) far^n of the Chebyshev polynomial T_n,
    and coefficients of a smooth law fall from one to the next. What is noise in the last one does not count twice.

    work  as `coloured.blur` leaves it
    """
    j = 2 + term
    n = _power(term, order) - 1
    size = 2.0 ** (1 - n) * far**n if n > 0 else 0.0
    share, variance = mean[j] + width[j] * x[j], width[j] * width[j] * coloured.variance_of(x.size, j, work)
    return size * size * max(share * share - 4.0 * variance, 0.0)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, order = int(par[LENGTH]), int(par[TRANSMISSIONS]), int(par[ORDER])
    even = int(par[EVEN])
    n, outputs = order + even + 2, 1 + 3 * m
    columns = m * n
    scale, noise, blur = par[SCALE], par[TORQUE_NOISE], par[POSITION_NOISE]
    mean, width = par[PRIOR : PRIOR + n], par[PRIOR + n : PRIOR + 2 * n]
    at = window.HEADER
    now, spread = state[at : at + outputs], state[at + outputs : at + 2 * outputs]
    at += 2 * outputs
    times = state[at : at + length]
    at += length
    ring = state[at : at + length * columns].reshape(columns, length)  # theta, tau, f_1.. per transmission
    at += length * columns
    each = N_VISITED + coloured.size(n, length)
    psi, lagged, held = np.empty((3, length)), np.empty((3, length)), np.empty(length)
    row, slope, work = np.empty(n), np.zeros(n), coloured.scratch(n)
    powers = np.ones((m, 2 * MOST_TERMS))
    for k in range(rows.shape[0]):
        before = state[window.LAST]
        entered = transmissions.enter(state, times, rows[k], m, BEYOND * scale, par[MAX_GAP])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, q = int(state[window.SLOT]), rows[k, 1]
        for i in range(m):
            own = ring[i * n : (i + 1) * n]
            own[0, slot], own[1, slot] = rows[k, 2 + 2 * i], rows[k, 3 + 2 * i]
            ratio = (q - rows[k, 2 + 2 * i]) / scale
            for p in range(1, 2 * MOST_TERMS):
                powers[i, p] = powers[i, p - 1] * ratio
            for term in range(order + even):
                p = _power(term, order)
                own[2 + term, slot] = scale * powers[i, p] / max(p, 1)
        full, span = state[window.FILLED] == length, 1.0
        elapsed = rows[k, 0] - before if state[window.SAMPLES] > 1.0 else 0.0
        keep = exp(-max(elapsed, 0.0) / par[MEMORY])  # time in a gap, or until a window is full, counts like any other
        if full:
            span = window.weigh(int(par[MODULATING]), times, slot, psi, held)
            coloured.lags(r, slot, keep, lagged)
        middle = slot + length // 2 + 1
        middle = middle if middle < length else middle - length
        worst, motion, total, variance, bends = OK, np.inf, 0.0, 0.0, 0.0
        for i in range(m):
            visited = state[at + i * each : at + i * each + N_VISITED]
            equation = state[at + i * each + N_VISITED : at + (i + 1) * each]
            x = coloured.unknowns(equation, n)
            own = ring[i * n : (i + 1) * n]
            if entered == window.RESTARTED:
                coloured.forget_rows(equation, n)
            moved = window.spread(own[2]) if full else 0.0
            motion = min(motion, moved)
            moving = full and moved >= par[MINIMUM_MOTION]
            coloured.forget(equation, n, keep, work)
            if moving:
                y = coloured.dot(held, own[1])
                row[0], row[1] = coloured.dot(psi[2], own[0]), -coloured.dot(psi[1], own[0])
                for p in range(order + even):
                    row[2 + p] = -coloured.dot(psi[0], own[2 + p])
                for j in range(n):
                    y -= row[j] * mean[j]
                    row[j] *= width[j] / noise
                coloured.take(equation, n, slot, row, y / noise, lagged, work)
                reached = abs(own[2, middle]) if even == 0 else own[2, middle]
                visited[LOW] = min(visited[LOW], reached) if visited[ANY] > 0.0 else reached
                visited[HIGH] = max(visited[HIGH], reached)
                visited[ANY] = 1.0
            elif full:
                coloured.skip(equation, n, slot, length)

            warming = equation[coloured.TAKEN] < length
            B, D = (mean[0], mean[1]) if warming else (mean[0] + width[0] * x[0], mean[1] + width[1] * x[1])
            stiffness, bend = 0.0, 0.0
            for term in range(order + even):
                p, j = _power(term, order), 2 + term
                share = mean[j] + (0.0 if warming else width[j] * x[j])
                rise = powers[i, p - 1] if p > 0 else 0.0
                slope[j] = width[j] * rise
                stiffness += share * rise
                bend += share * (p - 1) * powers[i, p - 2] / scale if p > 1 else 0.0
            uncertain = 2.0 * (bend * blur) ** 2  # the deflection of this very sample is noisy
            of_B = of_D = 1.0
            if warming:
                for j in range(2, n):
                    uncertain += slope[j] * slope[j]
            else:
                gain = (blur / noise) ** 2
                through = 2.0 * gain * visited[SQUARED]  # noise of both angles, a torque by way of the spring
                first, second = gain * (D / span) ** 2, gain * (B / span**2) ** 2
                found = coloured.noise(equation, n, r, first, second, through, work)
                coloured.blur(equation, n, found, first, second, work)
                of_B, of_D = coloured.variance_of(n, 0, work), coloured.variance_of(n, 1, work)
                uncertain += coloured.variance(n, slope, work)
                if par[TRUNCATION] > 0.0:
                    far = max(abs(visited[LOW]), abs(visited[HIGH])) / scale
                    tail = _tail(order - 1, order, far, mean, width, x, work)
                    if even > 1:
                        tail += _tail(order + even - 1, order, far, mean, width, x, work)
                    uncertain += par[TRUNCATION] ** 2 * tail
            if moving and not warming:
                counted = min(equation[coloured.TAKEN] - length + 1.0, equation[coloured.WEIGHT])
                visited[SQUARED] += (stiffness * stiffness - visited[SQUARED]) / counted
            # Forgetting without motion trades data for the leak, which knows no more than they did: never narrower.
            floor = 0.0 if warming or moving else 1.0
            at_i, at_B, at_D = 1 + i, 1 + m + i, 1 + 2 * m + i
            now[at_i], now[at_B], now[at_D] = stiffness, B, D
            spread[at_i] = max(sqrt(uncertain), floor * spread[at_i])
            spread[at_B] = max(width[0] * sqrt(of_B), floor * spread[at_B])
            spread[at_D] = max(width[1] * sqrt(of_D), floor * spread[at_D])
            total += stiffness
            variance += spread[at_i] ** 2 + 2.0 * bends * bend * blur**2  # both share the noise of q
            bends += bend

            reached = abs(own[2, slot]) if even == 0 else own[2, slot]
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
