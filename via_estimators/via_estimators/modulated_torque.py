"""The default stiffness estimator: the modulated torque equation of each motor, whose spring may change.

Source: SAPHARI deliverable, Sections 2-4. The motor equation (5), B thdd + D thd - tau_e(phi) = tau, with dry friction
F and a torque that is reported d late, is multiplied by a modulating function psi that vanishes with its derivatives at
both ends of a window (Prop. 1):

    <tau, psi> = B <theta, psi''> - D <theta, psi'> + F <sign(thd), psi> + G <sat(thd / v_s), psi> + d <tau, psi'>
                 - sum_p a_p <f_p(phi), psi>

with f_p = s (phi/s)^p / p, f_0 = s, so that sigma(phi) = sum_p a_p (phi/s)^(p-1), with a_p [N m/rad] in units of
stiffness at the deflection scale s. Powers are odd, p = 1, 3, ..; a spring law that is not odd (springs pretensioned
against each other) also needs 0, 2, 4, .. The delay also enters to second order, with the present estimate of d: the
right side is less by d^2 <tau, psi''> / 2.

Departures from the document, each with a measured benefit (estimation.md): the equation is not differentiated first; B,
D, F and d are unknowns; the basis is odd; psi is w_55 by default instead of w_33; the solver lets the spring law change
in time (`interacting_models`). sat is linear within -1..1 and constant beyond: friction that builds up (presliding) or
falls (Stribeck) with speed is a sum of F and G. Without G it would be taken for damping.

There are two equations per window length. Neighbours then share so little of psi that their noise is independent (its
correlation is .04), and still they use 91 % of the information in all samples. An equation holds in the middle of its
window, half a window ago: up to the present sample the estimate is continued with its trend, and its standard deviation
grows by what the spring may have changed since.

Samples need not be equidistant: the weights follow the stamps (via_core.weak_form). A constant added to q and theta has
no effect.

Standard deviations include noise, changes of the spring, the declared uncertainty of the torque's scale, which no
motion shows, and the truncation of the basis: the last term estimates the size of the first one left out
(`truncation`). So give the basis one term more than needed, or set truncation to 0 if it is exact. Where a motor
sticks, dry friction of unknown sign is noise.

Effort convention: the effort in a sample stamped t_n is the torque that acted over the interval ENDING at t_n,
(t_(n-1), t_n], as a simulator or drive reports what it has just applied. A torque command is constant over exactly such
an interval (zero-order hold), so <tau, psi> = sum tau_n (t_n - t_(n-1)) (psi_n + psi_(n-1))/2. Treating it as a sampled
curve would delay the torque by half a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import cos, sin, sqrt
from typing import Any

import numpy as np
from numba import njit
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import interacting_models, torque_equation, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.interacting_models import Bank, Work
from via_estimators.slots import row_of, slots
from via_estimators.spring_series import MOST_TERMS, terms_for
from via_estimators.torque_equation import LINK, PHI, QUANTUM, TAU, THETA, P, U
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
ROWS_PER_WINDOW = 2  # equations per window length: the noise of neighbours then has a correlation of .04
SLOWEST = 0.005  # [largest deflections / s] slower motion does not excite
SHORTEST, FEWEST, MOST = 0.1, 20, 400  # [s], and in intervals: windows from a device file
EXACTNESS = 1e-4  # [-] least noise of the link's torques, over the torque at the stop
SLOW_FORCE = 1.0  # [s] how long forces at the link last that exceed its noise
ENERGY = 1.98, 3010.0  # c_0 and c_2 of w_55
# Of each transmission: range of the deflection in the last window [rad], 1 if it was informative; equations taken.
KEPT = slots("moved", "moving", "taken", after=VISITED)
ROW = slots("since")  # of the joint: samples since the last equation


@dataclass(frozen=True)
class ModulatedTorqueParameters(Parameters):
    """Parameters of `ModulatedTorque`; the prior is so wide that data soon replace it."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals per window", "-", 20, 2000)
    modulating_order: int = parameter(5, "h of the modulating function w_hh", "-", 2, 9)
    order: int = parameter(3, "odd terms of the spring law", "-", 1, MOST_TERMS)
    even_terms: int = parameter(0, "even terms in addition, the constant first", "-", 0, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over the last term; 0: the basis is exact", "-", 0.0, 10.0)
    memory: float = parameter(60.0, "mean time between changes of how fast the spring changes", "s", 0.05, 1e9)
    steadiness: float = parameter(0.5, "probability that a spring does not change; 1: it never does", "-", 0.0, 1.0)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    friction_prior: float = parameter(0.0, "dry friction of a motor before any data", "N m", 0.0, 1e6)
    friction_deviation: float = parameter(1.0, "standard deviation of the prior dry friction", "N m", 1e-9, 1e6)
    delay_deviation: float = parameter(
        0.003, "standard deviation of the torque's delay before any data", "s", 1e-9, 1.0
    )
    torque_scale_deviation: float = parameter(0.0, "relative standard deviation of the torque's scale", "-", 0.0, 1.0)
    link_inertia_prior: float = parameter(0.0, "link inertia before any data", "kg m^2", 0.0, 1e3)
    link_inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    link_damping_prior: float = parameter(0.0, "link damping before any data", "N m s/rad", 0.0, 1e4)
    link_damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    link_friction_prior: float = parameter(0.0, "dry friction of the link before any data", "N m", 0.0, 1e6)
    gravity_sine_prior: float = parameter(0.0, "factor of sin q in the link's gravity torque", "N m", -1e6, 1e6)
    gravity_cosine_prior: float = parameter(0.0, "factor of cos q in the link's gravity torque", "N m", -1e6, 1e6)
    force_deviation: float = parameter(
        1.0, "standard deviation of unknown torques at the link: friction, gravity, contact", "N m", 1e-9, 1e6
    )
    force_noise: float = parameter(1e-3, "least noise of the link's torques", "N m", 1e-12, 1e6)
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
        motor, spring = transmissions.motors_of(device)[0], device.spring_laws[0]
        typical = 0.05 * abs(float(spring.torque(spring.max_deflection)))
        window, quantum = _window_for(motor, known, device), QUANTUM * known["position_noise"]
        slowest = SLOWEST * spring.max_deflection * window / device.sensors.rate
        known |= {"window": window, "minimum_motion": max(slowest, 3.0 * quantum)}  # rounding alone reaches 2 steps
        known |= {"friction_prior": motor.coulomb_friction, "friction_deviation": max(motor.coulomb_friction, typical)}
        known |= {"torque_scale_deviation": device.tolerances.torque_scale}
        known |= _link_priors(device, typical)
        if device.tolerances.torque_timing > 0.0:
            known["delay_deviation"] = device.tolerances.torque_timing
        order, even = terms_for(device.spring_laws)
        return cls(ModulatedTorqueParameters(**known, order=order, even_terms=even))

    def with_parameters(self, parameters: Parameters) -> ModulatedTorque:
        return replace(self, parameters=expect(parameters, ModulatedTorqueParameters))

    @property
    def models_torque_errors(self) -> bool:
        return True

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @property
    def _layout(self) -> tuple[int, int]:
        """Number of unknowns of a transmission, and of all, of which the last are the trends."""
        own = self.parameters
        block = U.size + own.order + own.even_terms
        return block, own.transmissions * (block + 1) + LINK.size

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; writable, since a locked array compiles again."""
        own, (block, n) = self.parameters, self._layout
        m = own.transmissions
        mean, width = np.zeros(n), np.ones(n)
        for each in (slice(i * block, (i + 1) * block) for i in range(m)):
            mean[each][: U.size + 1] = (
                own.inertia_prior, own.damping_prior, own.friction_prior, 0.0, 0.0, own.stiffness_prior,
            )  # fmt: skip
            width[each] = own.stiffness_deviation
            width[each][: U.size] = (
                own.inertia_deviation, own.damping_deviation, own.friction_deviation, own.friction_deviation,
                own.delay_deviation,
            )  # fmt: skip
        link = slice(m * block, m * block + LINK.size)
        mean[link] = (
            own.link_inertia_prior, own.link_damping_prior, own.link_friction_prior, 0.0, own.gravity_sine_prior,
            own.gravity_cosine_prior,
        )  # fmt: skip
        width[link] = own.force_deviation
        width[link][: LINK.friction] = own.link_inertia_deviation, own.link_damping_deviation
        return np.concatenate([row_of(P, own, length=own.window + 1), mean, width])

    def init(self) -> Array:
        own, n = self.parameters, self._layout[1]
        m, length, k = own.transmissions, own.window + 1, len(self.outputs)
        bank = interacting_models.size(n, m + 1)
        state = np.zeros(HEADER.size + 2 * k + ROW.size + length * (1 + 3 * m) + m * KEPT.size + bank)
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(own, "inertia", "damping")
        interacting_models.start(state[-bank:], n, m, m + 1, own.steadiness)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        block, n = self._layout
        m = self.parameters.transmissions
        known = interacting_models.bank_of(np.array(state[-interacting_models.size(n, m + 1) :]), n, m + 1).P[-1]
        parts = [known[i * block : (i + 1) * block, i * block : (i + 1) * block] for i in range(m)]
        return float(np.sqrt(max(np.linalg.cond(each) for each in parts)))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


def _window_for(motor: TorqueMotor, known: dict[str, Any], device: Device) -> int:
    """Sampling intervals of the shortest window in which torque noise exceeds that of the encoders five times.

    A longer window delays the estimate and hides motion, a shorter one adds encoder noise through psi''. The variances
    are proportional to c_0 torque_noise^2 / T and c_2 (B position_noise)^2 / T^5, c_i = T^(2i+1) <psi^(i), psi^(i)>.
    """
    balance = motor.inertia * known["position_noise"] / known["torque_noise"]
    span = max(SHORTEST, sqrt(balance) * (5.0 * ENERGY[1] / ENERGY[0]) ** 0.25)
    return int(min(max(round(span * device.sensors.rate), FEWEST), MOST))


def _link_priors(device: Device, typical: float) -> dict[str, float]:
    """Priors of the link that also admit payloads and contacts; `typical` torque [N m] of friction and contact."""
    link = device.link
    return {
        "link_inertia_prior": link.inertia,
        "link_inertia_deviation": link.inertia,
        "link_damping_prior": link.viscous_friction,
        "link_damping_deviation": max(link.viscous_friction, typical),
        "link_friction_prior": link.coulomb_friction,
        "gravity_sine_prior": link.gravity_torque * cos(link.gravity_angle),
        "gravity_cosine_prior": -link.gravity_torque * sin(link.gravity_angle),
        "force_deviation": max(link.coulomb_friction, abs(link.gravity_torque), typical),
        "force_noise": EXACTNESS * 20.0 * typical,
    }


@njit(cache=True, error_model="numpy")
def _unroll(ring: Array, oldest: int, out: Array) -> None:
    """Copy a ring (.., L) into out (.., L), oldest first."""
    length = ring.shape[-1]
    for i in range(ring.shape[0]):
        for k in range(length):
            at = oldest + k
            out[i, k] = ring[i, at if at < length else at - length]


@njit(cache=True, error_model="numpy")
def _learn_motor(
    par: Array, times: Array, psi: Array, held: Array, late: Array, own: Array, i: int, bank: Bank, row: Array,
    none: Array, work: Work,
) -> None:  # fmt: skip
    """Add the equation of motor i in the present window `own`; `row`, `none` (n,) are overwritten."""
    n, length, m = row.size, times.size, int(par[P.transmissions])
    block = (n - m - LINK.size) // m
    part = slice(i * block, (i + 1) * block)
    mean, width = par[P.size : P.size + n][part], par[P.size + n : P.size + 2 * n][part]
    x, covariance = bank.x[-1][part], bank.P[-1][part, part]
    row[:], none[:] = 0.0, 0.0
    own_row, span, dry = row[part], times[length - 1] - times[0], slice(U.friction, U.slow + 1)
    y, unknown = torque_equation.fill_motor(par, psi, held, late, own, span, width[U.delay] * x[U.delay], own_row)
    stiffness = torque_equation.stiffness(par, mean, width, x, own[PHI, length // 2], none[part])[0]
    none[:] = 0.0
    inertia, damping, friction = mean[:3] + width[:3] * x[:3]
    within = angles = 0.0
    for k in range(length):
        of_link = stiffness * psi[0, k]
        of_motor = inertia * psi[2, k] - damping * psi[1, k] + of_link
        within += held[k] * held[k]
        angles += of_motor * of_motor + of_link * of_link
    friction += mean[U.slow] + width[U.slow] * x[U.slow]
    any_friction = friction**2 + interacting_models.quadratic(covariance[dry, dry], width[dry])
    beside = par[P.position_noise] ** 2 * angles + unknown**2 * any_friction
    for j in range(block):
        y -= own_row[j] * mean[j]
        own_row[j] *= width[j]
    within *= par[P.torque_noise] ** 2
    interacting_models.take(bank, i, row, y, within, beside, none, 0.0, 0.0, (0, 0), work)


@njit(cache=True, error_model="numpy")
def _learn_link(
    par: Array, times: Array, psi: Array, own: Array, bank: Bank, row: Array, noisy: Array, work: Work
) -> None:  # fmt: skip
    """Add the equation of the link in the present windows `own` (m, 3, L); `row`, `noisy` (n,) are overwritten."""
    n, length, m = row.size, times.size, own.shape[0]
    first = n - m - LINK.size
    block, link = first // m, slice(first, first + LINK.size)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    x, covariance, span = bank.x[-1], bank.P[-1], times[length - 1] - times[0]
    row[:], noisy[:] = 0.0, 0.0
    unknown = torque_equation.fill_link(par, psi, own[0], span, row[link])
    stiff, slopes, of_link = np.empty(m), np.empty(m), mean[link] + width[link] * x[link]
    for i in range(m):
        part = slice(i * block, (i + 1) * block)
        torque_equation.fill_spring(par, psi, own[i, PHI], 1.0, row[part])
        middle = own[i, PHI, length // 2]
        stiff[i] = torque_equation.stiffness(par, mean[part], width[part], x[part], middle, noisy[part])[0]
    doubt = width[first] ** 2 * covariance[first, first]
    within = torque_equation.link_noise(par, psi, of_link, doubt, stiff, noisy[first:], slopes)
    for i in range(m):
        noisy[i * block : (i + 1) * block] *= slopes[i]
    noisy[link] *= width[link]
    noisy /= within
    dry = slice(first + LINK.friction, first + LINK.slow + 1)
    friction = of_link[LINK.friction] + of_link[LINK.slow]
    any_friction = friction**2 + interacting_models.quadratic(covariance[dry, dry], width[dry])
    y = springs = 0.0
    for j in range(first + LINK.size):
        y -= row[j] * mean[j]
        springs += row[j] * (mean[j] + width[j] * x[j]) if j < first else 0.0
        row[j] *= width[j]
    force = par[P.force_deviation] ** 2 + springs**2  # a contact may take up all that the springs exert
    interacting_models.take(
        bank, m, row, y, within, unknown**2 * any_friction, noisy, SLOW_FORCE / (0.5 * span), force,
        (first, first + LINK.size), work,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _learn(
    par: Array, times: Array, psi: Array, held: Array, late: Array, ring: Array, slot: int, own: Array, parts: Array,
    bank: Bank, directions: Array, row: Array, spare: Array, work: Work,
) -> None:  # fmt: skip
    """Add the equations of the present window, and its middle part to the deflections visited, which include 0."""
    n, length, m = row.size, times.size, own.shape[0]
    block, oldest = (n - m - LINK.size) // m, window.oldest_of(slot, length)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    span, any_moving = times[length - 1] - times[0], False
    directions[:] = 0.0
    for i in range(m):
        _unroll(ring[i], oldest, own[i])
        kept, moved = parts[i], window.span_of(own[i, PHI])
        kept[KEPT.moved], kept[KEPT.moving] = moved, 1.0 if moved >= par[P.minimum_motion] else 0.0
        any_moving = any_moving or kept[KEPT.moving] > 0.0
        for j in range(i * block + U.size, (i + 1) * block):
            directions[i, j] = mean[j] / width[j] + bank.x[-1, j]
    if not any_moving:
        return
    middle = times[length // 2]
    interacting_models.begin(bank, middle, par[P.memory], par[P.steadiness], directions, span, work)
    for i in range(m):
        kept = parts[i]
        if kept[KEPT.moving] > 0.0:
            _learn_motor(par, times, psi, held, late, own[i], i, bank, row, spare, work)
            kept[KEPT.taken] += 1.0
            quarter = length // (2 * ROWS_PER_WINDOW)
            for k in range(quarter, length - quarter):
                transmissions.visit(kept, own[i, PHI, k] if par[P.even_terms] > 0.0 else abs(own[i, PHI, k]))
            kept[VISITED.high] = max(kept[VISITED.high], 0.0)
    _learn_link(par, times, psi, own, bank, row, spare, work)
    interacting_models.combine(bank)


@njit(cache=True, error_model="numpy", forceinline=True)
def _report(
    par: Array, now: float, phi: float, kept: Array, bank: Bank, i: int, value: Array, sd: Array, joint: Array,
    slope: Array, own: Array,
) -> bool:  # fmt: skip
    """Write the outputs of transmission i and add it to the joint; returns whether it is still warming up.

    slope  (n,) sum of the derivatives of the stiffnesses by x
    own    (n,) work space
    """
    n, m = slope.size, int(par[P.transmissions])
    block = (n - m - LINK.size) // m
    part, trend = slice(i * block, (i + 1) * block), n - m + i
    mean, width = par[P.size : P.size + n][part], par[P.size + n : P.size + 2 * n][part]
    x, covariance = bank.x[-1], bank.P[-1]
    warming = kept[KEPT.taken] <= ROWS_PER_WINDOW
    own[:] = 0.0
    stiffness, bend = torque_equation.stiffness(par, mean, width, x[part], phi, own[part])
    factor = par[P.torque_scale_deviation] ** 2
    if not warming:
        age = max(now - bank.head[interacting_models.HEAD.time], 0.0)
        factor += interacting_models.wander(bank, age)
        own[trend] = age * stiffness
        stiffness += own[trend] * x[trend]
    of_unknowns = interacting_models.quadratic(covariance, own)
    uncertain = (
        of_unknowns
        + factor * stiffness**2
        + torque_equation.truncation(par, mean, width, kept, x[part], covariance[part, part])
        + 2.0 * (bend * par[P.position_noise]) ** 2  # the deflection of this very sample is noisy
    )
    learning = warming or kept[KEPT.moving] > 0.0
    transmissions.update(value, sd, 1 + i, stiffness, sqrt(uncertain), learning)
    for at, j in ((1 + m + i, U.inertia), (1 + 2 * m + i, U.damping)):
        found = mean[j] + width[j] * x[part][j]
        doubt = width[j] ** 2 * covariance[part, part][j, j] + (par[P.torque_scale_deviation] * found) ** 2
        transmissions.update(value, sd, at, found, sqrt(doubt), learning)
    # A wrong torque constant, or a change since the last equation, may have the same cause in all transmissions.
    transmissions.add(joint, stiffness, sd[1 + i], bend, par[P.position_noise] ** 2, sqrt(factor) * stiffness)
    joint[JOINT.variance] -= of_unknowns
    slope += own
    return warming


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, even = int(par[P.length]), int(par[P.transmissions]), int(par[P.even_terms])
    block, outputs = U.size + int(par[P.order]) + even, 1 + 3 * m
    n = m * (block + 1) + LINK.size
    value, sd = window.outputs(state, outputs)
    schedule = state[HEADER.size + 2 * outputs : HEADER.size + 2 * outputs + ROW.size]
    at = HEADER.size + 2 * outputs + ROW.size
    times, columns = window.rings(state, at, length, 3 * m)
    at += length * (1 + 3 * m)
    ring, parts = columns.reshape(m, 3, length), state[at : at + m * KEPT.size].reshape(m, KEPT.size)
    bank = interacting_models.bank_of(state[at + m * KEPT.size :], n, m + 1)
    psi, held, late = np.empty((3, length)), np.empty(length), np.empty(length)
    stamps, own, directions = np.empty((1, length)), np.empty((m, 3, length)), np.empty((m, n))
    row, slope, spare, work, joint = np.empty(n), np.empty(n), np.empty(n), interacting_models.scratch(n), np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        entered = transmissions.enter(state, times, rows[k], 2, FURTHEST * par[P.deflection_scale], par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot = int(state[HEADER.slot])
        for i in range(m):
            ring[i, THETA, slot], ring[i, TAU, slot] = rows[k, 2 + 2 * i], rows[k, 3 + 2 * i]
            ring[i, PHI, slot] = rows[k, 1] - rows[k, 2 + 2 * i]
        full = state[HEADER.filled] == length
        schedule[ROW.since] = schedule[ROW.since] + 1.0 if full else length
        if full and schedule[ROW.since] * ROWS_PER_WINDOW >= length - 1:
            schedule[ROW.since] = 0.0
            _unroll(times.reshape(1, length), window.oldest_of(slot, length), stamps)
            window.weigh(int(par[P.modulating_order]), stamps[0], length - 1, psi, held)
            window.hold_slope(stamps[0], length - 1, psi[0], late)
            _learn(par, stamps[0], psi, held, late, ring, slot, own, parts, bank, directions, row, spare, work)
        transmissions.begin(joint)
        slope[:] = 0.0
        for i in range(m):
            kept, phi = parts[i], ring[i, PHI, slot]
            if not full:
                kept[KEPT.moved] = kept[KEPT.moving] = 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], kept[KEPT.moved])
            warming = _report(par, rows[k, 0], phi, kept, bank, i, value, sd, joint, slope, spare)
            reached = phi if even else abs(phi)
            inside = transmissions.inside(kept, reached, par[P.range_margin])
            transmissions.grade(joint, warming, kept[KEPT.moving] > 0.0, inside)
        joint[JOINT.variance] += interacting_models.quadratic(bank.P[-1], slope)
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
