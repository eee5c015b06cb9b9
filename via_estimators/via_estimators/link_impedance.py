"""Damping and stiffness from the link's own motion, for joints without a torque sensor whose motors are servos.

Weak form of the link equation (4) of the SAPHARI deliverable (Section 2) with the device's law scaled by a gain:

    -M <q, psi''> - <g(q), psi> = d (-<q, psi'>) + gain <tau_e(q - theta; preset), psi>

solved for d(t) [N m s/rad] and gain(t) [-] with a short memory, because both are commanded to vary within a second.

What can be known: no torque is measured, so the equation is homogeneous in (M, d, gain) and only d/M and gain/M follow
from motion. The link inertia of the device file sets the scale, and its tolerance goes into every standard deviation.
d is the equivalent viscous damping of all that resists motion; dry friction and a saturated brake end up in it.

The equilibrium theta is taken from a model of the position servo driven by its command: dead time, speed limit,
critically damped lag (via_core.servos). The logged servo angle of the MACCEPA-VD is right at rest but reads up to
1.6 rad wrong while the servo slews, which no causal spike filter can mend; it only sets where the model starts.
R^2 of the equation on that robot's good runs, median per damping strategy: logged angle .38-.61, lag alone .63-.71,
with dead time and speed limit .81-.90. Both can be read off its servo record: it stands for 45 ms (median of 48 runs),
then slews at about 6.5 rad/s; 5.5 or 7.5 instead move the damping found by less than half a standard deviation.

What is left unexplained is no white noise: it is taken as torque with a correlation time (`disturbance_memory`).
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
from via_core.springs import N_COEFFICIENTS, SpringLaw, spring_stiffness, spring_torque
from via_core.status import Status

from via_estimators import coloured, window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter

MODULATING_ORDER = 5
SPAN = 0.1  # [s] of a window: a fifth of a swing of the robots this is for
(LENGTH, MEMORY, MAX_GAP, TORQUE_NOISE, POSITION_NOISE, INERTIA, TOLERANCE, GRAVITY, GRAVITY_ANGLE) = range(9)
(BANDWIDTH, DEAD_TIME, SPEED, MINIMUM_MOTION, KIND, TYPICAL, PRIOR) = range(9, 16)
LAW = PRIOR + 4  # the law's coefficients follow the prior's means and widths
Q, EQUILIBRIUM, TORQUE, LOAD, COLUMNS = range(5)  # the ring: angle, command, law's torque, gravity
ANGLE, RATE, PRESET, PRESET_RATE, REACHED, N_SERVO = range(6)  # the servo model, and the largest |phi| visited
OUTPUTS = ("stiffness", "damping", "gain")
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class LinkImpedanceParameters(Parameters):
    """Parameters of `LinkImpedance`; the defaults suit a joint of the MACCEPA-VD's size."""

    window: int = parameter(22, "sampling intervals per window", "-", 10, 500)
    memory: float = parameter(0.3, "time after which a row counts 1/e", "s", 0.02, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    inertia: float = parameter(3.6e-3, "link inertia, which sets the scale of all estimates", "kg m^2", 1e-9, 1e4)
    inertia_tolerance: float = parameter(0.15, "relative standard deviation of that", "-", 0.0, 1.0)
    gravity_torque: float = parameter(0.0, "gravity torque at the worst angle", "N m", -1e4, 1e4)
    gravity_angle: float = parameter(0.0, "angle at which the link hangs at rest", "rad", -10.0, 10.0)
    servo_bandwidth: float = parameter(25.0, "bandwidth of the position servos", "rad/s", 0.1, 1e4)
    servo_dead_time: float = parameter(0.0, "time before the servo answers", "s", 0.0, 1.0)
    servo_speed_limit: float = parameter(1e4, "fastest the servo slews", "rad/s", 0.01, 1e4)
    damping_prior: float = parameter(0.02, "damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(0.02, "standard deviation of that", "N m s/rad", 1e-9, 1e4)
    gain_deviation: float = parameter(0.5, "standard deviation of the law's gain before any data", "-", 1e-6, 100.0)
    torque_noise: float = parameter(0.05, "standard deviation of unexplained torque expected", "N m", 1e-9, 1e3)
    disturbance_memory: float = parameter(
        0.03, "correlation time of unexplained torque; counts up to a third of the window", "s", 0.0, 10.0
    )
    position_noise: float = parameter(1.66e-3, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    sampling: float = parameter(4.6e-3, "sampling interval to expect", "s", 1e-5, 1.0)
    minimum_motion: float = parameter(0.05, "range of angle in a window below which it tells nothing", "rad", 0.0, 1.0)


@dataclass(frozen=True)
class LinkImpedance(Estimator):
    """Stiffness at the present deflection, damping, and gain of the law of a servo-driven joint."""

    law: SpringLaw
    parameters: LinkImpedanceParameters = LinkImpedanceParameters()

    @classmethod
    def from_device(cls, device: Device) -> LinkImpedance:
        """The device's law, inertia, gravity, servos as observed and damper range; the rest stays as given."""
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

    def having(self, parameters: Parameters) -> LinkImpedance:
        return replace(self, parameters=expect(parameters, LinkImpedanceParameters))

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("q", "theta_1", "equilibrium", "preset")

    @property
    def outputs(self) -> tuple[str, ...]:
        return OUTPUTS

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        own = self.parameters
        row = np.zeros(LAW + N_COEFFICIENTS)
        row[:PRIOR] = (
            own.window + 1, own.memory, own.max_gap, own.torque_noise, own.position_noise, own.inertia,
            own.inertia_tolerance, own.gravity_torque, own.gravity_angle, own.servo_bandwidth, own.servo_dead_time,
            own.servo_speed_limit, own.minimum_motion, self.law.kind,
            self._typical,
        )  # fmt: skip
        row[PRIOR:LAW] = own.damping_prior, 1.0, own.damping_deviation, own.gain_deviation
        row[LAW:] = self.law.coefficients()
        memory = min(own.disturbance_memory / own.sampling, own.window / 3)
        return row, coloured.mirrored(coloured.colours(own.window, MODULATING_ORDER, memory))

    @cached_property
    def _typical(self) -> float:
        """Mean size of the stiffness within the stop [N m/rad]: what a law may hide that is 0 where the joint is."""
        stop = self.law.max_deflection
        return float(np.mean(np.abs(self.law.stiffness(np.linspace(0.0, stop, 65)))))

    def init(self) -> Array:
        length, k = self.parameters.window + 1, len(OUTPUTS)
        state = np.zeros(window.HEADER + 2 * k + N_SERVO + length * (1 + COLUMNS) + coloured.size(2, length))
        window.start(state)
        own = self.parameters
        stiffness = float(self.law.stiffness(0.0))
        state[window.HEADER : window.HEADER + 2 * k] = (
            stiffness, own.damping_prior, 1.0,
            max(abs(stiffness), self._typical) * own.gain_deviation, own.damping_deviation, own.gain_deviation,
        )  # fmt: skip
        coloured.start(state[len(state) - coloured.size(2, length) :], 2)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        return float(
            np.linalg.cond(coloured.factor(state[len(state) - coloured.size(2, self.parameters.window + 1) :], 2))
        )

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _follow(par: Array, servo: Array, times: Array, commands: Array, newest: int, filled: int, step: float) -> None:
    """Move the servo model on by step [s] to the stamp in slot `newest`, on the command one dead time earlier."""
    at, when = newest, times[newest] - 0.5 * step - par[DEAD_TIME]
    left = filled - 1
    while left > 0 and times[at] > when:
        at = at - 1 if at > 0 else times.size - 1
        left -= 1
    command = commands[at] if times[at] <= when else servo[ANGLE]
    x, v = servo_step(servo[ANGLE], servo[RATE], command, par[BANDWIDTH], step)
    reach = par[SPEED] * step
    servo[ANGLE] += min(max(x - servo[ANGLE], -reach), reach)
    servo[RATE] = min(max(v, -par[SPEED]), par[SPEED])


@njit(cache=True, error_model="numpy")
def _advance(par: Array, r: Array, state: Array, rows: Array, out: Array) -> int:
    length, k_out, n = int(par[LENGTH]), len(OUTPUTS), 2
    noise, blur, M, kind, law = par[TORQUE_NOISE], par[POSITION_NOISE], par[INERTIA], int(par[KIND]), par[LAW:]
    mean, width = par[PRIOR : PRIOR + n], par[PRIOR + n : PRIOR + 2 * n]
    at = window.HEADER
    now, spread = state[at : at + k_out], state[at + k_out : at + 2 * k_out]
    at += 2 * k_out
    servo = state[at : at + N_SERVO]
    at += N_SERVO
    times = state[at : at + length]
    at += length
    ring = state[at : at + length * COLUMNS].reshape(COLUMNS, length)
    equation = state[at + length * COLUMNS :]
    x = coloured.unknowns(equation, n)
    psi, lagged, held = np.empty((3, length)), np.empty((3, length)), np.empty(length)
    row, found, half, work = np.empty(n), np.empty(n), np.empty(n), coloured.scratch(n)
    for k in range(rows.shape[0]):
        before, first = state[window.LAST], state[window.SAMPLES] == 0.0
        entered = window.admit(state, times, rows[k], 2, par[MAX_GAP])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, q, command, preset = int(state[window.SLOT]), rows[k, 1], rows[k, 3], rows[k, 4]
        step = rows[k, 0] - before
        if first or step < 0.0:
            logged = rows[k, 2]
            servo[ANGLE], servo[RATE] = logged if abs(logged - q) < 0.5 else q, 0.0
            servo[PRESET], servo[PRESET_RATE] = preset if window.sound(preset) else 0.0, 0.0
        ring[Q, slot] = q
        ring[EQUILIBRIUM, slot] = command if window.sound(command) else servo[ANGLE]
        if not first and step > 0.0:
            _follow(par, servo, times, ring[EQUILIBRIUM], slot, int(state[window.FILLED]), step)
            if window.sound(preset):
                servo[PRESET], servo[PRESET_RATE] = servo_step(
                    servo[PRESET], servo[PRESET_RATE], preset, par[BANDWIDTH], step
                )
        phi = q - servo[ANGLE]
        ring[TORQUE, slot] = spring_torque(kind, law, phi, servo[PRESET])
        ring[LOAD, slot] = par[GRAVITY] * sin(q - par[GRAVITY_ANGLE])
        if entered == window.RESTARTED:
            coloured.forget_rows(equation, n)
        # Time in a gap, or until a window is full, counts like any other.
        keep = 1.0 if first else exp(-max(step, 0.0) / par[MEMORY])
        coloured.forget(equation, n, keep, work)
        full, span, moved, moving = state[window.FILLED] == length, 1.0, 0.0, False
        if full:
            span = window.weigh(MODULATING_ORDER, times, slot, psi, held)
            moved = window.spread(ring[Q])
            moving = moved >= par[MINIMUM_MOTION]
            if moving:
                coloured.lags(r, slot, keep, lagged)
                y = -M * coloured.dot(psi[2], ring[Q]) - coloured.dot(psi[0], ring[LOAD])
                row[0], row[1] = -coloured.dot(psi[1], ring[Q]), coloured.dot(psi[0], ring[TORQUE])
                for j in range(n):
                    y -= row[j] * mean[j]
                    row[j] *= width[j] / noise
                coloured.take(equation, n, slot, row, y / noise, lagged, work)
                servo[REACHED] = max(servo[REACHED], abs(phi))
            else:
                coloured.skip(equation, n, slot, length)
        warming = equation[coloured.TAKEN] < length
        if warming:
            found[:], half[:] = mean, width
        else:
            for j in range(n):
                found[j] = mean[j] + width[j] * x[j]
            gain = (blur / noise) ** 2
            first_order, second_order = gain * (found[0] / span) ** 2, gain * (M / span**2) ** 2
            torque = coloured.noise(equation, n, r, first_order, second_order, 0.0, work)
            coloured.blur(equation, n, torque, first_order, second_order, work)
            for j in range(n):
                half[j] = sqrt(width[j] ** 2 * coloured.variance_of(n, j, work) + (par[TOLERANCE] * found[j]) ** 2)
        stiffness = spring_stiffness(kind, law, phi, servo[PRESET])
        # Forgetting without motion trades data for the leak, which knows no more than they did: never narrower.
        floor = 0.0 if warming or moving else 1.0
        now[0], now[1], now[2] = found[1] * stiffness, found[0], found[1]
        spread[1], spread[2] = max(half[0], floor * spread[1]), max(half[1], floor * spread[2])
        spread[0] = spread[2] * (max(abs(stiffness), par[TYPICAL]) if warming else abs(stiffness))
        answer = OK
        if warming:
            answer = WARMING_UP
        elif not moving:
            answer = NOT_EXCITED
        elif abs(phi) > 1.02 * servo[REACHED]:
            answer = OUTSIDE_RANGE
        state[window.MOTION], state[window.STATUS] = moved, answer
        window.answer(state, answer, out[k])
    return int(out[-1, 1])
