"""Parts shared by the Kalman filters of the motor equation: parameters, state, correction and report.

Each motor has its own filter of the state of `motor_model`. The measurement is its angle,

    z = theta + e,  S = P_tt + R,  K = P e_t / S,  x <- x + K (z - theta),
    P <- (1 - K e_t') P (1 - e_t K') + K R K'        (Joseph's form: Simon 2006, eq. (5.19); symmetric and positive)

with R the variance of the encoder's rounding. Torque noise, constant over a step, and the noise of q are process noise.
Parameters are random walks, at rates that the user declares: `spring_change` of the spring law's scale, `motor_change`
of inertia, damping and dry friction.

A filter pauses while the joint does not move, since a motor that sticks does not obey the model. Then it restarts with
its parameters, at the measured angle and an unknown velocity. A filter that has diverged (numbers that are not finite
or out of all proportion) starts anew from the prior.

Standard deviations also include the declared uncertainty of the torque's scale and the truncation of the basis, as in
`modulated_torque`. Not included: a delay of the torque, and what the first order (or the sigma points) leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite, sqrt
from typing import ClassVar, Self

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import transmissions, window
from via_estimators.contract import Estimator, Parameters, expect, parameter
from via_estimators.motor_model import INPUT, MODEL, X, add_noise, bend, drift, noise, spring
from via_estimators.slots import row_of, slots
from via_estimators.spring_series import MOST_TERMS, power, tail, terms_for
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
INERTIA_KNOWN = 0.3  # relative standard deviation of a device file's inertia: its inverse is positive
FASTEST = 10.0  # [rad/s] standard deviation of the velocity at the start
LONGEST = 2e-3  # [s] of one time step of the model; longer intervals are divided
LARGEST = 1e15  # no number of a filter in SI units is as large
SURE = 2.0  # standard deviations by which the inverse of inertia, by which the others are divided, must be positive
# Followed by the prior means (n,) and standard deviations (n,) of the state.
P = slots(
    "length", "transmissions", "even_terms", "max_gap", "torque_noise", "position_noise", "minimum_motion",
    "range_margin", "truncation", "spring_change", "motor_change", *MODEL._fields[:-1],
)  # fmt: skip
# Of each transmission, before x and P: steps from which it has learned, 1 while its filter runs.
KEPT = slots("learned", "running", after=VISITED)
ROW = slots("time", "q")  # of the joint: last sample


@dataclass(frozen=True)
class MotorKalmanParameters(Parameters):
    """Parameters of the Kalman filters of the motor equation."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals over which motion is measured", "-", 20, 2000)
    order: int = parameter(3, "odd terms of the spring law", "-", 1, MOST_TERMS)
    even_terms: int = parameter(0, "even terms in addition, the constant first", "-", 0, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over the last term; 0: the basis is exact", "-", 0.0, 10.0)
    spring_change: float = parameter(
        0.003, "relative change of the spring law after 1 s, a random walk", "1/sqrt(s)", 0.0, 10.0
    )
    motor_change: float = parameter(
        0.001, "relative change of inertia and friction after 1 s, a random walk", "1/sqrt(s)", 0.0, 10.0
    )
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.01, "motor inertia before any data", "kg m^2", 1e-9, 1e3)
    inertia_deviation: float = parameter(0.003, "standard deviation of the prior inertia", "kg m^2", 1e-12, 1e3)
    damping_prior: float = parameter(0.1, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(0.1, "standard deviation of the prior damping", "N m s/rad", 1e-12, 1e4)
    friction_prior: float = parameter(0.0, "dry friction of a motor before any data", "N m", 0.0, 1e6)
    friction_deviation: float = parameter(1.0, "standard deviation of the prior dry friction", "N m", 1e-12, 1e6)
    friction_velocity: float = parameter(0.02, "velocity at which dry friction is at 71 %", "rad/s", 1e-6, 1e3)
    constant_deviation: float = parameter(300.0, "standard deviation of the constant before any data", "N m", 1e-9, 1e9)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class MotorKalman(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    kind: ClassVar[type[MotorKalmanParameters]]
    parameters: MotorKalmanParameters

    @classmethod
    def from_device(cls, device: Device) -> Self:
        """Scales and priors of the order of magnitude that the device file states.

        Dry friction is smoothed over the velocity by which it changes a motor's within a sample, or more.
        """
        known = transmissions.priors_of(device) | transmissions.known_of(device) | transmissions.torques_of(device)
        motors = transmissions.driving_motors_of(device)
        slowest = max(motor.coulomb_friction / (motor.inertia * device.sensors.rate) for motor in motors)
        known |= {"friction_velocity": max(cls.kind.friction_velocity, slowest)}
        known |= {"inertia_deviation": INERTIA_KNOWN * known["inertia_prior"]}
        order, even = terms_for(device.springs)
        return cls(cls.kind(**known, order=order, even_terms=even))

    def with_parameters(self, parameters: Parameters) -> Self:
        return replace(self, parameters=expect(parameters, self.kind))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @property
    def size(self) -> int:
        """Number n of states of one filter."""
        return X.size + self.parameters.order + self.parameters.even_terms

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; writable, since a locked array compiles again."""
        own = self.parameters
        mean, width = np.zeros(self.size), np.full(self.size, own.stiffness_deviation)
        mean[[X.inverse_inertia, X.damping, X.friction, X.size]] = (
            1.0, own.damping_prior, own.friction_prior, own.stiffness_prior,
        )  # fmt: skip
        relative = own.inertia_deviation / own.inertia_prior
        if own.even_terms > 0:
            width[X.size + own.order] = own.constant_deviation / own.deflection_scale
        width[: X.size] = own.position_noise, FASTEST, relative, own.damping_deviation, own.friction_deviation
        given = {"length": own.window + 1, "inertia": own.inertia_prior}
        return np.concatenate([row_of(P, own, **given), mean, width])

    def init(self) -> Array:
        own, n, k = self.parameters, self.size, len(self.outputs)
        m, length = own.transmissions, own.window + 1
        state = np.zeros(HEADER.size + 2 * k + ROW.size + length * (1 + m) + m * (KEPT.size + n + n * n))
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(own, "inertia", "damping")
        _, _, _, parts = views(self._constants, state)
        for part in parts:
            start(self._constants, *filter_of(part, n))
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        width, n = self._constants[P.size + self.size :], self.size
        scale = np.outer(width, width)[X.inverse_inertia :, X.inverse_inertia :]
        _, _, _, parts = views(self._constants, state)
        known = [filter_of(part, n)[2][X.inverse_inertia :, X.inverse_inertia :] / scale for part in parts]
        return float(np.sqrt(max(np.linalg.cond(each) for each in known)))


@njit(cache=True, error_model="numpy", forceinline=True)
def views(par: Array, state: Array) -> tuple[Array, Array, Array, Array]:
    """The views of the last sample ROW, times (L,), deflections (m, L), and parts (m, ..) of the transmissions."""
    length, m = int(par[P.length]), int(par[P.transmissions])
    at = HEADER.size + 2 * (1 + 3 * m)
    times, ring = window.rings(state, at + ROW.size, length, m)
    return state[at : at + ROW.size], times, ring, state[at + ROW.size + length * (1 + m) :].reshape(m, -1)


@njit(cache=True, error_model="numpy", forceinline=True)
def filter_of(part: Array, n: int) -> tuple[Array, Array, Array]:
    """The views KEPT, x (n,) and covariance (n, n) of a transmission."""
    at = KEPT.size + n
    return part[: KEPT.size], part[KEPT.size : at], part[at : at + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy")
def start(par: Array, kept: Array, x: Array, covariance: Array) -> None:
    """Overwrite one filter with the prior; what it has learned is forgotten.

    Inertia, damping, friction and spring are independent before any data; divided by inertia they are not.
    """
    n = x.size
    kept[:] = 0.0
    x[:] = par[P.size : P.size + n]
    covariance[:, :] = 0.0
    for j in range(n):
        covariance[j, j] = par[P.size + n + j] ** 2
    relative = covariance[X.inverse_inertia, X.inverse_inertia]
    for j in range(X.inverse_inertia, n):
        for k in range(X.inverse_inertia, n):
            if j != X.inverse_inertia or k != X.inverse_inertia:
                covariance[j, k] += relative * x[j] * x[k]


@njit(cache=True, error_model="numpy")
def restart_motion(par: Array, x: Array, covariance: Array, theta: float) -> None:
    """Set the angle to the measured one [rad] and the velocity to unknown, independent of the parameters."""
    x[X.angle], x[X.velocity] = theta, 0.0
    covariance[: X.inverse_inertia, :] = 0.0
    covariance[:, : X.inverse_inertia] = 0.0
    covariance[X.angle, X.angle], covariance[X.velocity, X.velocity] = par[P.position_noise] ** 2, FASTEST**2


@njit(cache=True, error_model="numpy")
def correct(x: Array, covariance: Array, z: float, R: float, gain: Array) -> None:
    """Update with the measured angle z [rad] of variance R [rad^2]; gain (n,) is overwritten with K."""
    n, S = x.size, covariance[X.angle, X.angle] + R
    if not S > 0.0:
        return
    innovation = z - x[X.angle]
    for j in range(n):
        gain[j] = covariance[j, X.angle] / S
        x[j] += gain[j] * innovation
    for j in range(n - 1, -1, -1):  # the angle's row, the first one, last
        for k in range(n):
            covariance[j, k] -= gain[j] * covariance[X.angle, k]
    for j in range(n):
        of_angle = covariance[j, X.angle]
        for k in range(n):
            covariance[j, k] += (R * gain[j] - of_angle) * gain[k]
    for j in range(n):
        for k in range(j):
            covariance[j, k] = covariance[k, j] = 0.5 * (covariance[j, k] + covariance[k, j])


@njit(cache=True, error_model="numpy")
def converging(x: Array, covariance: Array) -> bool:
    """Whether all numbers of a filter are finite and of a possible size."""
    possible = True
    for j in range(x.size):
        possible = possible and isfinite(x[j]) and abs(x[j]) < LARGEST and 0.0 <= covariance[j, j] < LARGEST**2
    return possible


@njit(cache=True, error_model="numpy", forceinline=True)
def divide(sample: Array, i: int, last: Array, given: Array) -> int:
    """Divide the interval since the last sample ROW into equal time steps; returns their number.

    given  INPUT of the first one for motor i, overwritten
    """
    elapsed = sample[0] - last[ROW.time]
    pieces = max(int(np.ceil(elapsed / LONGEST - 1e-6)), 1)
    given[INPUT.step], given[INPUT.torque] = elapsed / pieces, sample[3 + 2 * i]
    given[INPUT.q], given[INPUT.next_q] = last[ROW.q], last[ROW.q] + (sample[1] - last[ROW.q]) / pieces
    return pieces


@njit(cache=True, error_model="numpy", forceinline=True)
def size_of(par: Array) -> int:
    """Number n of states of one filter."""
    return X.size + int(par[P.order]) + int(par[P.even_terms])


@njit(cache=True, error_model="numpy", forceinline=True)
def enter(par: Array, state: Array, sample: Array, joint: Array, out: Array) -> bool:
    """Whether a sample is used; `joint` (JOINT.size,) is overwritten. One that is not is answered in `out`."""
    times = views(par, state)[1]
    furthest = FURTHEST * par[P.deflection_scale]
    if transmissions.enter(state, times, sample, 2, furthest, par[P.max_gap]) == window.SKIPPED:
        window.answer(state, BAD_SAMPLE, out)
        return False
    transmissions.begin(joint)
    return True


@njit(cache=True, error_model="numpy", forceinline=True)
def begin(par: Array, state: Array, sample: Array, i: int, joint: Array, given: Array) -> tuple[Array, Array, int]:
    """x, covariance and number of time steps for motor i, 0 if its filter pauses; the parameters have walked.

    given  INPUT of the first step, overwritten
    """
    last, times, ring, parts = views(par, state)
    kept, x, covariance = filter_of(parts[i], size_of(par))
    full, theta = state[HEADER.filled] == times.size, sample[2 + 2 * i]
    elapsed = max(sample[0] - last[ROW.time], 0.0) if state[HEADER.samples] > 1.0 else 0.0
    ring[i, int(state[HEADER.slot])] = sample[1] - theta
    moved = window.span_of(ring[i]) if full else 0.0
    joint[JOINT.motion] = min(joint[JOINT.motion], moved)
    moving = full and moved >= par[P.minimum_motion]
    n = x.size
    drift(x, covariance, elapsed, par[P.spring_change], par[P.motor_change], par[P.size + n : P.size + 2 * n])
    pieces = 0
    if moving and kept[KEPT.running] > 0.0:
        pieces = divide(sample, i, last, given)
    else:
        restart_motion(par, x, covariance, theta)
    kept[KEPT.running] = 1.0 if moving else 0.0
    return x, covariance, pieces


@njit(cache=True, error_model="numpy", forceinline=True)
def noise_of(par: Array, x: Array, covariance: Array, given: Array, pieces: int, work: Array) -> float:
    """Variance of the process noise of one of `pieces` time steps; work (4, n) is overwritten for `move_on`."""
    torque_noise = sqrt(pieces) * par[P.torque_noise]
    return float(noise(par[P.order : P.size], x, covariance, given, torque_noise, par[P.position_noise], work))


@njit(cache=True, error_model="numpy", forceinline=True)
def move_on(par: Array, x: Array, covariance: Array, given: Array, variance: float, work: Array) -> None:
    """Add the process noise of a time step, and move `given` (INPUT) to the next one."""
    add_noise(par[P.order : P.size], x, given[INPUT.step], variance, work, covariance)
    moved = given[INPUT.next_q] - given[INPUT.q]
    given[INPUT.q] = given[INPUT.next_q]
    given[INPUT.next_q] += moved


@njit(cache=True, error_model="numpy", forceinline=True)
def end(par: Array, state: Array, sample: Array, i: int, pieces: int, joint: Array, work: Array) -> None:
    """Correct motor i's filter by its measured angle if it moved by `pieces` steps, and report; work is overwritten."""
    _, _, _, parts = views(par, state)
    kept, x, covariance = filter_of(parts[i], size_of(par))
    phi, moving = sample[1] - sample[2 + 2 * i], kept[KEPT.running] > 0.0
    if pieces > 0:
        correct(x, covariance, sample[2 + 2 * i], par[P.position_noise] ** 2, work[0])
        if converging(x, covariance):
            transmissions.visit(kept, phi if par[P.even_terms] > 1.0 else abs(phi))
            kept[KEPT.learned] += 1.0
        else:
            start(par, kept, x, covariance)
    value, sd = window.outputs(state, 1 + 3 * parts.shape[0])
    report(par, kept, x, covariance, phi, i, moving, value, sd, joint, work)


@njit(cache=True, error_model="numpy", forceinline=True)
def finish(par: Array, state: Array, sample: Array, joint: Array, out: Array) -> None:
    """Answer a sample whose motors are all reported."""
    last, _, _, parts = views(par, state)
    last[ROW.time], last[ROW.q] = sample[0], sample[1]
    value, sd = window.outputs(state, 1 + 3 * parts.shape[0])
    transmissions.finish(joint, state, value, sd, out)


@njit(cache=True, error_model="numpy")
def _truncation(par: Array, kept: Array, x: Array, covariance: Array) -> float:
    """Variance of stiffness [(N m/rad)^2] due to the terms left out, of either parity, times (B_0/B)^2."""
    order, even = int(par[P.order]), int(par[P.even_terms])
    if not par[P.truncation] > 0.0:
        return 0.0
    far = max(abs(kept[VISITED.low]), abs(kept[VISITED.high])) / par[P.deflection_scale]
    last = X.size + order - 1
    total = tail(power(order - 1, order) - 1, far, x[last], covariance[last, last])
    if even > 1:
        last += even
        total += tail(power(order + even - 1, order) - 1, far, x[last], covariance[last, last])
    return par[P.truncation] ** 2 * total


@njit(cache=True, error_model="numpy")
def quotient(x: Array, covariance: Array, slope: Array) -> tuple[float, float]:
    """slope' x / x_B, a number of the device, and its variance to first order; slope (n,), 0 at x_B, is overwritten."""
    n, found = x.size, 0.0
    for j in range(n):
        found += slope[j] * x[j]
    found /= x[X.inverse_inertia]
    slope[X.inverse_inertia] = -found
    variance = 0.0
    for j in range(n):
        for k in range(n):
            variance += slope[j] * covariance[j, k] * slope[k]
    return found, max(variance, 0.0) / x[X.inverse_inertia] ** 2


@njit(cache=True, error_model="numpy")
def report(
    par: Array, kept: Array, x: Array, covariance: Array, phi: float, i: int, moving: bool, value: Array, sd: Array,
    joint: Array, work: Array,
) -> None:  # fmt: skip
    """Write the outputs of transmission i at the measured deflection phi [rad], and add it to the joint.

    Before data determine the filter they remain those of the prior.
    """
    m, model = int(par[P.transmissions]), par[P.order : P.size]
    slope, inverse = work[0], x[X.inverse_inertia]
    doubt = sqrt(covariance[X.inverse_inertia, X.inverse_inertia])
    warming = kept[KEPT.learned] < par[P.length] or inverse <= SURE * doubt
    bent = 0.0
    if not warming:
        slope[: X.size] = 0.0
        spring(model, x, phi, work[1], slope[X.size :])
        stiffness, variance = quotient(x, covariance, slope)
        bent = bend(model, x, phi) / inverse
        variance += _truncation(par, kept, x, covariance) / inverse**2
        variance += 2.0 * (bent * par[P.position_noise]) ** 2  # the deflection of this very sample is noisy
        transmissions.update(value, sd, 1 + i, stiffness, sqrt(variance), moving)
        inertia = par[P.inertia] / inverse
        transmissions.update(value, sd, 1 + m + i, inertia, inertia * doubt / inverse, moving)
        slope[:] = 0.0
        slope[X.damping] = 1.0
        damping, variance = quotient(x, covariance, slope)
        transmissions.update(value, sd, 1 + 2 * m + i, damping, sqrt(variance), moving)
    transmissions.add(joint, value[1 + i], sd[1 + i], bent, par[P.position_noise] ** 2, 0.0)
    reached = phi if par[P.even_terms] > 1.0 else abs(phi)
    transmissions.grade(joint, warming, moving, transmissions.inside(kept, reached, par[P.range_margin]))
