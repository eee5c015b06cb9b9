"""Weak-form residuals: how far each equation of the nominal model is from balance, straight from measured signals.

    link     <tau_ext, psi> - M <q, psi''> - Dq <qd, psi> - <d(u) qd, psi> - sum <tau_e,i, psi> - <g(q), psi>
    motor i  <tau_i, psi> - B <theta_i, psi''> - Dth <thd_i, psi> + <tau_e,i, psi>

with tau_ext everything known that acts on the link, of an arm's joint the rest of the arm, over windows of 60 ms; psi
carries the derivatives (via_core.weak_form), so no angle is differentiated. What is missing is minus that: torque that
acts on the axis and is not in the model. A torque held between samples counts as (u_n + u_{n-1}) / 2: half a sample
matters. Beside each residual stands what the sensors' quanta make of it. Where an axis nearly stands, dry friction is
known to an interval only: the residual counts as far as it leaves that interval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from via_core.devices import Device, TorqueMotor
from via_core.signals import Array
from via_core.weak_form import window_weights
from via_sim.torques import ARM, EXTERNAL

from via_gap.residual.segments import Segments

WINDOW = 0.06  # [s]
STRIDE = 0.5  # of a window
ORDER = 3  # of the modulating function
STANDING = 0.02  # [rad/s] below which an axis nearly stands


@dataclass(frozen=True, eq=False)
class Residual:
    """One equation over the windows of one log.

    axis      0 link, 1, 2 motors
    centre    (W,) tick in the middle of each window
    torque    (W,) [N m] missing in the model
    floor     (W,) [N m] standard deviation that the sensors explain
    standing  (W,) whether the axis nearly stands somewhere in the window
    """

    axis: int
    centre: NDArray[np.intp]
    torque: Array
    floor: Array
    standing: NDArray[np.bool_]

    @property
    def name(self) -> str:
        return "link" if self.axis == 0 else f"motor {self.axis}"


def equations(segments: Segments, device: Device) -> tuple[int, ...]:
    """The axes whose equation the signals of a log allow: the link needs all motor angles, a motor its own and q."""
    seen = segments.log.motors_seen
    link = (0,) if all(seen) else ()
    if device.drive != "torque":
        return link
    return (*link, *(1 + i for i, each in enumerate(seen) if each))


def weak_residuals(segments: Segments, device: Device) -> tuple[Residual, ...]:
    """Residuals of every equation of `device` (its numbers may be fitted ones) that the log allows."""
    ticks = max(5, round(WINDOW * segments.rate) + 1)
    if len(segments.angles) < ticks:
        return ()
    weights = window_weights(ORDER, np.arange(ticks) / segments.rate)
    first = np.arange(0, len(segments.angles) - ticks + 1, max(1, round(STRIDE * (ticks - 1))))

    def applied(values: Array, row: int) -> Array:
        return sliding_window_view(values, ticks)[first] @ weights[row]

    column = {axis: i for i, axis in enumerate(segments.axes)}
    q = segments.angles[:, 0]
    theta = np.zeros((len(q), device.n_motors))
    for i in range(device.n_motors):
        if 1 + i in column:
            theta[:, i] = segments.angles[:, column[1 + i]]
    springs = device.torque_each(q, theta) if device.n_transmissions else np.zeros((len(q), 0))
    sigma = device.stiffness_each(q, theta) if device.n_transmissions else springs
    quanta = [device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0]
    sizes = np.sqrt(np.sum(weights**2, axis=1))
    found = []
    for axis in equations(segments, device):
        angle = q if axis == 0 else theta[:, axis - 1]
        speed = segments.start[:, 3 + axis]
        noise = quanta[min(axis, 1)] / np.sqrt(12.0)
        if axis == 0:
            known = segments.commands[:, EXTERNAL] + segments.commands[:, ARM]
            torque = known - device.link.gravity_torque * np.sin(q - device.link.gravity_angle)
            torque = torque - springs.sum(axis=1) - device.damping_of(segments.commands[:, 2]) * speed
            inertia, viscous, dry = device.link.inertia, device.link.viscous_friction, device.link.coulomb_friction
            stiff = sigma.sum(axis=1) if sigma.shape[1] else np.zeros(len(q))
        else:
            motor = device.motors[axis - 1]
            assert isinstance(motor, TorqueMotor)
            held = segments.commands[:, axis - 1]
            limit = motor.torque_limit if motor.torque_limit is not None else np.inf
            held = np.clip(held, -limit, limit)
            torque = 0.5 * (held + np.concatenate((held[:1], held[:-1])))
            stiff = np.zeros(len(q))
            if axis <= springs.shape[1]:
                torque = torque + springs[:, axis - 1]
                stiff = sigma[:, axis - 1]
            inertia, viscous, dry = motor.inertia, motor.viscous_friction, motor.coulomb_friction
        windows = sliding_window_view(speed, ticks)[first]
        standing = np.min(np.abs(windows), axis=1) < STANDING
        standing |= np.sign(windows[:, 0]) != np.sign(windows[:, -1])
        missing = inertia * applied(angle, 2) - viscous * applied(angle, 1) - applied(torque, 0)
        if dry > 0.0:
            beyond = np.sign(missing) * np.maximum(np.abs(missing) - dry, 0.0)
            missing = np.where(standing, beyond, missing + dry * np.sign(windows[:, ticks // 2]))
        local = np.abs(stiff[first + ticks // 2])
        floor = noise * (inertia * sizes[2] + viscous * sizes[1] + local * sizes[0])
        floor = np.sqrt(floor**2 + (local * quanta[1 - min(axis, 1)] / np.sqrt(12.0) * sizes[0]) ** 2 + 1e-18)
        found.append(Residual(axis, first + ticks // 2, missing, floor, standing))
    return tuple(found)
