"""Stiffness from integrated signals, no model needed: QR-RLS on the motor equation integrated in time.

Source: SAPHARI deliverable, Section 4.1, eqs. (36)-(49); `integral` has the equation, what was wrong in print and how
its base moves along. Inertia B and damping D are unknowns like the law's coefficients. What it needs beside angles and
torques is the motor's velocity, measured; where there is none, `filtered_signal_based` filters one out of the angles.

Rules of integration: the effort of a sample is the torque that acted over the interval that ends at its stamp, as in
`modulated_torque`, so its integral is exact; f_j(phi) is a sampled curve, integrated by trapezoids.

Standard deviations hold the torque noise and the velocity noise, both measured; the prior, as wide as the law's
coefficients found so far show it (`integral.spread_of`); and what the basis cuts off: how far the first term cut off
puts stiffness, B and D is known, visit by visit (`integral.considered`), how large that term is is expected from how
the terms fall (`first_cut`). Where the law really ends with the basis that is too much. They leave out drift of the law
within the memory, dry friction, and errors of the angles, but for the newest sample's own in g(phi).

No integral is longer than `horizon`: then the next begins, with a constant of its own, and what the last one told is
kept. Rows far from their base err by the whole random walk in between and still count as much as any other, so short
integrals are also the better ones: in noise, ten times less error of stiffness than integrals from the start on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, log, sqrt

import numpy as np
from numba import njit
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import Status

from via_estimators import integral, window
from via_estimators.basis import (
    BASES,
    LEGENDRE,
    MOST_TERMS,
    ODD_LEGENDRE,
    POWERS,
    fill_basis,
    swing_before,
    swing_of_last,
)
from via_estimators.contract import Estimator, Kernel, Parameters, choice, expect, parameter

BEYOND = 10.0  # deflections larger than so many scales are no deflections
CLEAR = 4.0  # deviations; a term seen so clearly needs no others to bear it out
LEGENDRE_AT_0 = (1.0, -0.5, 0.375, -0.3125)  # P_0, P_2, P_4, P_6
# By degree n > 2: the power of c_n c_(n-4) / c_(n-2)^2 by which c_(n+2) / c_n falls short of c_n / c_(n-2); see `fall`.
BENDING = (0.0, 0.0, 0.0, *(log((n + 2.0) / n) / log(n / (n - 2.0)) for n in range(3, 2 * MOST_TERMS)))
ROUNDS = 5  # of looking for the first term cut off; each is closer by half or better
LENGTH, TRANSMISSIONS, KIND, TERMS, MEMORY, MAX_GAP, SAMPLING, TORQUE_NOISE, VELOCITY_NOISE = range(9)
POSITION_NOISE, SCALE, MINIMUM_MOTION, MARGIN, HORIZON, TRUNCATION, PRIOR = range(9, 16)
# of a transmission, before its equation: deflections visited, whether any; whether integrals run; the last sample, of
# which the basis follows
LOW, HIGH, ANY, RUNNING, AGE, VELOCITY, ANGLE, N_KEPT = range(8)
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class SignalBasedParameters(Parameters):
    """Parameters of `SignalBased`; the deviations are those of the prior, wide enough to be forgotten at once."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals over which motion is judged", "-", 20, 2000)
    basis: str = choice("odd_legendre", "functions that make up the torque law", tuple(BASES))
    terms: int = parameter(4, "number of them", "-", 1, MOST_TERMS)
    truncation: float = parameter(1.0, "doubt about the law cut off, over what is expected; 0: none is", "-", 0.0, 10.0)
    memory: float = parameter(20.0, "time after which a row counts 1/e", "s", 1e-3, 1e9)
    horizon: float = parameter(1.0, "longest integral before a new one begins", "s", 1e-3, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples over which is integrated", "s", 1e-4, 10.0)
    sampling: float = parameter(1e-3, "sampling interval expected", "s", 1e-5, 1.0)
    deflection_scale: float = parameter(1.0, "deflection at which the terms of the law count alike", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of that", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of that", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of that", "N m s/rad", 1e-9, 1e4)
    torque_noise: float = parameter(0.1, "standard deviation of torque noise expected", "N m", 1e-12, 1e9)
    velocity_noise: float = parameter(0.0, "standard deviation of one velocity sample expected", "rad/s", 0.0, 1e3)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "range of deflection below which a window tells nothing", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "share of the visited range that counts as visited beyond it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class SignalBased(Estimator):
    """Stiffness of one or two transmissions from motor torques, motor velocities and angles on both sides."""

    parameters: SignalBasedParameters = SignalBasedParameters()

    @classmethod
    def from_device(cls, device: Device) -> SignalBased:
        """Scales and priors from a device file: its numbers say the order of magnitude, not the answer."""
        motor = device.motors[0] if device.n_transmissions else None
        if not isinstance(motor, TorqueMotor):
            raise ParameterError(f"'{device.name}' has no torque-driven transmission; its torque equation is not known")
        laws = device.spring_laws
        stop = laws[0].max_deflection
        stiffness = laws[0].stiffness(np.linspace(0.0, stop, 65))
        quantum = max(device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0)
        return cls(
            SignalBasedParameters(
                transmissions=device.n_transmissions,
                basis="odd_legendre" if all(law.odd for law in laws) else "legendre",
                terms=4 if all(law.odd for law in laws) else 7,
                sampling=1.0 / device.sensors.rate,
                deflection_scale=stop,
                stiffness_prior=float(stiffness.mean()),
                stiffness_deviation=3.0 * float(stiffness.max()),
                inertia_prior=motor.inertia,
                inertia_deviation=motor.inertia,
                damping_prior=motor.viscous_friction,
                damping_deviation=max(motor.viscous_friction, 1e-6),
                torque_noise=device.sensors.torque_noise or 1e-3 * float(laws[0].torque(stop)),
                position_noise=quantum / sqrt(12.0),
                minimum_motion=max(0.001 * stop, 4.0 * quantum),
            )
        )

    def having(self, parameters: Parameters) -> SignalBased:
        return replace(self, parameters=expect(parameters, SignalBasedParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        each = range(1, self.parameters.transmissions + 1)
        return ("q", *(name for i in each for name in (f"theta_{i}", f"theta_velocity_{i}", f"tau_{i}")))

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        each = range(1, self.parameters.transmissions + 1)
        return (
            "stiffness",
            *(f"stiffness_{i}" for i in each),
            *(f"motor_inertia_{i}" for i in each),
            *(f"motor_damping_{i}" for i in each),
        )

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; not locked, which would be another type to compile."""
        own = self.parameters
        n = own.terms + 3
        row = np.zeros(PRIOR + 2 * n)
        row[:PRIOR] = (
            own.window + 1, own.transmissions, BASES[own.basis], own.terms, own.memory, own.max_gap, own.sampling,
            own.torque_noise, own.velocity_noise, own.position_noise, own.deflection_scale, own.minimum_motion,
            own.range_margin, own.horizon, own.truncation,
        )  # fmt: skip
        row[PRIOR + 1 : PRIOR + 4] = own.inertia_prior, own.damping_prior, own.stiffness_prior
        row[PRIOR + n + 1 : PRIOR + n + 3] = own.inertia_deviation, own.damping_deviation
        row[PRIOR + n + 3 :] = own.stiffness_deviation
        return row

    def init(self) -> Array:
        own = self.parameters
        m, n, length = own.transmissions, own.terms + 3, own.window + 1
        state = np.zeros(window.HEADER + 2 * len(self.outputs) + length * (1 + m) + m * self._each)
        window.start(state)
        held = (
            m * own.stiffness_prior, *(m * (own.stiffness_prior,)), *(m * (own.inertia_prior,)),
            *(m * (own.damping_prior,)), sqrt(m) * own.stiffness_deviation, *(m * (own.stiffness_deviation,)),
            *(m * (own.inertia_deviation,)), *(m * (own.damping_deviation,)),
        )  # fmt: skip
        state[window.HEADER : window.HEADER + len(held)] = held
        for i in range(m):
            integral.start(self._equation(state, i), n, cut_off(BASES[own.basis]), 0)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        n = self.parameters.terms + 3
        factors = [integral.factor(self._equation(state, i), n) for i in range(self.parameters.transmissions)]
        return max(float(np.linalg.cond(R[1:n, 1:n])) for R in factors)

    def _equation(self, state: Array, i: int) -> Array:
        """The view into transmission i's equation, i from 0."""
        own = self.parameters
        end = len(state) - (own.transmissions - 1 - i) * self._each
        return state[end - integral.size(own.terms + 3, cut_off(BASES[own.basis]), 0) : end]

    @cached_property
    def _each(self) -> int:
        """Floats per transmission."""
        own = self.parameters
        cut = cut_off(BASES[own.basis])
        return N_KEPT + own.terms + cut + integral.size(own.terms + 3, cut, 0)

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy")
def row_unit(par: Array) -> float:
    """[N m s] in which rows are counted: what torque noise makes of the integral over one window."""
    return par[TORQUE_NOISE] * par[SAMPLING] * sqrt(par[LENGTH] - 1.0)


@njit(cache=True, error_model="numpy")
def cut_off(kind: int) -> int:
    """How many terms beyond the last are considered: the next one of either parity that the basis has."""
    return 2 if kind in (POWERS, LEGENDRE) else 1


@njit(cache=True, error_model="numpy")
def scratch(n: int) -> Array:
    """Room (14 + 2 n, n) for `learn` and `tell`, made once: an allocation per sample would cost more than its sums.

    n  unknowns and columns considered
    """
    return np.empty((14 + 2 * n, n))


@njit(cache=True, error_model="numpy")
def learn(
    par: Array, colour: Array, kept: Array, equation: Array, elapsed: float, keep: float, moving: bool,
    angle: float, velocity: float, effort: float, basis: Array, work: Array,
) -> None:  # fmt: skip
    """One sample into the equation of one transmission; `kept` remembers it for the next; `work` is `scratch`.

    colour   of the torque's noise, as `integral.rebase` has it
    elapsed  [s] since the sample before
    keep     lambda over that time
    moving   whether this sample tells anything; the integrals pause where it does not
    basis    (terms + cut,) f_j(phi) [rad] of the terms solved for and of those considered
    """
    terms = int(par[TERMS])
    n, unit = terms + 3, row_unit(par)
    mean, width = par[PRIOR : PRIOR + n], par[PRIOR + n : PRIOR + 2 * n]
    row, grown, moved = work[3], work[4], work[5]
    if moving and kept[RUNNING] > 0.0:
        noise = elapsed * par[TORQUE_NOISE]
        moved[0] = moved[1] = 0.0
        grown[1], grown[2] = velocity - kept[VELOCITY], angle - kept[ANGLE]
        for j in range(basis.size):
            grown[3 + j] = -0.5 * elapsed * (kept[N_KEPT + j] + basis[j])
        pushed = elapsed * effort
        for j in range(2, n):
            pushed -= grown[j] * mean[j]
        for j in range(2, grown.size):
            moved[j] = -grown[j] * width[min(j, n - 1)] / unit
        integral.rebase(equation, n, moved, pushed / unit, noise / unit, colour, work)
        if equation[integral.POLES] == 0.0:  # of smoothed noise increments tell little: who smooths sees what is gone
            grown[0] = (pushed - grown[1] * mean[1]) / noise
            for j in range(1, n):
                grown[j] *= width[j] / noise
            integral.compare(equation, n, grown[:n])
        kept[AGE] += elapsed
    if not moving:
        integral.interrupt(equation, n)
    # to the nearest sample, and not one more or less as stamps are rounded
    if kept[RUNNING] > 0.0 and (not moving or kept[AGE] + 0.5 * elapsed >= par[HORIZON]):
        integral.eliminate(equation, n)
        kept[AGE] = 0.0
    integral.forget(equation, n, keep, work[6:])
    if moving:
        row[:] = 0.0
        row[0], row[1] = 1.0, velocity * width[1] / unit
        integral.take(equation, n, row, -velocity * mean[1] / unit)
    kept[RUNNING] = 1.0 if moving else 0.0
    kept[VELOCITY], kept[ANGLE] = velocity, angle
    kept[N_KEPT : N_KEPT + basis.size] = basis


@njit(cache=True, error_model="numpy")
def tell(
    par: Array, kept: Array, equation: Array, warming: bool, phi: float, torque: float, taken_back: float, told: Array,
    work: Array,
) -> None:  # fmt: skip
    """What one equation says: stiffness (43), its bend dsigma/dphi, B, D, variances of stiffness, B, D -> told (7,).

    torque      variance of the torque noise in units of the declared one
    taken_back  the same of velocity noise in increments, as `integral.noise` has it
    work        `scratch`
    """
    kind, terms = int(par[KIND]), int(par[TERMS])
    n, cut = terms + 3, cut_off(kind)
    mean, width = par[PRIOR : PRIOR + n], par[PRIOR + n : PRIOR + 2 * n]
    x = integral.unknowns(equation, n)
    f, g, bend = work[0, : terms + cut], work[1, : terms + cut], work[2, : terms + cut]
    prior, found, slopes, inverted, spare = work[3, :n], work[4], work[7 : 10 + cut], work[12:], work[12 + n :]
    fill_basis(kind, phi, par[SCALE], f, g, bend)
    told[:] = 0.0
    slopes[:] = 0.0  # of stiffness, of B and D, of the last terms of either parity
    slopes[1, 1], slopes[2, 2] = width[1], width[2]
    told[2], told[3] = mean[1], mean[2]
    if not warming:
        told[2] += width[1] * x[1]
        told[3] += width[2] * x[2]
    for j in range(terms):
        share = mean[3 + j] + (0.0 if warming else width[3 + j] * x[3 + j])
        told[0] += share * g[j]
        told[1] += share * bend[j]
        slopes[0, 3 + j] = width[3 + j] * g[j]
        told[4] += slopes[0, 3 + j] * slopes[0, 3 + j]
    told[5], told[6] = width[1] * width[1], width[2] * width[2]
    if not warming:
        blur = 0.5 * taken_back / (par[LENGTH] - 1.0)  # in a row, one velocity instead of two, and other units
        for c in range(cut):
            last = max(n + c - cut, 3)
            slopes[3 + c, last] = width[last]
        integral.inverse(equation, n, inverted)
        prior[:] = 1.0
        prior[3:] = integral.spread_of(equation, n, 3, inverted)
        integral.variances(equation, n, slopes, torque, blur, prior, inverted, spare, found)
        told[4:] = found[:3]
        if par[TRUNCATION] > 0.0:
            off = integral.considered(equation, n)
            for c in range(cut):
                size = par[TRUNCATION] * first_cut(par, kept, x, off[c], c, found[3 + c])
                missed = g[terms + c]
                for j in range(terms):
                    missed -= g[j] * off[c, 3 + j]
                told[4] += (size * missed) ** 2
                for j in (1, 2):
                    told[4 + j] += (size * off[c, j] * width[j] / width[n - 1]) ** 2


@njit(cache=True, error_model="numpy")
def fall(top: float, below: float, first: float, power: float) -> float:
    """c_(n+2) / c_n, at most 1, of Chebyshev coefficients whose ratio goes as n^-p, p >= 0.

    top, below, first  c_n, c_(n-2), c_(n-4); where that is not known, first = 0 and p = 0
    power              that of `BENDING`
    """
    if below == 0.0:
        return 1.0
    per = 1.0 / below
    ratio = min(max(top * per, -1.0), 1.0)
    return ratio if first == 0.0 else ratio * min(abs(ratio * first * per), 1.0) ** power


@njit(cache=True, error_model="numpy")
def first_cut(par: Array, kept: Array, x: Array, off: Array, c: int, doubt: float) -> float:
    """Coefficient [N m/rad] expected of the first term cut off, one of either parity for bases that have both.

    Chebyshev coefficients c_n of a stiffness over the range visited are taken to fall as laws do, c_n / c_(n-2) ~ n^-p
    with the p of the last three of its parity: p = 0 near a singularity, 2 for entire functions such as sinh. Of a law
    that goes on, what is fitted is not its own: the term cut off puts k t and h t into the last two, through the fit
    and through Chebyshev polynomials that it holds. So t is where both agree, sought from below.

    Noise of the last coefficient would enter with a power, t ~ c_n^2 and more, and a few unlucky runs would expect far
    too much. So what the coefficients before it lead one to expect of it, by the same rule, is its prior: it counts as
    its mean square given both, unless it is clear of noise by itself, and never as more than what noise leaves of it.

    x      (n,) estimates
    off    (n,) by what a unit of that term puts them off
    c      which of the terms cut off
    doubt  [(N m/rad)^2] variance of the last coefficient fitted
    """
    kind, terms, cut = int(par[KIND]), int(par[TERMS]), cut_off(int(par[KIND]))
    n = terms + 3
    mean, width = par[PRIOR : PRIOR + n], par[PRIOR + n : PRIOR + 2 * n]
    far = max(abs(kept[LOW]), abs(kept[HIGH])) / par[SCALE]
    j = max(n + c - cut, 3)
    share = mean[j] + width[j] * x[j]
    if share == 0.0 or far == 0.0:
        return 0.0
    clear = share * share / sqrt(share * share + 4.0 * doubt)  # noise does not count twice
    size, next_size = swing_of_last(kind, terms, n - 1 - j, far), swing_of_last(kind, terms, -1 - c, far)
    i = j - cut
    if i < 3 or j + cut != n + c:
        return size * clear / next_size
    before, lower = swing_of_last(kind, terms, n - 1 - i, far), swing_before(kind, terms, n - 1 - j, far, 1)
    b, first, zeroth, degree = before * (mean[i] + width[i] * x[i]), 0.0, 0.0, (3 - cut) * (j - 3)
    if i - cut >= 3:
        first = swing_of_last(kind, terms, n - 1 - i + cut, far) * (mean[i - cut] + width[i - cut] * x[i - cut])
        first += swing_before(kind, terms, n - 1 - i, far, 1) * b
        first += swing_before(kind, terms, n - 1 - j, far, 2) * size * share
    b += lower * size * share
    if degree == 6:  # c_0, of which a series has half, from the middle, where all others are 1 or -1
        zeroth = first - b + size * share
        for at in range(4):
            known = mean[3 + at * cut] + width[3 + at * cut] * x[3 + at * cut]
            zeroth += known * (LEGENDRE_AT_0[at] if kind in (LEGENDRE, ODD_LEGENDRE) else 1.0 if at == 0 else 0.0)
    expected = b / size * (fall(b, first, 2.0 * zeroth, BENDING[degree - 2]) if first != 0.0 else 1.0)
    wide = max(expected * expected, share * share - CLEAR * CLEAR * doubt)
    if wide + doubt > 0.0:
        known = wide / (wide + doubt)
        clear = min(clear, sqrt(known * (known * share * share + doubt)))
    a = (1.0 if share > 0.0 else -1.0) * size * clear
    k = size * off[j] / next_size - swing_before(kind, terms, -1 - c, far, 1)
    h = (before * off[i] + lower * size * off[j]) / next_size - swing_before(kind, terms, -1 - c, far, 2)
    t, ratio, power = 0.0, 0.0, BENDING[degree]
    for _ in range(ROUNDS):
        top = a - min(max(k * t, -abs(a)), 0.5 * abs(a))  # no more than a law that is seen at all can hide
        below = b - min(max(h * t, -abs(b)), 0.5 * abs(b))
        ratio = fall(top, below, first, power)
        t = top * ratio
    tail = 1.0 / (1.0 - min(abs(ratio), 0.5))  # at the ends of the range all of those cut off add up
    return tail * min(abs(t), abs(a)) / next_size


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, terms = int(par[LENGTH]), int(par[TRANSMISSIONS]), int(par[TERMS])
    kind, n, outputs = int(par[KIND]), terms + 3, 1 + 3 * m
    cut = cut_off(kind)
    scale, blur, jitter = par[SCALE], par[POSITION_NOISE], par[VELOCITY_NOISE]
    at = window.HEADER
    now, spread = state[at : at + outputs], state[at + outputs : at + 2 * outputs]
    at += 2 * outputs
    times = state[at : at + length]
    at += length
    ring = state[at : at + length * m].reshape(m, length)  # deflections
    at += length * m
    own = N_KEPT + terms + cut
    each = own + integral.size(n, cut, 0)
    told, work, basis, white = np.empty(7), scratch(n + cut), np.empty((3, terms + cut)), np.ones((1, 1))
    for k in range(rows.shape[0]):
        before = state[window.LAST]
        absurd = False
        for i in range(m):
            absurd = absurd or abs(rows[k, 1] - rows[k, 2 + 3 * i]) > BEYOND * scale
        entered = window.refuse(state) if absurd else window.admit(state, times, rows[k], 2 + 3 * m, par[MAX_GAP])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, q = int(state[window.SLOT]), rows[k, 1]
        full = state[window.FILLED] == length
        elapsed = max(rows[k, 0] - before, 0.0) if state[window.SAMPLES] > 1.0 else 0.0
        keep = exp(-elapsed / par[MEMORY])  # time in a gap, or until a window is full, counts like any other
        worst, motion, total, doubt, bends = OK, np.inf, 0.0, 0.0, 0.0
        for i in range(m):
            kept = state[at + i * each : at + i * each + own]
            equation = state[at + i * each + own : at + (i + 1) * each]
            phi = q - rows[k, 2 + 3 * i]
            ring[i, slot] = phi
            swing = window.spread(ring[i]) if full else 0.0
            motion = min(motion, swing)
            moving = full and swing >= par[MINIMUM_MOTION]
            if moving:
                fill_basis(kind, phi, scale, basis[0], basis[1], basis[2])
            learn(
                par, white, kept, equation, elapsed, keep, moving, rows[k, 2 + 3 * i], rows[k, 3 + 3 * i],
                rows[k, 4 + 3 * i], basis[0], work,
            )  # fmt: skip
            if moving:
                visit(kept, phi)
            warming = equation[integral.TAKEN] < length
            inertia = par[PRIOR + 1] + par[PRIOR + n + 1] * integral.unknowns(equation, n)[1]
            declared = 2.0 * (inertia * jitter / (par[SAMPLING] * par[TORQUE_NOISE])) ** 2
            torque, taken_back = integral.noise(equation, n, declared)
            tell(par, kept, equation, warming, phi, torque, taken_back, told, work)
            # Forgetting without motion trades data for the leak, which knows no more than they did: never narrower.
            floor = 0.0 if warming or moving else 1.0
            at_i, at_B, at_D = 1 + i, 1 + m + i, 1 + 2 * m + i
            now[at_i], now[at_B], now[at_D] = told[0], told[2], told[3]
            spread[at_i] = max(sqrt(told[4] + 2.0 * (told[1] * blur) ** 2), floor * spread[at_i])
            spread[at_B] = max(sqrt(told[5]), floor * spread[at_B])
            spread[at_D] = max(sqrt(told[6]), floor * spread[at_D])
            total += told[0]
            doubt += spread[at_i] ** 2 + 2.0 * bends * told[1] * blur**2  # both share the noise of q
            bends += told[1]
            if warming:
                worst = WARMING_UP
            elif worst != WARMING_UP and not moving:
                worst = NOT_EXCITED
            elif worst == OK and not visited(kept, phi, par[MARGIN]):
                worst = OUTSIDE_RANGE
        now[0], spread[0] = total, sqrt(max(doubt, 0.0))
        state[window.MOTION], state[window.STATUS] = motion, worst
        window.answer(state, worst, out[k])
    return int(out[-1, 1])


@njit(cache=True, error_model="numpy")
def visit(kept: Array, phi: float) -> None:
    """Widen the range of deflections learnt from."""
    kept[LOW] = min(kept[LOW], phi) if kept[ANY] > 0.0 else phi
    kept[HIGH] = max(kept[HIGH], phi) if kept[ANY] > 0.0 else phi
    kept[ANY] = 1.0


@njit(cache=True, error_model="numpy")
def visited(kept: Array, phi: float, margin: float) -> bool:
    """Whether phi lies in the range learnt from, widened by the share `margin` of it."""
    room = margin * (kept[HIGH] - kept[LOW])
    return kept[LOW] - room <= phi <= kept[HIGH] + room
