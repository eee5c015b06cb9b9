"""Damping and stiffness from the link's own motion, for joints without a torque sensor whose motors are servos.

Weak form of the link equation (4) of the SAPHARI deliverable (Section 2) with the spring law scaled by a gain:

    -M <q, psi''> - <g(q), psi> = d (-<q, psi'>) + gain <tau_e(q - theta; preset), psi>

solved for d(t) [N m s/rad] and gain(t) [-] with a short memory, since commands vary both within a second.

Observability: no torque is measured, so the equation is homogeneous in (M, d, gain) and only d/M and gain/M follow from
motion. The link inertia of the device file sets the scale; every standard deviation includes its tolerance. d is the
equivalent viscous damping of all resistance to motion, including dry friction and a saturated brake.

The equilibrium theta is taken from a model of the position servo driven by its command: dead time, speed limit,
critically damped lag (via_core.servos). The logged servo angle of the MACCEPA-VD is correct at rest but wrong by up to
1.6 rad while the servo slews, which no causal spike filter can correct; it only initialises the model. R^2 of the
equation on that robot's good runs, median per damping strategy: logged angle .38-.61, lag alone .63-.71, with dead time
and speed limit .81-.90. Both can be read off its servo record: it rests for 45 ms (median of 48 runs), then slews at
about 6.5 rad/s; with 5.5 or 7.5, estimated damping changes by less than half a standard deviation.

The unexplained residual is not white: it is modelled as torque with a correlation time (`disturbance_memory`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, sin, sqrt

import numpy as np
from numba import njit
from via_core.device_parts import ServoMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.servos import servo_step
from via_core.signals import Array
from via_core.springs import SpringLaw, spring_stiffness, spring_torque
from via_core.status import BAD_SAMPLE, NOT_EXCITED, OK, OUTSIDE_RANGE, WARMING_UP

from via_estimators import coloured, transmissions, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.slots import row_of, slots
from via_estimators.window import HEADER

MODULATING_ORDER = 5
SPAN = 0.1  # [s] of a window: a fifth of a swing of the intended robots
MARGIN = 1.02  # deflections up to this multiple of the largest one visited count as visited
# `typical` is a typical stiffness [N m/rad]. Followed by the coefficients of the spring law.
P = slots(
    "length", "memory", "max_gap", "torque_noise", "position_noise", "inertia", "inertia_tolerance", "gravity_torque",
    "gravity_angle", "servo_bandwidth", "servo_dead_time", "servo_speed_limit", "minimum_motion", "spring_kind",
    "typical", "damping_prior", "gain_prior", "damping_deviation", "gain_deviation",
)  # fmt: skip
RING = slots("q", "equilibrium", "torque", "gravity")  # angle, command, torque of the spring law, gravity torque
SERVO = slots("angle", "velocity", "preset", "preset_velocity", "reached")  # servo model; largest |phi| visited
OUTPUTS = ("stiffness", "damping", "gain")
UNKNOWNS = 2  # damping, gain


@dataclass(frozen=True)
class LinkImpedanceParameters(Parameters):
    """Parameters of `LinkImpedance`; the defaults suit a joint like the MACCEPA-VD's."""

    window: int = parameter(22, "sampling intervals per window", "-", 10, 500)
    memory: float = parameter(0.3, "time after which a row has weight 1/e", "s", 0.02, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    inertia: float = parameter(3.6e-3, "link inertia, the scale of all estimates", "kg m^2", 1e-9, 1e4)
    inertia_tolerance: float = parameter(0.15, "relative standard deviation of that", "-", 0.0, 1.0)
    gravity_torque: float = parameter(0.0, "gravity torque at the worst angle", "N m", -1e4, 1e4)
    gravity_angle: float = parameter(0.0, "angle at which the link hangs at rest", "rad", -10.0, 10.0)
    servo_bandwidth: float = parameter(25.0, "bandwidth of the position servos", "rad/s", 0.1, 1e4)
    servo_dead_time: float = parameter(0.0, "dead time of the servo", "s", 0.0, 1.0)
    servo_speed_limit: float = parameter(1e4, "speed limit of the servo", "rad/s", 0.01, 1e4)
    damping_prior: float = parameter(0.02, "damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(0.02, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    gain_deviation: float = parameter(0.5, "standard deviation of the gain before any data", "-", 1e-6, 100.0)
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

    @classmethod
    def from_device(cls, device: Device) -> LinkImpedance:
        """Spring law, inertia, gravity, observed servos and damper range of the device; defaults for the rest."""
        servo = device.motors[0] if device.n_transmissions == 1 else None
        if not isinstance(servo, ServoMotor):
            raise ParameterError(f"'{device.name}' is not driven by a position servo through one spring")
        base = LinkImpedanceParameters()
        link, observed = device.link, device.observed
        low, high = (link.viscous_friction + float(device.damping_of(u)) for u in (0.0, 1.0))
        return cls(
            device.spring_laws[0],
            replace(
                base,
                window=int(np.clip(round(SPAN * device.sensors.rate), 10, 500)),
                sampling=1.0 / device.sensors.rate,
                position_noise=(device.sensors.link_quantum or 0.0) / sqrt(12.0),
                inertia=link.inertia,
                inertia_tolerance=observed.inertia_tolerance,
                gravity_torque=link.gravity_torque,
                gravity_angle=link.gravity_angle,
                servo_bandwidth=servo.bandwidth,
                servo_dead_time=observed.servo_dead_time,
                servo_speed_limit=observed.servo_speed_limit or base.servo_speed_limit,
                damping_prior=0.5 * (low + high),
                damping_deviation=max(high - low, 0.5 * high, 1e-6),
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
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel and noise colours (3, 2 L); writable, since a locked array compiles again."""
        own = self.parameters
        row = row_of(P, own, length=own.window + 1, spring_kind=self.spring.kind, typical=self._typical, gain_prior=1.0)
        memory = min(own.disturbance_memory / own.sampling, own.window / 3)
        colours = coloured.colours(own.window, MODULATING_ORDER, memory)
        return np.concatenate([row, self.spring.coefficients()]), coloured.mirrored(colours)

    @cached_property
    def _typical(self) -> float:
        """Mean absolute stiffness within the stop [N m/rad], for the uncertainty where the stiffness is near 0."""
        stop = self.spring.max_deflection
        return float(np.mean(np.abs(self.spring.stiffness(np.linspace(0.0, stop, 65)))))

    def init(self) -> Array:
        own, length, k = self.parameters, self.parameters.window + 1, len(OUTPUTS)
        size = coloured.size(UNKNOWNS, length)
        state = np.zeros(HEADER.size + 2 * k + SERVO.size + length * (1 + RING.size) + size)
        window.start(state)
        stiffness = float(self.spring.stiffness(0.0))
        state[HEADER.size : HEADER.size + 2 * k] = (
            stiffness, own.damping_prior, 1.0,
            max(abs(stiffness), self._typical) * own.gain_deviation, own.damping_deviation, own.gain_deviation,
        )  # fmt: skip
        coloured.start(state[-size:], UNKNOWNS)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        equation = state[-coloured.size(UNKNOWNS, self.parameters.window + 1) :]
        return float(np.linalg.cond(coloured.factor(equation, UNKNOWNS)))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _follow(par: Array, servo: Array, times: Array, commands: Array, newest: int, filled: int, step: float) -> None:
    """Advance the servo model by step [s] to the stamp at `newest`, with the command one dead time earlier."""
    at, when = newest, times[newest] - 0.5 * step - par[P.servo_dead_time]
    left = filled - 1
    while left > 0 and times[at] > when:
        at = at - 1 if at > 0 else times.size - 1
        left -= 1
    command = commands[at] if times[at] <= when else servo[SERVO.angle]
    x, v = servo_step(servo[SERVO.angle], servo[SERVO.velocity], command, par[P.servo_bandwidth], step)
    limit = par[P.servo_speed_limit]
    reach = limit * step
    servo[SERVO.angle] += min(max(x - servo[SERVO.angle], -reach), reach)
    servo[SERVO.velocity] = min(max(v, -limit), limit)


@njit(cache=True, error_model="numpy", forceinline=True)
def _store(
    par: Array, servo: Array, times: Array, ring: Array, sample: Array, slot: int, filled: int, step: float, first: bool
) -> float:
    """Write one sample into the ring, with the servo model advanced to it; returns the deflection [rad]."""
    q, logged, command, preset = sample[1], sample[2], sample[3], sample[4]
    if first or step < 0.0:
        servo[SERVO.angle], servo[SERVO.velocity] = logged if abs(logged - q) < 0.5 else q, 0.0
        servo[SERVO.preset], servo[SERVO.preset_velocity] = preset if window.sound(preset) else 0.0, 0.0
    ring[RING.q, slot] = q
    ring[RING.equilibrium, slot] = command if window.sound(command) else servo[SERVO.angle]
    if not first and step > 0.0:
        _follow(par, servo, times, ring[RING.equilibrium], slot, filled, step)
        if window.sound(preset):
            servo[SERVO.preset], servo[SERVO.preset_velocity] = servo_step(
                servo[SERVO.preset], servo[SERVO.preset_velocity], preset, par[P.servo_bandwidth], step
            )
    phi = q - servo[SERVO.angle]
    ring[RING.torque, slot] = spring_torque(int(par[P.spring_kind]), par[P.size :], phi, servo[SERVO.preset])
    ring[RING.gravity, slot] = par[P.gravity_torque] * sin(q - par[P.gravity_angle])
    return phi


@njit(cache=True, error_model="numpy", forceinline=True)
def _learn(
    par: Array, equation: Array, slot: int, psi: Array, ring: Array, lagged: Array, row: Array, work: Array
) -> None:
    """Add the equation of the present window, in scaled unknowns; row (2,) is overwritten."""
    noise = par[P.torque_noise]
    y = -par[P.inertia] * coloured.dot(psi[2], ring[RING.q]) - coloured.dot(psi[0], ring[RING.gravity])
    row[0], row[1] = -coloured.dot(psi[1], ring[RING.q]), coloured.dot(psi[0], ring[RING.torque])
    for j in range(UNKNOWNS):
        y -= row[j] * par[P.damping_prior + j]
        row[j] *= par[P.damping_deviation + j] / noise
    coloured.take(equation, UNKNOWNS, slot, row, y / noise, lagged, work)


@njit(cache=True, error_model="numpy", forceinline=True)
def _evaluate(
    par: Array, r: Array, equation: Array, span: float, warming: bool, found: Array, half: Array, work: Array
) -> None:
    """Write damping and gain into found (2,), their standard deviations into half (2,)."""
    mean, width = par[P.damping_prior : P.damping_prior + 2], par[P.damping_deviation : P.damping_deviation + 2]
    if warming:
        found[:], half[:] = mean, width
    else:
        x = coloured.unknowns(equation, UNKNOWNS)
        for j in range(UNKNOWNS):
            found[j] = mean[j] + width[j] * x[j]
        gain = (par[P.position_noise] / par[P.torque_noise]) ** 2
        first, second = gain * (found[0] / span) ** 2, gain * (par[P.inertia] / span**2) ** 2
        torque = coloured.noise(equation, UNKNOWNS, r, first, second, 0.0, work)
        coloured.blur(equation, UNKNOWNS, torque, first, second, work)
        for j in range(UNKNOWNS):
            variance = width[j] ** 2 * coloured.variance_of(UNKNOWNS, j, work)
            half[j] = sqrt(variance + (par[P.inertia_tolerance] * found[j]) ** 2)


@njit(cache=True, error_model="numpy", forceinline=True)
def _report(
    par: Array,
    servo: Array,
    phi: float,
    found: Array,
    half: Array,
    warming: bool,
    moving: bool,
    value: Array,
    sd: Array,
) -> int:
    """Write stiffness at the deflection phi [rad], damping and gain to the outputs; returns the status."""
    stiffness = spring_stiffness(int(par[P.spring_kind]), par[P.size :], phi, servo[SERVO.preset])
    transmissions.update(value, sd, 1, found[0], half[0], warming or moving)
    transmissions.update(value, sd, 2, found[1], half[1], warming or moving)
    value[0] = found[1] * stiffness
    sd[0] = sd[2] * (max(abs(stiffness), par[P.typical]) if warming else abs(stiffness))
    if warming:
        return WARMING_UP
    if not moving:
        return NOT_EXCITED
    return OUTSIDE_RANGE if abs(phi) > MARGIN * servo[SERVO.reached] else OK


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    length, n = int(par[P.length]), UNKNOWNS
    value, sd = window.outputs(state, len(OUTPUTS))
    at = HEADER.size + 2 * len(OUTPUTS)
    servo = state[at : at + SERVO.size]
    times, ring = window.rings(state, at + SERVO.size, length, RING.size)
    equation = state[at + SERVO.size + length * (1 + RING.size) :]
    psi, lagged, held = np.empty((3, length)), np.empty((3, length)), np.empty(length)
    row, found, half, work = np.empty(n), np.empty(n), np.empty(n), coloured.scratch(n)
    for k in range(rows.shape[0]):
        before, first = state[HEADER.last], state[HEADER.samples] == 0.0
        entered = window.admit(state, times, rows[k], 2, par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, step = int(state[HEADER.slot]), rows[k, 0] - before
        phi = _store(par, servo, times, ring, rows[k], slot, int(state[HEADER.filled]), step, first)
        if entered == window.RESTARTED:
            coloured.forget_rows(equation, n)
        keep = 1.0 if first else exp(-max(step, 0.0) / par[P.memory])  # also in a gap or before the window is full
        coloured.forget(equation, n, keep, work)
        full, span, moved, moving = state[HEADER.filled] == length, 1.0, 0.0, False
        if full:
            span = window.weigh(MODULATING_ORDER, times, slot, psi, held)
            moved = window.span_of(ring[RING.q])
            moving = moved >= par[P.minimum_motion]
            if moving:
                coloured.lags(r, slot, keep, lagged)
                _learn(par, equation, slot, psi, ring, lagged, row, work)
                servo[SERVO.reached] = max(servo[SERVO.reached], abs(phi))
            else:
                coloured.skip(equation, n, slot, length)
        warming = equation[coloured.HEAD.taken] < length
        _evaluate(par, r, equation, span, warming, found, half, work)
        status = _report(par, servo, phi, found, half, warming, moving, value, sd)
        state[HEADER.motion], state[HEADER.status] = moved, status
        window.answer(state, status, out[k])
    return int(out[-1, 1])
