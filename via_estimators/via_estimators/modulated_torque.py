"""The default stiffness estimator: the modulated torque equations of motors and link, whose springs may change.

Source: SAPHARI deliverable, Sections 2-4. The motor equation (5), B thdd + D thd - tau_e(phi) = tau, with dry friction
F and a torque that is reported d late, is multiplied by a modulating function psi that vanishes with its derivatives at
both ends of a window (Prop. 1):

    <tau, psi> = B <theta, psi''> - D <theta, psi'> + F <sign(thd), psi> + G <sat(thd / v_s), psi> + d <tau, psi'>
                 - sum_p a_p <f_p(phi), psi>

with f_p = s (phi/s)^p / p, f_0 = s, so that sigma(phi) = sum_p a_p (phi/s)^(p-1), with a_p [N m/rad] in units of
stiffness at the deflection scale s. Powers are odd, p = 1, 3, ..; a spring law that is not odd (springs pretensioned
against each other) also needs 0, 2, 4, .. The delay also enters to second order, with the present estimate of d: the
right side is less by d^2 <tau, psi''> / 2.

The equation of the link, (3) without external torque, in the same form

    0 = M <q, psi''> - Dq <q, psi'> + Fq <sign(qd), psi> + Gq <sat(qd / v_s), psi> + c <sin q, psi> + e <cos q, psi>
        + sum_i sum_p a_p,i <f_p(phi_i), psi>

has no measured torque and thus far less noise: that of the link's encoder, M n through psi''. On qbmove_a it amounts to
.00012 N m, that of the motor equation to .0042 N m, while the springs exert about .02 N m. But it is homogeneous: it
determines the springs up to a factor. The motor equations determine that factor over the log, for both springs
together. M, Dq, Fq, Gq, c and e are unknowns with priors as wide as their size, so that a payload, friction and
contacts that are linear in these terms belong to the model; the Fisher information hardly depends on these priors (ADR
14). Any other force is a failure of the equation (`interacting_models`): while it acts, the motor equations alone
count. Noise beyond that of the encoder counts as a force that lasts for SLOW_FORCE.

Departures from the document, each with a measured benefit (estimation.md): the equation is not differentiated first; B,
D, F and d are unknowns; the basis is odd; psi is w_55 by default instead of w_33; the solver lets the spring law change
in time (`interacting_models`). sat is linear within -1..1 and constant beyond: friction that builds up (presliding) or
falls (Stribeck) with speed is a sum of F and G. Without G it would be taken for damping.

There are equations at two times per window length. Neighbours then share so little of psi that their noise is
independent (its correlation is .04), and still they use 91 % of the information in all samples. An equation holds in
the middle of its window, half a window ago: up to the present sample the estimate is continued with its trend, and its
standard deviation grows by what the spring may have changed since.

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

from via_estimators import interacting_models, torque_bank, torque_equation, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.interacting_models import Bank
from via_estimators.slots import row_of, slots
from via_estimators.spring_series import MOST_TERMS, terms_for
from via_estimators.torque_bank import KEPT, ROWS_PER_WINDOW
from via_estimators.torque_equation import LINK, PHI, QUANTUM, TAU, THETA, P, U
from via_estimators.transmissions import JOINT
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
SLOWEST = 0.005  # [largest deflections / s] slower motion does not excite
SHORTEST, FEWEST, MOST = 0.1, 20, 400  # [s], and in intervals: windows from a device file
EXACTNESS = 1e-4  # [-] least noise of the link's torques, over the torque at the stop
ENERGY = 1.98, 3010.0  # c_0 and c_2 of w_55
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
    row, slope, spare, work, joint = (
        np.empty(n),
        np.empty(n),
        np.empty(n),
        interacting_models.scratch(n),
        np.empty(JOINT.size),
    )
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
            torque_bank.unroll(times.reshape(1, length), window.oldest_of(slot, length), stamps)
            window.weigh(int(par[P.modulating_order]), stamps[0], length - 1, psi, held)
            window.hold_slope(stamps[0], length - 1, psi[0], late)
            torque_bank.learn(
                par, stamps[0], psi, held, late, ring, slot, own, parts, bank, directions, row, spare, work
            )
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
