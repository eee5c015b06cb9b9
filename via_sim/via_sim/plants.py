"""JointPlant: parameter row and right-hand side of one joint; `from_device` is the nominal model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, sqrt

import numpy as np
from numpy.typing import ArrayLike
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked
from via_core.spring_equations import MACCEPA, N_COEFFICIENTS, TWO_LEVER
from via_core.springs import SpringLaw

from via_sim.catalogue.drive.torque_ripple import RIPPLE_HARMONICS
from via_sim.catalogue.transmission.gear_error import GEAR_HARMONICS
from via_sim.effects import Effect, write_effects
from via_sim.joint.friction import viscous_rate
from via_sim.joint.kernel import derivative
from via_sim.joint.layout import DAMPING, GOAL, N_INPUTS, POWER, U, X
from via_sim.joint.parameters import (
    AT_LINK,
    AT_TRANSMISSION,
    DYNAMIC,
    LINK,
    MOTOR_1,
    N_PARAMETERS,
    NO_DRIVE,
    POSITION_DRIVE,
    SERVO,
    TORQUE_DRIVE,
    P,
    neutral_row,
)
from via_sim.joint.torques import spring_factor

GRAVITY = 9.80665  # [m/s^2]
MAX_SUBSTEPS = 4096  # largest number per tick
_LAG_STEPS = 20.0  # largest number of substeps per tick for a lag
_STEP = 0.25  # substep times fastest explicit rate: relative error per period of that mode near 1e-5

FASTEST = 1e6  # [Hz] largest rate


@dataclass(frozen=True)
class JointPlant:
    """One joint.

    device      device that it was made from: arrangement, drive, names
    parameters  (N_PARAMETERS,) parameter row with effects, locked
    effects     effects in the row
    """

    device: Device
    parameters: Array
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        row = locked(self.parameters, "parameters")
        if row.shape != (N_PARAMETERS,):
            raise ParameterError(f"parameters must have shape ({N_PARAMETERS},), got {row.shape}")
        object.__setattr__(self, "parameters", row)

    @staticmethod
    def from_device(device: Device) -> JointPlant:
        """The nominal plant of a device, without effects."""
        return JointPlant(device, _row_of(device))

    def with_effects(self, effects: Sequence[Effect]) -> JointPlant:
        """The nominal plant of this device with exactly these effects, which replace its present ones.

        Raises ParameterError where an effect does not fit this joint (no such motor, no transmission, a servo drive).
        """
        row = _row_of(self.device)
        write_effects(row, self.device, effects)
        return JointPlant(self.device, row, tuple(effects))

    def at_rate(self, rate: float) -> Array:
        """The row (N_PARAMETERS,) for ticks of 1/rate [s], with tick and substeps set.

        Raises ParameterError for an invalid rate, or one too low for a stiff joint.
        """
        if not 0.0 < rate <= FASTEST:
            raise ParameterError(f"rate must lie in (0, {FASTEST:g}] Hz, got {rate}")
        row = self.parameters.copy()
        row[P.tick] = 1.0 / rate
        row[P.substeps] = substeps_for(row, self.device)
        return row

    def derivative(self, state: ArrayLike, inputs: ArrayLike) -> Array:
        """d/dt (6,) of the state (q, theta_1, theta_2, qd, thd_1, thd_2).

        inputs (4,): torque of motor 1 and 2 [N m] (of a position drive its goal [rad] and 1 or 0 for on or off),
        damping [N m s/rad], external torque at the link [N m]. Absent axes have zero derivatives, servo axes zero
        acceleration (their motion has a closed form).
        """
        x, u = np.array(state, dtype=np.float64), np.array(inputs, dtype=np.float64)
        if x.shape != (6,) or u.shape != (4,):
            raise ParameterError(f"derivative needs state (6,) and inputs (4,), got {x.shape} and {u.shape}")
        row, out = self.parameters.copy(), np.empty(6)  # numba would compile again for a read-only row
        state_row, inputs_row = np.zeros(X.queue), np.zeros(N_INPUTS)
        state_row[:6], inputs_row[:4] = x, u
        if row[P.link_drive] == POSITION_DRIVE:
            inputs_row[U.acting], inputs_row[U.on] = u[GOAL], u[POWER]
            inputs_row[DAMPING] += u[POWER] * row[P.drive_damping]
        inputs_row[U.spring : U.spring + 2] = [spring_factor(row, i, row[P.origin]) for i in range(2)]
        derivative(row, state_row, inputs_row, out)
        return out


def _row_of(device: Device) -> Array:
    row = neutral_row()
    link = device.link
    row[P.axis_kind + LINK] = DYNAMIC
    row[P.inertia + LINK] = link.inertia
    row[P.viscous_friction + LINK] = link.viscous_friction
    row[P.breakaway_friction + LINK] = row[P.kinetic_friction + LINK] = link.coulomb_friction
    row[P.gravity_torque], row[P.gravity_angle] = link.gravity_torque, link.gravity_angle
    row[P.gravity] = np.sign(link.gravity_torque) * GRAVITY
    for i, motor in enumerate(device.motors):
        axis = MOTOR_1 + i
        if isinstance(motor, TorqueMotor):
            row[P.axis_kind + axis] = DYNAMIC
            row[P.inertia + axis] = motor.inertia
            row[P.viscous_friction + axis] = motor.viscous_friction
            row[P.breakaway_friction + axis] = row[P.kinetic_friction + axis] = motor.coulomb_friction
            if motor.torque_limit is not None:
                row[P.torque_limit + i] = motor.torque_limit
        else:
            row[P.axis_kind + axis] = SERVO
            row[P.bandwidth + i] = motor.bandwidth
    drives = P.torque_gain + np.arange(MOTOR_1, MOTOR_1 + device.n_motors) if device.n_motors else P.torque_gain
    row[drives] = device.torque_scale
    row[P.link_drive] = TORQUE_DRIVE if device.n_motors == 0 else NO_DRIVE
    if device.servo is not None:
        row[P.link_drive] = POSITION_DRIVE
        row[P.drive_stiffness], row[P.drive_damping] = device.servo.kp, device.servo.kd
        row[P.drive_torque_limit] = device.servo.torque_limit or np.inf
        row[P.drive_limits_sum] = float(device.servo.limited == "sum")
        row[P.drive_speed_limit] = device.servo.speed_limit or np.inf
        row[P.delay] = device.servo.delay
        row[P.integral_rate] = device.servo.ki / device.servo.kp
        row[P.integral_limit] = device.servo.integral_limit or np.inf
        row[P.feedforward] = device.servo.feedforward
    row[P.serial] = float(device.arrangement == "serial")
    row[P.transmissions] = device.n_transmissions
    for i, spring_law in enumerate(device.springs):
        start = P.spring + i * N_COEFFICIENTS
        row[P.spring_kind + i] = spring_law.kind
        row[start : start + N_COEFFICIENTS] = spring_law.coefficients()
        if spring_law.kind not in (MACCEPA, TWO_LEVER):  # these are periodic; others overflow or end beyond their stop
            row[P.stop + i] = spring_law.max_deflection
    if device.damper is not None:
        row[P.damper_site] = AT_LINK if device.damper.site == "link" else AT_TRANSMISSION
        row[P.damper_kind] = device.damper.kind
        row[P.damper : P.damper + 3] = device.damper.coefficients()
    return row


def substeps_for(row: Array, device: Device) -> float:
    """Integration steps per tick that resolve the fastest explicit terms of the integrator.

    A spring against an inertia has rate w = sqrt(sigma / M), or w^2 / a where viscous friction (rate a) overdamps it. A
    damper in the transmission couples with d (1/M + 1/B). The falling Stribeck curve accelerates an axis from rest with
    a rate up to 0.86 (breakaway - kinetic) / (stribeck_velocity inertia); so does friction that a load adds there.
    Hysteresis, bristles, walls and ripple count as springs. A lag needs at most `_LAG_STEPS` steps.
    Raises ParameterError beyond MAX_SUBSTEPS.
    """
    stiffness, coupled = _stiffest(row, device), float(device.damping_of(1.0))
    if row[P.damper_site] != AT_TRANSMISSION:
        coupled = 0.0
    rate = 0.0
    for axis in range(3):
        if row[P.axis_kind + axis] != DYNAMIC:
            continue
        inertia = row[P.inertia + axis]
        w = sqrt(stiffness[axis] / inertia)
        a = viscous_rate(row, axis, 0.0)
        rate += min(w, w * w / a) if a > 0.0 else w
        excess = row[P.breakaway_friction + axis] - row[P.kinetic_friction + axis]
        rate += 0.86 * excess / (row[P.stribeck_velocity + axis] * inertia)
        rate += 0.86 * _load_excess(row, axis) / (row[P.load_velocity + axis] * inertia)
        explicit = abs(row[P.viscous_asymmetry + axis]) + (coupled if axis < 2 else 0.0)
        if axis == 0:
            explicit += row[P.spring_damping] + row[P.spring_damping + 1]
            explicit += row[P.contact_damping] if row[P.contact_stiffness] > 0.0 else 0.0
            explicit += (row[P.load_friction] + row[P.load_stribeck]) * row[P.drive_damping]
        else:
            explicit += row[P.spring_damping + axis - 1]
        rate += explicit / inertia
    if row[P.lag] > 0.0:
        rate += min(1.0 / row[P.lag], _STEP * _LAG_STEPS / row[P.tick])
    substeps = max(1, ceil(row[P.tick] * rate / _STEP))
    if substeps > MAX_SUBSTEPS:
        raise ParameterError(
            f"'{device.name}' has a mode of {rate:.3g} 1/s: {substeps} steps per tick of {row[P.tick]:.3g} s, "
            f"at most {MAX_SUBSTEPS} are allowed; raise the rate or soften the joint"
        )
    return float(substeps)


def _load_excess(row: Array, axis: int) -> float:
    """Increase of friction [N m] at standstill under the largest known load: gravity, drives at their limits."""
    limits = np.append(row[P.torque_limit : P.torque_limit + 2], row[P.drive_torque_limit])
    load = max(abs(row[P.gravity_torque]), *limits[np.isfinite(limits)], 0.0)
    excess = (row[P.load_stribeck + axis] + row[P.counter_stribeck + axis]) * load
    return float(excess + row[P.load_quadratic + axis] * load**2)


def _stiffest(row: Array, device: Device) -> Array:
    """Largest stiffness (3,) [N m/rad] on each axis."""
    stiffness = np.zeros(3)
    for i, spring_law in enumerate(device.springs):
        harder = 1.0 + 3.0 * max(row[P.spring_hardening + i], 0.0) * spring_law.max_deflection**2
        sigma = row[P.spring_scale + i] * harder * _steepest(spring_law)
        sigma *= _gear_ratio(row, 1 + i) ** 2
        if row[P.hysteresis_torque + i] > 0.0:
            sigma += row[P.hysteresis_stiffness + i]
        stiffness[0] += sigma
        stiffness[1 + i] = sigma
    stiffness[0] += abs(row[P.gravity_torque]) + row[P.contact_stiffness]
    stiffness[0] += abs(row[P.torque_gain]) * row[P.drive_stiffness]
    for axis in range(3):
        if row[P.bristle_torque + axis] > 0.0:
            stiffness[axis] += row[P.bristle_stiffness + axis]
        for k in range(axis, 3 * RIPPLE_HARMONICS, 3):
            stiffness[axis] += abs(row[P.ripple_amplitude + k] * row[P.ripple_order + k])
    return stiffness


def _gear_ratio(row: Array, axis: int) -> float:
    """Largest derivative of the angle at the input of a transmission by that of its motor."""
    harmonics = slice(axis, 3 * GEAR_HARMONICS, 3)
    return 1.0 + float(np.sum(np.abs(row[P.gear_amplitude :][harmonics] * row[P.gear_order :][harmonics])))


@lru_cache(maxsize=256)
def _steepest(spring_law: SpringLaw) -> float:
    """Largest stiffness [N m/rad] of a spring law within its stops."""
    phi = np.linspace(-spring_law.max_deflection, spring_law.max_deflection, 129)
    return max(float(np.max(np.abs(spring_law.stiffness(phi, preset)))) for preset in (0.0, 1.0, 2.0))
