"""The default stiffness estimator: the modulated torque equation of each motor, whose spring may change.

Source: SAPHARI deliverable, Sections 2-4. The motor equation (5), B thdd + D thd - tau_e(phi) = tau, with dry friction
F and a torque that is reported d late, is multiplied by a modulating function psi that vanishes with its derivatives at
both ends of a window (Prop. 1):

    <tau, psi> = B <theta, psi''> - D <theta, psi'> + F <sign(thd), psi> + G <sat(thd / v_s), psi>
                 + sum_l F_l <z_l, psi> + g <phi, psi'> + d <tau, psi'> - sum_p a_p <f_p(phi), psi>
                 + m <|tau_e(phi)| z_1, psi> - <hysteresis, psi> - <creep, psi> - <play, psi> + x F <u y, psi>

with f_p = s (phi/s)^p / p, f_0 = s, so that sigma(phi) = sum_p a_p (phi/s)^(p-1), with a_p [N m/rad] in units of
stiffness at the deflection scale s. Powers are odd, p = 1, 3, ..; a spring law that is not odd (springs pretensioned
against each other) also needs 0, 2, 4, .. In a serial joint motor 2 sets the stiffness of the spring: each a_p is a sum
a_p + b_p theta_2, as the lever mechanisms have it. With a_p alone a preset that swings would be a spring that changes
all the time, and a third of the estimates were wrong.

The delay also enters to second order, with the present estimate of d: the right side is less by
(1/2 - s) d^2 <tau, psi''>. The unknown s is 0 for a pure delay and 1/2 for the low-pass filter of a drive.

Departures from the document, each with a measured benefit (estimation.md): the equation is not differentiated first; B,
D, F, d and the damping g of the transmission, that of its damper or of the material of its spring, are unknowns; the
basis is odd, with a constant for the zeros of torque and encoders; psi is w_55 by default instead of w_33; the solver
lets the spring law change in time (`interacting_models`). sat is linear within -1..1 and constant beyond: friction that
falls with speed (Stribeck) is a sum of F and G. Without G it would be taken for damping. Without g, a damped spring has
the stiffness that its torque shows in phase with the motor. Without the constant, half an encoder step of offset gave a
stiff spring's torque to the friction inside it. Friction that builds up with travel (presliding) is a sum of F and F_l:
z_l is an elastic element that yields, dz_l = dtheta / l within -1..1, with l = 2 and 20 mrad (a Prandtl-Ishlinskii
model). With F alone each reversal adds an error in the direction of the spring.

There are two equations per window length. Neighbours then share so little of psi that their noise is independent (its
correlation is .04), and still they use 91 % of the information in all samples. An equation holds in the middle of its
window, half a window ago: up to the present sample the estimate is continued with its trend, and its standard deviation
grows by what the spring may have changed since.

The friction of a gear grows with the torque it transmits: m |tau_e| in the direction of motion. It is as large as a
softer spring, and in phase with it where the motor drives. tau_e is the spring law found so far: the deflection is free
of a torque's noise, delay and inertia, and a wrong scale of the spring only changes m. Hysteresis, creep and play of
the transmission are three more unknowns (`torque_equation`). With F_l and g, these four have no effect on many joints,
and unknowns cost accuracy. So what is reported allows for the models without them (`nested`). In it, friction and
relaxation are not negative (`passive`): the controller that holds a motor resembles negative friction without a spring.

Samples need not be equidistant: weights follow the stamps. A constant added to q and theta has no effect.

If the torque's scale changes, every term but the delay is multiplied by 1 + c, with c = 0 at first; a constant scale is
shown by no motion. Standard deviations include its declared uncertainty, noise, changes of the spring, effects that the
equation lacks (`interacting_models`), and the truncation of the basis: the last term estimates the size of the first
one left out. So give the basis one term more than needed, or set `truncation` to 0 if it is exact.

Where a motor sticks (u = 1; it is 0 where the motor moves), dry friction has any value within -F..F. It is noise, and
in part what holds the motor against the spring: proportional to the deflection, y = phi over the largest one visited,
with an unknown x of about 1. That part returns with the motion and does not average out, so a motor that always sticks
shows its stiffness only to F over the amplitude of the deflection. Nor does the noise: the equations within the memory
contain no more than n - 1 independent ones. Taken for independent, it left errors of 40 % with an sd of 25 %.

Effort convention: the effort in a sample stamped t_n is the torque that acted over the interval ENDING at t_n,
(t_(n-1), t_n], as a simulator or drive reports what it has just applied. A torque command is constant over exactly such
an interval (zero-order hold), so <tau, psi> = sum tau_n (t_n - t_(n-1)) (psi_n + psi_(n-1))/2. Treating it as a sampled
curve would delay the torque by half a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, isfinite, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import (
    gaussians,
    interacting_models,
    mechanical_stop,
    nested,
    passive,
    torque_equation,
    transmissions,
    window,
)  # fmt: skip
from via_estimators.contract import Estimator, Kernel, Parameters, expect
from via_estimators.mechanical_stop import STOP
from via_estimators.modulated_priors import DEFAULTS, ModulatedTorqueParameters, loss_of, window_for
from via_estimators.slots import row_of, slots
from via_estimators.spring_series import MOST_TERMS, terms_for
from via_estimators.torque_equation import COLUMNS, LAG, PHI, PRESET, QUANTUM, TAU, THETA, P, U
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
ROWS_PER_WINDOW = 2  # equations per window length: the noise of neighbours then has a correlation of .04
SLOWEST = 0.005  # [largest deflections / s] slower motion does not excite
EFFECTS = (U.long, U.short, U.loss, U.lag, U.gear, U.hysteresis, U.creep, U.play)  # that may be absent
# Not negative, since friction and relaxation dissipate energy. Constant dry friction may be, where a drive compensates
# too much of it, and so may both dampings, which a link angle of another time turns into each other.
PASSIVE = (U.short, U.long, U.gear, U.hysteresis, U.creep)
WORN = np.zeros(U.size + 3 * MOST_TERMS + 1)  # change without the spring: all friction of the motor
WORN[U.damping : U.long + 1] = 1.0
ABSENT = nested.odds_of(len(EFFECTS))
WOBBLE = 0.08  # [windows] variance of <w, psi> of a random walk w of rate 1 that is 0 in the middle of the window
# Of each transmission, before its equation: range of the deflection in the last window [rad], 1 if it was informative,
# factor of the covariance, less 1 (`interacting_models.returning`, `passive.restrict`), windows that stuck.
KEPT = slots("moved", "moving", "wider", "stuck", after=STOP)
ROW = slots("since")  # of the joint: samples since the last equation


@dataclass(frozen=True)
class ModulatedTorque(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    parameters: ModulatedTorqueParameters = DEFAULTS

    @classmethod
    def from_device(cls, device: Device) -> ModulatedTorque:
        """Scales and priors of the order of magnitude that the device file states."""
        known = transmissions.priors_of(device) | transmissions.known_of(device) | transmissions.torques_of(device)
        window, quantum = window_for(known, device), QUANTUM * known["position_noise"]
        shortest = min(spring.max_deflection for spring in device.springs)
        slowest = SLOWEST * shortest * window / device.sensors.rate
        known |= {"window": window, "minimum_motion": max(slowest, 3.0 * quantum)}  # rounding alone reaches 2 steps
        known |= loss_of(device, known["stiffness_prior"])
        known |= {"creep_deviation": 0.5 * known["stiffness_prior"], "play_deviation": known["stiffness_prior"]}
        known |= {"torque_scale_deviation": device.tolerances.torque_scale}
        if device.tolerances.torque_timing > 0.0:
            known["delay_deviation"] = device.tolerances.torque_timing
        order, even = terms_for(device.springs)
        known |= {"preset_terms": order if device.arrangement == "serial" else 0}
        return cls(ModulatedTorqueParameters(**known, order=order, even_terms=even))

    def with_parameters(self, parameters: Parameters) -> ModulatedTorque:
        return replace(self, parameters=expect(parameters, ModulatedTorqueParameters))

    @property
    def models_torque_errors(self) -> bool:
        return True

    @property
    def skips_stops(self) -> bool:
        return True

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        preset = ("theta_2",) if self.parameters.preset_terms > 0 else ()
        return (*transmissions.inputs_of(self.parameters.transmissions), *preset)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @property
    def _unknowns(self) -> int:
        """Number of unknowns: those of the motor and the coefficients of the spring law."""
        own = self.parameters
        return U.size + own.order + own.even_terms + own.preset_terms + 1

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; writable, since a locked array compiles again."""
        own, n = self.parameters, self._unknowns
        mean, width = np.zeros(n), np.full(n, own.stiffness_deviation)
        mean[[U.inertia, U.damping, U.friction, U.loss, U.size]] = (
            own.inertia_prior, own.damping_prior, own.friction_prior, own.loss_prior, own.stiffness_prior,
        )  # fmt: skip
        width[n - 1] = 1.0
        if own.even_terms > 0:
            width[U.size + own.order] = own.constant_deviation / own.deflection_scale
        shared = own.friction_deviation / sqrt(3.0)  # by the frictions that do not depend on speed
        width[: U.size] = (
            own.inertia_deviation, own.damping_deviation, shared, own.friction_deviation, shared, shared, 1.0,
            own.loss_deviation, own.delay_deviation, LAG, 1.0, own.gear_deviation, own.friction_deviation,
            own.creep_deviation, own.play_deviation,
        )  # fmt: skip
        return np.concatenate([row_of(P, own, length=own.window + 1), mean, width])

    def init(self) -> Array:
        own = self.parameters
        m, n, length, k = own.transmissions, self._unknowns, own.window + 1, len(self.outputs)
        state = np.zeros(HEADER.size + 2 * k + ROW.size + length * (1 + COLUMNS * m) + m * _part_size(n))
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(own, "inertia", "damping")
        for part in _parts(state, m, n):
            interacting_models.start(_equation(part, n), n, U.scale, own.steadiness)
            for mixed, start in zip(
                _reported(part, n), interacting_models.estimate_of(_equation(part, n), n), strict=True
            ):
                mixed[:] = start
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        n = self._unknowns
        parts = _parts(state, self.parameters.transmissions, n)
        return sqrt(max(interacting_models.condition(_equation(part, n), n, U.scale) for part in parts))

    def fault(self, state: Array) -> str:
        """Whether a mechanical stop holds a motor."""
        parts = _parts(state, self.parameters.transmissions, self._unknowns)
        return next((text for i, part in enumerate(parts) if (text := mechanical_stop.fault(part, 1 + i))), "")

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy")
def _part_size(n: int) -> int:
    """Numbers in the state of one transmission."""
    return KEPT.size + n + n * n + interacting_models.size(n)


