"""Stiffness from the spring torque that an unknown-input observer reconstructs at the motor, without torque sensors.

Source: M. Trumic, G. Grioli, K. Jovanovic, A. Fagiolini, Force/Torque-Sensorless Joint Stiffness Estimation in
Articulated Soft Robots, IEEE Robotics and Automation Letters 7(3), 2022, after its published description; the printed
equations were not at hand. Theirs are the two stages: the torque w of the spring is the unknown input of the motor's
linear dynamics with known inertia B and damping D, and a delayed observer reconstructs it with its rate from motor
angle and torque in finitely many steps; recursive least squares then fit the flexibility torque as a function of the
deflection, whose slope is the stiffness.

The observer, with its equations, is `deadbeat_observer`. The model's order is four, so four samples determine angle,
velocity, w and its rate v whatever the initial error.

Departures:
  - a window has many more samples than four, so w and v are weighted means of the true torque. The basis functions of
    the spring law pass the same observer, as if each drove the motor, so a curved torque is no error of the model;
  - w and v give one equation each. Their noise is that of encoders and torques in the observer, times a level that
    follows from the innovations;
  - dry friction F of the motor, an unknown of the same equations, acts against the motion. A window in which the motor
    may reverse gives no equation. For the share u of a window, the longest time in which the angle does not advance by
    an encoder step, the motor may stick; then friction is unknown within -F..F, which is noise (`_sticking`);
  - friction inside the spring is a sum of H_l z_l, dz_l = dphi / l within -1..1, l of TRAVELS, which approximate every
    course between them as in `modulated_torque`. The z_l pass the observer as further functions. Without them and
    with hysteresis of 5 % of the torque, the stiffness was 2 to 6 % wrong with 43 to 95 % coverage, now .6 to 3 %
    with 83 to 100 %, but 19 % for one of two motions of a series elastic joint;
  - the torque may be late by d: measured, tau is tau - d tau', so w gains d tau'. d is an unknown of the equation of w.
    d^2 tau'' in it and d tau'' in that of v are noise, tau'' from two windows. Behind a filter of 10 ms, the stiffness
    of cubic_demo, qbmove_a and a series elastic joint was 2 to 35 % wrong with 8 to 100 % coverage, now .1 to .3 %;
  - least squares forget with `memory` while there is motion; what is forgotten is replaced by the prior, so that no
    direction is without information;
  - standard deviations include the tolerances of B and D, by the sensitivity of the solution.

Standard deviations also include the truncation of the basis and the declared uncertainty of the torque's scale, as in
`modulated_torque`. Not included: drift of the spring law within the memory, correlated encoder noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.plausibility import TRAVELS
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import deadbeat_observer as observer
from via_estimators import qr, transmissions, window
from via_estimators.basis import BASES, LEGENDRE, MOST_TERMS, POWERS, fill_basis, swing_of_last
from via_estimators.contract import Estimator, Kernel, Parameters, expect
from via_estimators.deadbeat_observer import NOW, OVER_MEAN, OVER_SLOPE, OWN, STEPS
from via_estimators.observer_parameters import DEFAULTS, UnknownInputObserverParameters
from via_estimators.slots import slots
from via_estimators.spring_series import terms_for
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
SPAN = 0.1  # [s] of a window: encoder noise is then below torque noise, and a motor seldom reverses within
CLEAR = 2.0  # [encoder steps] that a motor must turn in either half of a window, and may turn back
EDGE = 36.0  # square of the slope over a window, times its span, that a short step of mean 1 at one of its ends has
NOISE_MEMORY = 10.0  # [s] over which the noise levels are averaged
KNOWN = 10.0  # equations that the declared noise counts for
# Followed by the means (n,) and the standard deviations (n,) of the prior: spring law, then friction.
P = slots(
    "length", "transmissions", "basis", "terms", "memory", "max_gap", "deflection_scale", "torque_noise",
    "position_noise", "minimum_motion", "range_margin", "inertia", "damping", "inertia_tolerance", "damping_tolerance",
    "truncation",
)  # fmt: skip
# Of a transmission: whether the last window was informative and its range [rad]; equations taken; end of the last
# window used [s]; weight, and squares of the innovations over their variances, of w and of v; angle that is one encoder
# step ahead of the one before [rad], its time in the present window and the longest time up to it [s].
# States z of the frictions inside the spring, deflection there [rad]; slope of the torque in the window before [N m/s].
KEPT = slots(
    "moving", "moved", "taken", "time", "weight", "power_w", "power_v", "mark", "marked", "longest", "short", "long",
    "bent", "slope", after=VISITED,
)  # fmt: skip
RUBBING = 2  # frictions inside the spring
AFTER = RUBBING + 2  # unknowns after the coefficients of the spring law: those frictions, of the motor, delay


@dataclass(frozen=True)
class UnknownInputObserver(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides, inertia and damping given."""

    parameters: UnknownInputObserverParameters = DEFAULTS

    @classmethod
    def from_device(cls, device: Device) -> UnknownInputObserver:
        """Motor with its tolerances, scales and priors from a device file."""
        priors, torques = transmissions.priors_of(device), transmissions.torques_of(device)
        known, tolerances = transmissions.known_of(device), device.tolerances
        order, even = terms_for(device.springs)
        if tolerances.torque_timing > 0.0:
            known |= {"delay_deviation": tolerances.torque_timing}
        return cls(
            UnknownInputObserverParameters(
                **known,
                window=max(round(SPAN * device.sensors.rate), 4 * STEPS),
                basis="powers" if even > 1 else "odd_powers",
                terms=min(order + even, MOST_TERMS),
                stiffness_prior=priors["stiffness_prior"],
                stiffness_deviation=priors["stiffness_deviation"],
                friction_prior=torques["friction_prior"],
                friction_deviation=torques["friction_deviation"],
                hysteresis_deviation=torques["friction_deviation"],
                **transmissions.given_motors_of(device, tolerances.motor_inertia, tolerances.motor_friction),
            )
        )

    def with_parameters(self, parameters: Parameters) -> UnknownInputObserver:
        return replace(self, parameters=expect(parameters, UnknownInputObserverParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions)

    @cached_property
    def _constants(self) -> Array:
        """Parameter rows (m, ..) of the kernel; writable, since a locked array compiles again."""
        own = self.parameters
        n = own.terms + AFTER
        mean, width = np.zeros(n), np.full(n, own.stiffness_deviation)
        mean[0], mean[n - 2] = own.stiffness_prior, own.friction_prior
        width[own.terms :] = *[own.hysteresis_deviation] * RUBBING, own.friction_deviation, own.delay_deviation
        rows = transmissions.of_each_motor(P, own, length=own.window + 1, basis=BASES[own.basis])
        return np.stack([np.concatenate([row, mean, width]) for row in rows])

    def init(self) -> Array:
        own, k = self.parameters, len(self.outputs)
        each = _part_size(own.terms)
        state = np.zeros(HEADER.size + 2 * k + own.window + 1 + own.transmissions * each)
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(own)
        for part in self._parts(state):
            part[[KEPT.weight, KEPT.power_w, KEPT.power_v]] = KNOWN
            np.fill_diagonal(_views(part, own.terms)[2], 1.0)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        n = self.parameters.terms + AFTER
        return float(max(np.linalg.cond(_views(part, n - AFTER)[2][:, :n]) for part in self._parts(state)))

    def _parts(self, state: Array) -> Array:
        """The view (m, ..) of the transmissions."""
        m = self.parameters.transmissions
        return state[len(state) - m * _part_size(self.parameters.terms) :].reshape(m, -1)

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy")
def _part_size(terms: int) -> int:
    """Numbers in the state of one transmission."""
    n = terms + AFTER
    return KEPT.size + observer.size(terms + RUBBING) + n * (n + 2) + n


@njit(cache=True, error_model="numpy")
def _views(part: Array, terms: int) -> tuple[Array, Array, Array, Array]:
    """KEPT, observer, information [R | sensitivities to B and D] (n, n + 2), right side (n,)."""
    n, information = terms + AFTER, KEPT.size + observer.size(terms + RUBBING)
    right = information + n * (n + 2)
    return (
        part[: KEPT.size],
        part[KEPT.size : information],
        part[information:right].reshape(n, n + 2),
        part[right : right + n],
    )


@njit(cache=True, error_model="numpy")
def _direction(par: Array, now: Array) -> float:
    """1 or -1 where the motor has turned that way in both halves of the window without turning back, else 0."""
    least = CLEAR * sqrt(12.0) * par[P.position_noise]
    first, second = now[NOW.middle] - now[NOW.first], now[NOW.last] - now[NOW.middle]
    back = now[NOW.highest] - now[NOW.lowest] - abs(first + second)
    if back > least or min(abs(first), abs(second)) <= least or first * second <= 0.0:
        return 0.0
    return 1.0 if first > 0.0 else -1.0


@njit(cache=True, error_model="numpy", forceinline=True)
def _follow(kept: Array, now: Array, quantum: float) -> None:
    """Note the longest time in which the motor did not advance by an encoder step `quantum` [rad]."""
    if now[NOW.count] == 1.0:
        kept[KEPT.mark], kept[KEPT.marked], kept[KEPT.longest] = now[NOW.last], 0.0, 0.0
    kept[KEPT.longest] = max(kept[KEPT.longest], now[NOW.age] - kept[KEPT.marked])
    if abs(now[NOW.last] - kept[KEPT.mark]) > 0.5 * quantum:
        kept[KEPT.mark], kept[KEPT.marked] = now[NOW.last], now[NOW.age]


@njit(cache=True, error_model="numpy")
def _square(par: Array, part: Array, j: int, x: Array) -> float:
    """Mean square of unknown j; x (n,) is overwritten."""
    _, _, information, right = _views(part, int(par[P.terms]))
    n = right.size
    mean, width = par[P.size + j], par[P.size + n + j]
    qr.solve_triangular(information[:, :n], right, x)
    square = (mean + width * x[j]) ** 2
    x[:] = 0.0
    x[j] = width
    qr.solve_transposed(information[:, :n], x, x)
    for k in range(n):
        square += x[k] * x[k]
    return square


@njit(cache=True, error_model="numpy")
def _forget(kept: Array, information: Array, right: Array, time: float, memory: float, row: Array) -> None:
    """Give older equations the weight exp(-elapsed / memory), and the prior the rest of the information."""
    n = right.size
    elapsed = max(time - kept[KEPT.time], 0.0) if kept[KEPT.taken] > 0.0 else 0.0
    keep = exp(-elapsed / memory)
    information *= sqrt(keep)
    right *= sqrt(keep)
    if keep < 1.0:
        for j in range(n):
            row[:] = 0.0
            row[j] = sqrt(1.0 - keep)
            qr.rotate_in(information, right, row, 0.0, j)
    calm = exp(-elapsed / NOISE_MEMORY)
    for at in (KEPT.weight, KEPT.power_w, KEPT.power_v):
        kept[at] = KNOWN + calm * (kept[at] - KNOWN)
    kept[KEPT.time] = time


@njit(cache=True, error_model="numpy")
def _learn(par: Array, part: Array, time: float, found: Array, row: Array, x: Array) -> None:
    """Add the two equations of a full window; found (2, signals), row (n + 2,), x (n,) are overwritten."""
    terms = int(par[P.terms])
    kept, observed, information, right = _views(part, terms)
    now, _, _, triangle = observer.views(observed, terms + RUBBING)
    n = terms + AFTER
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    span, count = now[NOW.age], now[NOW.count] - 1.0
    direction = _direction(par, now)
    variances = observer.reconstruct(triangle, 0.5 * span, found)
    bent, kept[KEPT.slope] = (found[1, 1] - kept[KEPT.slope]) / span, found[1, 1]
    if direction == 0.0:
        return
    _forget(kept, information, right, time, par[P.memory], row)
    velocity = (now[NOW.last] - now[NOW.first]) / span
    bend = (found[0, 0] - par[P.damping] * velocity) / par[P.inertia]
    jerk = (found[1, 0] - par[P.damping] * bend) / par[P.inertia]
    kept[KEPT.weight] += 1.0
    sticking = _square(par, part, n - 2, x) * (kept[KEPT.longest] / span) ** 2
    late = _square(par, part, n - 1, x)
    for k in range(2):
        torque = par[P.torque_noise] ** 2 / count * (OVER_MEAN if k == 0 else 12.0 * OVER_SLOPE / span**2)
        power = KEPT.power_w if k == 0 else KEPT.power_v
        noise = variances[k] * par[P.position_noise] ** 2 + torque
        level = kept[power] / (kept[KEPT.weight] - 1.0)
        beside = sticking if k == 0 else sticking * EDGE / span**2
        sd = sqrt(noise * level + beside + late * bent * bent * (late if k == 0 else 1.0))
        y = found[k, 0] - found[k, 1]  # B omega' + D omega - tau = tau_e + sum H z - F sign(omega) + d tau'
        for j in range(n):
            factor = found[k, OWN + j] if j < n - 2 else 0.0
            if k == 0 and j >= n - 2:
                factor = -direction if j == n - 2 else found[1, 1]
            y -= factor * mean[j]
            row[j] = factor * width[j] / sd
        row[n], row[n + 1] = (bend / sd, velocity / sd) if k == 0 else (jerk / sd, bend / sd)
        y /= sd
        qr.solve_transposed(information[:, :n], row[:n], x)
        doubt = 1.0
        for j in range(n):
            doubt += x[j] * x[j]
        qr.solve_triangular(information[:, :n], right, x)
        innovation = y
        for j in range(n):
            innovation -= row[j] * x[j]
        kept[power] += level * (1.0 + noise * level / (sd * sd) * (innovation * innovation / doubt - 1.0))
        qr.rotate_in(information, right, row, y, 0)
    kept[KEPT.taken] += 2.0


@njit(cache=True, error_model="numpy")
def _truncation(par: Array, kept: Array, information: Array, right: Array, x: Array) -> float:
    """Variance of stiffness [(N m/rad)^2] due to the terms left out: the last term of either parity, less its noise."""
    kind, terms = int(par[P.basis]), int(par[P.terms])
    n, total = terms + AFTER, 0.0
    far = max(abs(kept[VISITED.low]), abs(kept[VISITED.high])) / par[P.deflection_scale]
    for back in range(2 if kind in (POWERS, LEGENDRE) and terms > 1 else 1):
        j = terms - 1 - back
        width = par[P.size + n + j]
        qr.solve_triangular(information[:, :n], right, x)
        share = par[P.size + j] + width * x[j]
        x[:] = 0.0
        x[j] = 1.0
        qr.solve_transposed(information[:, :n], x, x)
        variance = 0.0
        for i in range(n):
            variance += (width * x[i]) ** 2
        total += swing_of_last(kind, terms, back, far) ** 2 * max(share * share - 4.0 * variance, 0.0)
    return par[P.truncation] ** 2 * total


@njit(cache=True, error_model="numpy", forceinline=True)
def _report(
    par: Array, part: Array, phi: float, i: int, value: Array, sd: Array, joint: Array, basis: Array, x: Array,
    slope: Array,
) -> None:  # fmt: skip
    """Write the stiffness of transmission i at the deflection phi [rad] and add it to the joint."""
    terms = int(par[P.terms])
    kept, _, information, right = _views(part, terms)
    n, warming = terms + AFTER, kept[KEPT.taken] <= terms + 1.0
    fill_basis(int(par[P.basis]), phi, par[P.deflection_scale], basis[0], basis[1], basis[2])
    qr.solve_triangular(information[:, :n], right, x)
    stiffness = bend = 0.0
    for j in range(terms):
        share, width = par[P.size + j], par[P.size + n + j]
        share += 0.0 if warming else width * x[j]
        stiffness += share * basis[1, j]
        bend += share * basis[2, j]
        slope[j] = width * basis[1, j]
    slope[terms:] = 0.0
    uncertain = 2.0 * (bend * par[P.position_noise]) ** 2 + _truncation(par, kept, information, right, x)
    if warming:
        for j in range(terms):
            uncertain += slope[j] * slope[j]
    else:
        qr.solve_transposed(information[:, :n], slope, x)
        for j in range(n):
            uncertain += x[j] * x[j]
        for k in range(2):
            along = 0.0
            for j in range(n):
                along += x[j] * information[j, n + k]
            uncertain += (along * par[P.inertia_tolerance if k == 0 else P.damping_tolerance]) ** 2
    learning = warming or kept[KEPT.moving] > 0.0
    transmissions.update(value, sd, 1 + i, stiffness, sqrt(uncertain), learning)
    transmissions.add(joint, stiffness, sd[1 + i], bend, par[P.position_noise] ** 2, 0.0)
    joint[JOINT.motion] = min(joint[JOINT.motion], kept[KEPT.moved])
    inside = transmissions.inside(kept, phi, par[P.range_margin])
    transmissions.grade(joint, warming, kept[KEPT.moving] > 0.0, inside)


@njit(cache=True, error_model="numpy")
def _advance(each: Array, state: Array, rows: Array, out: Array) -> int:
    par = each[0]  # that of motor 1; all rows agree but in inertia and damping
    m, terms = int(par[P.transmissions]), int(par[P.terms])
    value, sd = window.outputs(state, 1 + m)
    at = HEADER.size + 2 * value.size
    times, parts = state[at : at + int(par[P.length])], state[at + int(par[P.length]) :].reshape(m, _part_size(terms))
    quantum = sqrt(12.0) * par[P.position_noise]
    joint, basis, found = np.empty(JOINT.size), np.empty((3, terms)), np.empty((2, OWN + terms + RUBBING))
    row, equation, driving = (
        np.empty(STEPS + OWN + terms + RUBBING),
        np.empty(terms + AFTER + 2),
        np.empty(terms + RUBBING),
    )
    x, slope = np.empty(terms + AFTER), np.empty(terms + AFTER)
    for k in range(rows.shape[0]):
        before = state[HEADER.last]
        entered = transmissions.enter(state, times, rows[k], 2, FURTHEST * par[P.deflection_scale], par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        transmissions.begin(joint)
        for i in range(m):
            part, own, theta = parts[i], each[i], rows[k, 2 + 2 * i]
            phi, observed = rows[k, 1] - theta, _views(part, terms)[1]
            fill_basis(int(par[P.basis]), phi, par[P.deflection_scale], basis[0], basis[1], basis[2])
            moved = phi - part[KEPT.bent] if entered == window.TAKEN else 0.0
            part[KEPT.bent], driving[:terms] = phi, basis[0]
            for j in range(RUBBING):
                part[KEPT.short + j] = min(max(part[KEPT.short + j] + moved / TRAVELS[j], -1.0), 1.0)
                driving[terms + j] = part[KEPT.short + j]
            if entered == window.RESTARTED:
                part[KEPT.moving] = part[KEPT.moved] = 0.0
                observer.begin(observed, theta, phi, driving)
                _follow(part, observed, quantum)
            else:
                observer.advance(
                    observed, own[P.inertia], own[P.damping], rows[k, 0] - before, theta, phi, rows[k, 3 + 2 * i],
                    driving, 0.5 * (par[P.length] + 1.0), row,
                )  # fmt: skip
                _follow(part, observed, quantum)
                if observed[NOW.count] >= par[P.length]:
                    part[KEPT.moved] = observed[NOW.high] - observed[NOW.low]
                    part[KEPT.moving] = 1.0 if part[KEPT.moved] >= par[P.minimum_motion] else 0.0
                    if part[KEPT.moving] > 0.0:
                        _learn(own, part, rows[k, 0], found, equation, x)
                        transmissions.visit(part, observed[NOW.low])
                        transmissions.visit(part, observed[NOW.high])
                    observer.begin(observed, theta, phi, driving)
                    _follow(part, observed, quantum)
            _report(own, part, phi, i, value, sd, joint, basis, x, slope)
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
