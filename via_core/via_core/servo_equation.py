"""Whether the motion of a link belongs to the commands of its position servo: the link equation with a servo model.

No torque is measured, but the link follows its servo through the spring. With the servo's angle theta from its command
(via_core.servos), one row per short window as in `via_core.plausibility`,

    -tau_e(q - theta, preset) - g(q) = M q'' + d q' + c sign(q') + e

is solved by least squares with inertia M within `device_factor` of the file, 0 <= d <= that of the file's largest
damping, 0 <= c <= DRY of the typical spring torque beyond the declared friction, and |e| <= OFFSET of the load. The
spring law needs no factor of its own, since the equation is homogeneous in M, d, c and the spring. `unexplained` is

    sqrt((rss - noise) / max(|tau_e + g|^2, |M q''|^2))

for the best of several servos (SERVOS), since their numbers are rough. Where the link rests, dry friction holds it.

The servo starts at its first command; the rows begin SETTLED seconds later, when it does not matter any more. Of twelve
real runs of the MACCEPA-VD .12 to .48 remain (median .21), of the same with a reversed link angle .68 to .91; simulated
faults leave .35 and more. So IMPOSSIBLE lies higher than for measured torques.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import e, inf, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from via_core.device_parts import ServoMotor
from via_core.devices import Device
from via_core.modulated_rows import (
    FURTHEST,
    LEAST_SAMPLES,
    OFFSET,
    ORDER,
    RESTING,
    Equation,
    Samples,
    Share,
    bounded_least_squares,
    device_factor,
    finite_columns,
    next_row,
    noise_of,
)
from via_core.servos import limited_step
from via_core.signals import Array
from via_core.weak_form import fill_weights

INTERVAL = 2.0  # [s] of samples
SETTLED = 0.35  # [s] after which the angle does not depend on where the servo was
IMPOSSIBLE = 0.4  # [-]
ENOUGH = 0.5  # of IMPOSSIBLE: no other servo is tried when one explains as much
DRY = 0.25  # [-] dry friction that the file does not state, over the typical spring torque
# Factors on bandwidth and speed limit; change of the dead time, over itself or 1 / w if that is longer.
SERVOS = ((1.0, 1.0, 0.0), (0.6, 1.0, 0.0), (1.0, 0.45, 0.0), (1.5, 1.0, 0.6), (1.0, 4.0, -0.7), (0.6, 0.45, 0.0))
PARTS = 4  # unknowns: M, d, c, e
REACH = 3  # samples on either side whose difference gives the direction of motion


class Bounds(NamedTuple):
    """Bounds of the unknowns of the link equation."""

    light: float  # least inertia [kg m^2]
    heavy: float  # largest inertia [kg m^2]
    damping: float  # largest [N m s/rad]
    dry: float  # largest dry friction [N m]


@dataclass(frozen=True)
class ServoEquation(Equation):
    """The link equation of a device whose link is driven by a servo through one spring.

    servos  (K, 3) bandwidth [rad/s], speed limit [rad/s], dead time [s]
    """

    device: Device
    servos: Array
    bounds: Bounds
    interval = INTERVAL

    def share(self, samples: Samples) -> Share:
        assert samples.command is not None
        columns = finite_columns(samples.time, samples.q, *samples.command.T)
        time, q, spring, best = columns[0], columns[1], self.device.springs[0], Share(inf, 0.0, IMPOSSIBLE)
        used = time >= time[0] + SETTLED if len(time) else np.zeros(0, dtype=np.bool_)
        if np.count_nonzero(used) < LEAST_SAMPLES:
            return Share(0.0, 0.0, IMPOSSIBLE)
        reach, link = FURTHEST * spring.max_deflection, self.device.link
        gravity = link.gravity_torque * np.sin(q[used] - link.gravity_angle)
        for servo in self.servos:
            theta, preset = _follow(time, columns[2], servo), _follow(time, columns[3], servo)
            deflection = (q - theta)[used]
            if np.mean(np.abs(deflection) > reach) > 0.5:
                found = Share(1.0, inf, IMPOSSIBLE)
            else:
                load = spring.torque(np.clip(deflection, -reach, reach), preset[used]) + gravity
                step = self.device.sensors.link_quantum or 0.0
                unexplained, clearness = _link_share(time[used], q[used], load, self.bounds, step)
                found = Share(unexplained, clearness, IMPOSSIBLE)
            if found.unexplained < best.unexplained:
                best = found
            if best.unexplained < ENOUGH * IMPOSSIBLE:
                break
        return best


def servo_equation(device: Device) -> tuple[ServoEquation, ...]:
    """The equation of a device driven by a servo through one spring; none for other arrangements."""
    servo = device.motors[0]
    if not isinstance(servo, ServoMotor) or device.n_transmissions != 1:
        return ()
    link, given, observed, spring = device.link, device.tolerances, device.observed, device.springs[0]
    factor = device_factor(observed.inertia_tolerance)
    damping = link.viscous_friction + float(device.damping_of(1.0))
    typical = float(np.mean(np.abs(spring.torque(np.linspace(0.0, spring.max_deflection, 65)))))
    dry = device_factor(given.link_friction) * link.coulomb_friction + DRY * typical
    fastest = observed.servo_speed_limit or servo.bandwidth / e  # of a step of 1 rad
    dead, change = observed.servo_dead_time, max(observed.servo_dead_time, 1.0 / servo.bandwidth)
    servos = [(w * servo.bandwidth, v * fastest, max(dead + t * change, 0.0)) for w, v, t in SERVOS]
    most = device_factor(given.damper) * damping
    return (ServoEquation(device, np.array(servos), Bounds(link.inertia / factor, link.inertia * factor, most, dry)),)


@njit(cache=True, error_model="numpy")
def _follow(time: Array, command: Array, servo: Array) -> Array:
    """Angle (N,) [rad] of a servo (3,) under a command (N,) held from sample to sample, at first at the first one."""
    angle = np.empty(time.size)
    x, v, at = command[0], 0.0, 0
    angle[0] = x
    for k in range(1, time.size):
        step = time[k] - time[k - 1]
        when = time[k] - 0.5 * step - servo[2]
        while at < k and time[at + 1] <= when:
            at += 1
        x, v = limited_step(x, v, command[at], servo[0], servo[1], step)
        angle[k] = x
    return angle


@njit(cache=True, error_model="numpy")
def _link_share(time: Array, q: Array, load: Array, bounds: Bounds, step: float) -> tuple[float, float]:
    """Unexplained share of the load and ratio of the largest part to its noise, (0, 0) if unknown.

    load  (N,) torque of spring and gravity [N m]
    step  encoder step [rad]
    """
    noise_q, noise_load = noise_of(q) ** 2, noise_of(load) ** 2
    still = max(RESTING * step, 6.0 * sqrt(noise_q))
    rows, wanted, moving = np.zeros((time.size, PARTS)), np.zeros(time.size), np.zeros(time.size, dtype=np.bool_)
    count, short, bend = 0, 0.0, 0.0
    first, last = next_row(time, 0, -1)
    while first >= 0:
        n = last - first + 1
        if n >= LEAST_SAMPLES:
            weights = np.empty((3, n))
            fill_weights(ORDER, time[first : last + 1], 0, weights)
            row = rows[count]
            for k in range(n):
                at = first + k
                row[0] += weights[2, k] * q[at]
                row[1] -= weights[1, k] * q[at]
                row[2] += weights[0, k] * np.sign(q[min(at + REACH, q.size - 1)] - q[max(at - REACH, 0)])
                wanted[count] -= weights[0, k] * load[at]
            row[3] = 1.0
            moving[count] = np.ptp(q[first : last + 1]) > still
            short += weights[0] @ weights[0]
            bend += weights[2] @ weights[2]
            count += 1
        first, last = next_row(time, first, last)
    if count < PARTS:
        return 0.0, 0.0
    rows, wanted, moving = rows[:count], wanted[:count], moving[:count]
    size = sqrt(wanted @ wanted / count)
    low, high = np.zeros(PARTS), np.array([bounds.heavy, bounds.damping, bounds.dry, OFFSET * size])
    low[0], low[3] = bounds.light, -high[3]
    x = np.zeros(PARTS)
    used, y = rows[moving], wanted[moving]
    if len(used) >= PARTS:
        bounded_least_squares(used.T @ used, used.T @ y, low, high, x)
    left = wanted - rows @ x
    for k in range(count):
        if not moving[k]:  # dry friction holds the link
            left[k] = np.sign(left[k]) * max(abs(left[k]) - bounds.dry, 0.0)
    inertial = x[0] * rows[:, 0]
    largest = max(float(wanted @ wanted), float(inertial @ inertial))
    noise = x[0] * x[0] * noise_q * bend + noise_load * short
    if largest <= 0.0:
        return 0.0, 0.0
    return sqrt(max(left @ left - noise, 0.0) / largest), sqrt(largest / max(noise, 1e-300))