@njit(cache=True, error_model="numpy")
def _parts(state: Array, m: int, n: int) -> Array:
    """The view (m, ..) of each transmission's KEPT and equation, at the end of the state."""
    each = _part_size(n)
    return state[state.size - m * each :].reshape(m, each)


@njit(cache=True, error_model="numpy", inline="always")
def _reported(part: Array, n: int) -> tuple[Array, Array]:
    """The views mean (n,) and covariance (n, n) of the estimate that allows for absent effects."""
    return part[KEPT.size : KEPT.size + n], part[KEPT.size + n : KEPT.size + n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy", inline="always")
def _equation(part: Array, n: int) -> Array:
    """The view of the state of `interacting_models`."""
    return part[KEPT.size + n + n * n :]


@njit(cache=True, error_model="numpy")
def _learn(
    par: Array, times: Array, psi: Array, held: Array, late: Array, own: Array, part: Array, row: Array,
    direction: Array, work: Array,
) -> None:  # fmt: skip
    """Add the equation of the present window, and its middle part to the deflections visited, which include 0."""
    n, length, noise, dry = row.size, times.size, par[P.torque_noise], slice(U.friction, U.long + 1)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    kept, equation = part[: KEPT.size], _equation(part, n)
    x, covariance = interacting_models.estimate_of(equation, n)
    span = times[length - 1] - times[0]
    y, unknown = torque_equation.fill_row(par, psi, held, late, own, span, width[U.delay] * x[U.delay], row)
    row[U.gear] = torque_equation.gear(par, mean, width, x, psi[0], own)
    middle = own[PHI, length // 2]
    preset = own[PRESET, length // 2]
    stiffness = torque_equation.stiffness(par, mean, width, x, middle, preset, direction)[0]
    inertia, damping, friction = mean[:3] + width[:3] * x[:3]
    within, angles = torque_equation.of_noise(psi, held, stiffness, inertia, damping)
    for j in range(U.slow, U.long + 1):
        friction += mean[j] + width[j] * x[j]
    any_friction = friction**2 + gaussians.quadratic(covariance[dry, dry], width[dry])
    furthest = max(-kept[VISITED.low], kept[VISITED.high], abs(middle))
    row[U.stuck] *= sqrt(any_friction) / furthest if furthest > 0.0 else 0.0
    elapsed = interacting_models.elapsed(equation, times[length // 2])
    kept[KEPT.stuck] = kept[KEPT.stuck] * exp(-elapsed / par[P.memory]) + unknown
    returning = max(kept[KEPT.stuck] / (n - 1.0), 1.0)
    beside = par[P.position_noise] ** 2 * angles + returning * unknown**2 * any_friction
    scale, constant = torque_equation.rescale(mean, width, x, row)
    y, beside = y + constant, scale * scale * beside
    pull = y
    for j in range(n):
        y -= row[j] * mean[j]
        row[j] *= width[j] / noise
        direction[j] = mean[j] / width[j] + x[j] if U.creep <= j < n - 1 else 0.0
    y, beside = y / noise, beside / noise**2
    surprise, doubt, jump = interacting_models.innovation_of(equation, n, row, y, elapsed, direction, within)
    momentum, doubt = inertia * window.span_of(own[THETA]) / span, noise**2 * (doubt + beside)
    if mechanical_stop.holds(
        kept, own[THETA], psi[0], span, elapsed, par[P.memory], momentum, pull, noise * surprise, doubt,
        noise**2 * jump,
    ):  # fmt: skip
        kept[KEPT.moving] = 0.0
        return
    interacting_models.take(
        equation, n, times[length // 2], par[P.memory], par[P.steadiness], direction, U.creep, WORN[:n], U.scale, row,
        y, within, beside, WOBBLE * span, work,
    )  # fmt: skip
    reported, uncertain = _reported(part, n)
    reported[:], uncertain[:, :] = x, covariance
    least = np.full(n, -np.inf)
    for j in PASSIVE:
        least[j] = -mean[j] / width[j]
    beyond = passive.restrict(reported, uncertain, least)
    for j in EFFECTS:
        nested.allow(reported, uncertain, j, -mean[j] / width[j], ABSENT)
    kept[KEPT.wider] = (1.0 + interacting_models.returning(equation, n)) * beyond - 1.0
    quarter = length // (2 * ROWS_PER_WINDOW)
    for k in range(quarter, length - quarter):
        transmissions.visit(kept, own[PHI, k] if par[P.even_terms] > 1.0 else abs(own[PHI, k]))
    kept[VISITED.high] = max(kept[VISITED.high], 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def _report(
    par: Array, now: float, phi: float, preset: float, part: Array, i: int, value: Array, sd: Array, joint: Array,
    slope: Array,
) -> bool:  # fmt: skip
    """Write the outputs of transmission i and add it to the joint; returns whether it is still warming up."""
    n, m = slope.size, int(par[P.transmissions])
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    kept, equation = part[: KEPT.size], _equation(part, n)
    x, covariance = _reported(part, n)
    warming = equation[interacting_models.HEAD.taken] <= ROWS_PER_WINDOW
    stiffness, bend = torque_equation.stiffness(par, mean, width, x, phi, preset, slope)
    wider = 1.0 + kept[KEPT.wider]
    factor = par[P.torque_scale_deviation] ** 2
    if not warming:
        age = max(now - equation[interacting_models.HEAD.time], 0.0)
        factor += interacting_models.wander(equation, age)
        slope[n - 1] = age * stiffness
        stiffness += slope[n - 1] * x[n - 1]
    uncertain = (
        wider * gaussians.quadratic(covariance, slope)
        + factor * stiffness**2
        + torque_equation.truncation(par, mean, width, kept, x, covariance, preset)
        + torque_equation.coarseness(width, x, covariance, phi)
        + 2.0 * (bend * par[P.position_noise]) ** 2  # the deflection of this very sample is noisy
    )
    learning = warming or kept[KEPT.moving] > 0.0
    transmissions.update(value, sd, 1 + i, stiffness, sqrt(uncertain), learning)
    for at, j in ((1 + m + i, U.inertia), (1 + 2 * m + i, U.damping)):
        found = mean[j] + width[j] * x[j]
        doubt = wider * width[j] ** 2 * covariance[j, j] + (par[P.torque_scale_deviation] * found) ** 2
        transmissions.update(value, sd, at, found, sqrt(doubt), learning)
    # A change, an effect missing in the equation or a wrong torque constant may have one cause in all transmissions.
    disturbed, of_scale = equation[interacting_models.HEAD.disturbed], par[P.torque_scale_deviation] * stiffness
    common = sqrt(disturbed * sd[1 + i] ** 2 + (1.0 - disturbed) * of_scale**2)
    transmissions.add(joint, stiffness, sd[1 + i], bend, par[P.position_noise] ** 2, common)
    return warming


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, even = int(par[P.length]), int(par[P.transmissions]), int(par[P.even_terms])
    varied = int(par[P.preset_terms])
    n, outputs = U.size + int(par[P.order]) + even + varied + 1, 1 + 3 * m
    value, sd = window.outputs(state, outputs)
    schedule = state[HEADER.size + 2 * outputs : HEADER.size + 2 * outputs + ROW.size]
    times, columns = window.rings(state, HEADER.size + 2 * outputs + ROW.size, length, COLUMNS * m)
    ring, parts = columns.reshape(m, COLUMNS, length), _parts(state, m, n)
    psi, held, late = np.empty((3, length)), np.empty(length), np.empty(length)
    stamps, own = np.empty((1, length)), np.empty((COLUMNS, length))
    regressors, slope, work, joint = np.empty(n), np.empty(n), interacting_models.scratch(n), np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        row, furthest = rows[k, : 2 + 2 * m], FURTHEST * par[P.deflection_scale]
        entered = transmissions.enter(state, times, row, 2, furthest, par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot = int(state[HEADER.slot])
        for i in range(m):
            ring[i, THETA, slot], ring[i, TAU, slot] = rows[k, 2 + 2 * i], rows[k, 3 + 2 * i]
            ring[i, PHI, slot] = rows[k, 1] - rows[k, 2 + 2 * i]
            before = slot - 1 if slot > 0 else length - 1
            if varied > 0:  # where it is not measured, it stays
                ring[i, PRESET, slot] = rows[k, 4] if isfinite(rows[k, 4]) else ring[i, PRESET, before]
            torque_equation.slide(ring[i], before if entered == window.TAKEN else -1, slot, times[slot] - times[before])
        full = state[HEADER.filled] == length
        schedule[ROW.since] = schedule[ROW.since] + 1.0 if full else length
        due = full and schedule[ROW.since] * ROWS_PER_WINDOW >= length - 1
        transmissions.begin(joint)
        if due:
            schedule[ROW.since] = 0.0
            window.unroll(times.reshape(1, length), window.oldest_of(slot, length), stamps)
            window.weigh(int(par[P.modulating_order]), stamps[0], length - 1, psi, held)
            window.hold_slope(stamps[0], length - 1, psi[0], late)
        for i in range(m):
            part = parts[i]
            kept = part[: KEPT.size]
            if due:
                window.unroll(ring[i], window.oldest_of(slot, length), own)
                moved = window.span_of(own[PHI])
                mechanical_stop.reach(kept, own[THETA])
                kept[KEPT.moved], kept[KEPT.moving] = moved, 1.0 if moved >= par[P.minimum_motion] else 0.0
                if kept[KEPT.moving] > 0.0:
                    _learn(par, stamps[0], psi, held, late, own, part, regressors, slope, work)
            elif not full:
                kept[KEPT.moved] = kept[KEPT.moving] = 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], kept[KEPT.moved])
            phi = ring[i, PHI, slot]
            warming = _report(par, rows[k, 0], phi, ring[i, PRESET, slot], part, i, value, sd, joint, slope)
            reached = phi if even > 1 else abs(phi)
            inside = transmissions.inside(kept, reached, par[P.range_margin])
            transmissions.grade(joint, warming, kept[KEPT.moving] > 0.0, inside)
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
