"""Damping and stiffness from the link's own motion, for joints without a torque sensor whose motors are servos.

Weak form of the link equation (4) of the SAPHARI deliverable (Section 2) with the spring law scaled by a gain and dry
friction c, one row every quarter of a window:

    -M <q, psi''> - <g(q), psi> = d (-<q, psi'>) + gain <tau_e(q - theta; preset), psi> + c <sign(q'), psi>

The equilibrium theta is the angle of a position servo driven by its command: dead time, speed limit, critically damped
lag (via_core.servos). The logged servo angle of the MACCEPA-VD is correct at rest but wrong by up to 1.6 rad while the
servo slews, so it only initialises the model. The servo's numbers are uncertain: servos around those of the file are
hypotheses, each with its own filter for (d, gain, c), mixed by likelihood (via_estimators.servo_models).

Observability: no torque is measured, so the equation is homogeneous in (M, d, gain, c). Motion determines only their
ratios, r = gain / (M / M_file) among them. The scale s = M / M_file has two sources: the file's inertia and the file's
spring law, each with its tolerance. With log s ~ N(0, inertia_tolerance^2) and log gain ~ N(0, spring_tolerance^2),

    log s | r ~ N(-log r prior / whole, prior (whole - prior) / whole),  whole = prior + spring_tolerance^2 + var(log r)

where prior is the variance of log s. A payload that the file does not state is a second hypothesis of s with a wide
prior, weighted by the likelihood of r. All estimates are multiplied by the geometric mean of s, and its mean square
error is part of every standard deviation: twice the inertia and half the spring cannot be distinguished from motion.
Gravity grows with the inertia, as that of a payload on the link does.

d is viscous; dry friction is an unknown beside it. The rest of the torque is noise of unknown level with a correlation
time (`disturbance_memory`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import exp, log, sin, sqrt

import numpy as np
from numba import njit
from via_core.device_parts import ServoMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.spring_equations import spring_stiffness, spring_torque
from via_core.springs import SpringLaw
from via_core.status import BAD_SAMPLE, NOT_EXCITED, OK, OUTSIDE_RANGE, WARMING_UP

from via_estimators import coloured, servo_models, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.servo_models import MOTION, SERVO
from via_estimators.slots import row_of, slots
from via_estimators.window import HEADER

MODULATING_ORDER = 5
SPAN = 0.1  # [s] of a window: a fifth of a swing of the intended robots
ROWS_PER_WINDOW = 4  # rows overlap, so that no course of a signal falls between them
MARGIN = 1.02  # deflections up to this multiple of the largest one visited count as visited
LEAST_RATIO = 0.05  # of gain to s: motion has shown nothing on the scale then
NEGLIGIBLE = 1e-4  # weight of a servo that adds nothing to the estimate
STICKING = 0.1  # [-] standard deviation of dry friction that the file does not state, over the typical spring torque
STILL = 8  # a direction of motion is that of an eighth of a window
# `typical` is a typical stiffness [N m/rad]. Followed by the coefficients of the spring law.
P = slots(
    "length", "stride", "overlap", "shortness", "bend", "max_gap", "persistence", "torque_noise", "position_noise",
    "inertia", "inertia_tolerance", "spring_tolerance", "payload_probability", "payload_deviation", "gravity_torque",
    "gravity_angle", "minimum_motion", "spring_kind", "typical", "damping_prior", "gain_prior", "friction_prior",
    "damping_deviation", "gain_deviation", "friction_deviation",
)  # fmt: skip
RING = slots(
    "q", "equilibrium", "preset", "gravity"
)  # angle, commands, gravity torque; the torque of each model follows
OWN = slots("reached", "since")  # largest |phi| visited; samples since the last row
OUTPUTS = ("stiffness", "damping", "gain")
UNKNOWNS = 3
DAMPING, GAIN, FRICTION = range(UNKNOWNS)


@dataclass(frozen=True)
class LinkImpedanceParameters(Parameters):
    """Parameters of `LinkImpedance`; the defaults suit a joint like the MACCEPA-VD's."""

    window: int = parameter(22, "sampling intervals per window", "-", 10, 500)
    memory: float = parameter(5.0, "time in which the damping forgets", "s", 0.02, 1e9)
    spring_memory: float = parameter(1000.0, "time in which gain and dry friction forget", "s", 0.02, 1e9)
    servo_memory: float = parameter(20.0, "time in which the likelihood of the servos forgets", "s", 0.1, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    inertia: float = parameter(3.6e-3, "link inertia, the scale of all estimates", "kg m^2", 1e-9, 1e4)
    inertia_tolerance: float = parameter(0.15, "relative standard deviation of that", "-", 0.0, 1.0)
    payload_probability: float = parameter(0.2, "probability of a payload that the file does not state", "-", 0.0, 1.0)
    payload_deviation: float = parameter(0.65, "standard deviation of log inertia with such a payload", "-", 0.0, 2.0)
    spring_tolerance: float = parameter(0.3, "relative standard deviation of the spring law", "-", 1e-3, 1.0)
    gravity_torque: float = parameter(0.0, "gravity torque at the worst angle", "N m", -1e4, 1e4)
    gravity_angle: float = parameter(0.0, "angle at which the link hangs at rest", "rad", -10.0, 10.0)
    servo_bandwidth: float = parameter(25.0, "bandwidth of the position servos", "rad/s", 0.1, 1e4)
    servo_dead_time: float = parameter(0.0, "dead time of the servo", "s", 0.0, 1.0)
    servo_speed_limit: float = parameter(0.0, "speed limit of the servo, 0: unknown", "rad/s", 0.0, 1e4)
    damping_prior: float = parameter(0.02, "damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(0.02, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    gain_deviation: float = parameter(0.7, "standard deviation of the gain before any data", "-", 1e-6, 100.0)
    friction_prior: float = parameter(0.0, "dry friction of the link before any data", "N m", 0.0, 1e4)
    friction_deviation: float = parameter(0.03, "standard deviation of that", "N m", 1e-9, 1e4)
    torque_noise: float = parameter(0.05, "expected standard deviation of unexplained torque", "N m", 1e-9, 1e3)
    disturbance_memory: float = parameter(
        0.03, "correlation time of unexplained torque, at most a third of the window", "s", 0.0, 10.0
    )
    position_noise: float = parameter(1.66e-3, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    sampling: float = parameter(4.6e-3, "expected sampling interval", "s", 1e-5, 1.0)
    minimum_motion: float = parameter(0.05, "least range of angle in an informative window", "rad", 0.0, 1.0)


@dataclass(frozen=True)
class LinkImpedance(Estimator):
    """Stiffness at the present deflection, damping, and gain of the spring law of a servo-driven joint."""

    spring: SpringLaw
    parameters: LinkImpedanceParameters = LinkImpedanceParameters()
    servos: servo_models.Servos = field(default_factory=servo_models.Servos)

    @classmethod
    def from_device(cls, device: Device) -> LinkImpedance:
        """Spring law, inertia, gravity, observed servos and damper range of the device; defaults for the rest."""
        servo = device.motors[0] if device.n_transmissions == 1 else None
        if not isinstance(servo, ServoMotor):
            raise ParameterError(f"'{device.name}' is not driven by a position servo through one spring")
        base = LinkImpedanceParameters()
        link, observed, spring = device.link, device.observed, device.springs[0]
        low, high = (link.viscous_friction + float(device.damping_of(u)) for u in (0.0, 1.0))
        within = np.linspace(0.0, spring.max_deflection, 65)
        return cls(
            spring,
            replace(
                base,
                window=int(np.clip(round(SPAN * device.sensors.rate), 10, 500)),
                sampling=1.0 / device.sensors.rate,
                position_noise=(device.sensors.link_quantum or 0.0) / sqrt(12.0),
                inertia=link.inertia,
                inertia_tolerance=observed.inertia_tolerance,
                spring_tolerance=device.tolerances.spring,
                gravity_torque=link.gravity_torque,
                gravity_angle=link.gravity_angle,
                servo_bandwidth=servo.bandwidth,
                servo_dead_time=observed.servo_dead_time,
                servo_speed_limit=observed.servo_speed_limit or base.servo_speed_limit,
                damping_prior=0.5 * (low + high),
                damping_deviation=max(high - low, 0.5 * high, 1e-6),
                friction_prior=link.coulomb_friction,
                friction_deviation=STICKING * float(np.mean(np.abs(spring.torque(within)))),
            ),
        )

    def with_parameters(self, parameters: Parameters) -> LinkImpedance:
        return replace(self, parameters=expect(parameters, LinkImpedanceParameters))

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("q", "theta_1", "equilibrium", "preset")

    @property
    def outputs(self) -> tuple[str, ...]:
        return OUTPUTS

    @cached_property
    def _constants(self) -> tuple[Array, Array, Array]:
        """Parameter row of the kernel, table of servos (K, 4) and memories (3,); writable, else they compile again."""
        own = self.parameters
        length, stride = own.window + 1, max(own.window // ROWS_PER_WINDOW, 1)
        memory = min(own.disturbance_memory / own.sampling, own.window / 3)
        r = coloured.colours(own.window, MODULATING_ORDER, memory)
        overlap = 1.0 + 2.0 * float(np.sum(r[0, stride::stride])) / r[0, 0]
        row = row_of(
            P, own, length=length, stride=stride, overlap=overlap, persistence=own.servo_memory, shortness=r[0, 0],
            bend=r[2, 0], spring_kind=self.spring.kind, typical=self._typical, gain_prior=1.0,
        )  # fmt: skip
        memories = np.array([own.memory, own.spring_memory, own.spring_memory])
        return np.concatenate([row, self.spring.coefficients()]), self._table, memories

    @cached_property
    def _table(self) -> Array:
        own = self.parameters
        return self.servos.around(own.servo_bandwidth, own.servo_dead_time, own.servo_speed_limit)

    @cached_property
    def _typical(self) -> float:
        """Mean absolute stiffness within the stop [N m/rad], for the uncertainty where the stiffness is near 0."""
        stop = self.spring.max_deflection
        return float(np.mean(np.abs(self.spring.stiffness(np.linspace(0.0, stop, 65)))))

    def init(self) -> Array:
        own, length, k = self.parameters, self.parameters.window + 1, len(OUTPUTS)
        models = len(self._table)
        bank = servo_models.size(models, UNKNOWNS)
        state = np.zeros(HEADER.size + 2 * k + OWN.size + length * (1 + RING.size + models) + bank)
        window.start(state)
        stiffness = float(self.spring.stiffness(0.0))
        state[HEADER.size : HEADER.size + 2 * k] = (
            stiffness, own.damping_prior, 1.0,
            max(abs(stiffness), self._typical) * own.gain_deviation, own.damping_deviation, own.gain_deviation,
        )  # fmt: skip
        servo_models.start(state[-bank:], self._table, UNKNOWNS)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        bank = np.array(state[-servo_models.size(len(self._table), UNKNOWNS) :])
        return float(np.sqrt(np.linalg.cond(servo_models.estimate_of(bank, UNKNOWNS)[1])))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy", forceinline=True)
def _store(
    par: Array, table: Array, motions: Array, times: Array, ring: Array, sample: Array, slot: int, filled: int,
    step: float, first: bool,
) -> None:  # fmt: skip
    """Write one sample into the ring, with every servo advanced to it."""
    q, logged = sample[1], sample[2]
    ring[RING.equilibrium, slot] = sample[3] if window.sound(sample[3]) else np.nan
    ring[RING.preset, slot] = sample[4] if window.sound(sample[4]) else np.nan
    if first or step < 0.0:
        motions[:, MOTION.angle] = logged if abs(logged - q) < 0.5 else q
        motions[:, MOTION.preset] = ring[RING.preset, slot]
        motions[:, MOTION.velocity] = motions[:, MOTION.preset_velocity] = 0.0
    ring[RING.q, slot] = q
    ring[RING.gravity, slot] = par[P.gravity_torque] * sin(q - par[P.gravity_angle])
    kind, spring = int(par[P.spring_kind]), par[P.size :]
    at, left, latest = slot, filled - 1, np.inf
    for j in range(table.shape[0]):
        if not first and step > 0.0:
            when = times[slot] - 0.5 * step - table[j, SERVO.dead_time]
            if when > latest:
                at, left = slot, filled - 1
            latest = when
            while left > 0 and times[at] > when:
                at = at - 1 if at > 0 else times.size - 1
                left -= 1
            known = times[at] <= when  # else no command is old enough
            command = ring[RING.equilibrium, at] if known else np.nan
            preset = ring[RING.preset, at] if known else np.nan
            servo_models.follow(motions[j], table[j], command, preset, step)
        ring[RING.size + j, slot] = spring_torque(kind, spring, q - motions[j, MOTION.angle], motions[j, MOTION.preset])


@njit(cache=True, error_model="numpy", forceinline=True)
def _direction(weights: Array, q: Array, newest: int) -> float:
    """<sign(q'), psi> of the full window that ends at position `newest`."""
    length = q.size
    reach = max(length // (2 * STILL), 1)
    total = 0.0
    for n in range(length):
        before, after = max(n - reach, 0), min(n + reach, length - 1)
        at = newest + 1 + n
        rise = q[(newest + 1 + after) % length] - q[(newest + 1 + before) % length]
        total += weights[at % length] * np.sign(rise)
    return total


@njit(cache=True, error_model="numpy", forceinline=True)
def _learn(
    par: Array, table: Array, memories: Array, bank: Array, time: float, slot: int, psi: Array, ring: Array, row: Array,
    each: Array, gain: Array, variances: Array, span: float,
) -> None:  # fmt: skip
    """Add the equation of the present window, in scaled unknowns; row, gain (3,), each (K,) are overwritten."""
    noise = par[P.torque_noise]
    y = -par[P.inertia] * coloured.dot(psi[2], ring[RING.q]) - coloured.dot(psi[0], ring[RING.gravity])
    row[DAMPING] = -coloured.dot(psi[1], ring[RING.q])
    row[FRICTION] = _direction(psi[0], ring[RING.q], slot)
    y -= row[DAMPING] * par[P.damping_prior] + row[FRICTION] * par[P.friction_prior]
    row[DAMPING] *= par[P.damping_deviation]
    row[FRICTION] *= par[P.friction_deviation]
    bend = par[P.inertia] * par[P.position_noise] / span**2
    variances[0], variances[1] = par[P.shortness] * noise * noise, par[P.bend] * bend * bend
    variances[2] = par[P.overlap]
    for j in range(table.shape[0]):
        each[j] = coloured.dot(psi[0], ring[RING.size + j])
    if not np.isfinite(each).all():
        return  # the spring depends on a preset that is not known yet
    servo_models.take(
        bank, table, time, memories, par[P.persistence], row, GAIN, each, par[P.gain_deviation], par[P.gain_prior], y,
        variances, gain,
    )  # fmt: skip


@njit(cache=True, error_model="numpy", forceinline=True)
def _scale(par: Array, gain: float, variance: float) -> tuple[float, float]:
    """Geometric mean of s and mean square error of it, given gain / s from motion and its variance."""
    floor = max(gain, LEAST_RATIO)
    r, seen = log(floor), min(variance / floor**2, 1.0)
    spring, total, mean, square, logarithm = par[P.spring_tolerance] ** 2 + seen, 0.0, 0.0, 0.0, 0.0
    for k in range(2):
        prior = par[P.inertia_tolerance] ** 2 if k == 0 else par[P.payload_deviation] ** 2
        weight = 1.0 - par[P.payload_probability] if k == 0 else par[P.payload_probability]
        whole = prior + spring
        weight *= exp(-0.5 * r * r / whole) / sqrt(whole)
        middle, left = -r * prior / whole, prior * spring / whole
        total += weight
        mean += weight * exp(middle + 0.5 * left)
        square += weight * exp(2.0 * (middle + left))
        logarithm += weight * middle
    value = exp(logarithm / total)
    return value, max((square - 2.0 * value * mean) / total + value * value, 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def _stiffness(par: Array, filters: Array, motions: Array, q: float) -> tuple[float, float, float]:
    """Mean and variance of the stiffness over the servos, for the inertia of the file; mean deflection [rad]."""
    kind, spring, at = int(par[P.spring_kind]), par[P.size :], servo_models.FILTER.size
    mean, square, phi = 0.0, 0.0, 0.0
    for j in range(filters.shape[0]):
        weight = filters[j, servo_models.FILTER.weight]
        if weight < NEGLIGIBLE:
            continue
        deflection = q - motions[j, MOTION.angle]
        preset = motions[j, MOTION.preset]
        own = spring_stiffness(kind, spring, deflection, preset if np.isfinite(preset) else 0.0)
        single = own * (par[P.gain_prior] + par[P.gain_deviation] * filters[j, at + GAIN])
        variance = filters[j, at + UNKNOWNS + GAIN * (UNKNOWNS + 1)] * (own * par[P.gain_deviation]) ** 2
        phi += weight * deflection
        mean += weight * single
        square += weight * (single * single + variance)
    return mean, max(square - mean * mean, 0.0), phi


@njit(cache=True, error_model="numpy", forceinline=True)
def _report(
    par: Array, stiffness: tuple[float, float], found: Array, covariance: Array, warming: bool, moving: bool,
    value: Array, sd: Array,
) -> None:  # fmt: skip
    """Write stiffness, damping and gain, all for the inertia of the file, to the outputs, multiplied by the scale."""
    if warming:
        value[1], value[2] = par[P.damping_prior], par[P.gain_prior]
        sd[1], sd[2] = par[P.damping_deviation], par[P.gain_deviation]
        value[0], sd[0] = stiffness[0], sd[2] * max(abs(stiffness[0]), par[P.typical])
        return
    damping = par[P.damping_prior] + par[P.damping_deviation] * found[DAMPING]
    gain = par[P.gain_prior] + par[P.gain_deviation] * found[GAIN]
    damping_variance = par[P.damping_deviation] ** 2 * covariance[DAMPING, DAMPING]
    gain_variance = par[P.gain_deviation] ** 2 * covariance[GAIN, GAIN]
    scale, doubt = _scale(par, gain, gain_variance)
    transmissions.update(value, sd, 1, scale * damping, sqrt(scale**2 * damping_variance + doubt * damping**2), moving)
    transmissions.update(value, sd, 2, scale * gain, sqrt(scale**2 * gain_variance + doubt * gain**2), moving)
    value[0], sd[0] = scale * stiffness[0], sqrt(scale**2 * stiffness[1] + doubt * stiffness[0] ** 2)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, table: Array, memories: Array, state: Array, rows: Array, out: Array) -> int:
    length, n, models = int(par[P.length]), UNKNOWNS, table.shape[0]
    value, sd = window.outputs(state, len(OUTPUTS))
    at = HEADER.size + 2 * len(OUTPUTS)
    own = state[at : at + OWN.size]
    times, ring = window.rings(state, at + OWN.size, length, RING.size + models)
    bank = state[at + OWN.size + length * (1 + RING.size + models) :]
    motions, filters = servo_models.motions_of(bank, models, n), servo_models.filters_of(bank, models, n)
    found, combined = servo_models.estimate_of(bank, n)
    psi, held, each = np.empty((3, length)), np.empty(length), np.empty(models)
    row, gain, covariance, variances = np.empty(n), np.empty(n), np.empty((n, n)), np.empty(3)
    for k in range(rows.shape[0]):
        before, first = state[HEADER.last], state[HEADER.samples] == 0.0
        entered = window.admit(state, times, rows[k], 2, par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, step = int(state[HEADER.slot]), rows[k, 0] - before
        _store(par, table, motions, times, ring, rows[k], slot, int(state[HEADER.filled]), step, first)
        moved, moving = 0.0, False
        own[OWN.since] += 1.0
        if state[HEADER.filled] == length:
            moved = window.span_of(ring[RING.q])
            moving = moved >= par[P.minimum_motion]
            if moving:
                if own[OWN.since] >= par[P.stride]:
                    own[OWN.since] = 0.0
                    span = window.weigh(MODULATING_ORDER, times, slot, psi, held)
                    _learn(par, table, memories, bank, rows[k, 0], slot, psi, ring, row, each, gain, variances, span)
                own[OWN.reached] = max(own[OWN.reached], _largest(rows[k, 1], motions))
        warming = bank[servo_models.HEAD.taken] < ROWS_PER_WINDOW
        covariance[:, :] = combined
        servo_models.forget(covariance, max(rows[k, 0] - bank[servo_models.HEAD.time], 0.0), memories)
        mean, variance, phi = _stiffness(par, filters, motions, rows[k, 1])
        _report(par, (mean, variance), found, covariance, warming, moving, value, sd)
        if warming:
            status = WARMING_UP
        elif not moving:
            status = NOT_EXCITED
        else:
            status = OUTSIDE_RANGE if abs(phi) > MARGIN * own[OWN.reached] else OK
        state[HEADER.motion], state[HEADER.status] = moved, status
        window.answer(state, status, out[k])
    return int(out[-1, 1])


@njit(cache=True, error_model="numpy", forceinline=True)
def _largest(q: float, motions: Array) -> float:
    total = 0.0
    for j in range(motions.shape[0]):
        total = max(total, abs(q - motions[j, MOTION.angle]))
    return total
