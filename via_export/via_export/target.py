"""The joint to be exported: a device with effects, as the numbers that all formats write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from via_core.devices import Device
from via_core.signals import Array
from via_core.spring_equations import MACCEPA, TWO_LEVER
from via_sim.catalogue.drive.torque_ripple import RIPPLE_HARMONICS
from via_sim.effects import Effect
from via_sim.joint.parameters import LINK, MOTOR_1, SERVO, P
from via_sim.plants import GRAVITY, JointPlant, substeps_for

LOAD_SHARE = 2.0 / np.pi  # mean of |sin| over a turn: mean gravity load of a link over its largest
TICK = 1e-3  # [s] at which commands change


@dataclass(frozen=True)
class Target:
    """A device with effects; `row` holds all numbers of both (via_sim.joint.parameters)."""

    device: Device
    effects: tuple[Effect, ...] = ()

    @staticmethod
    def of(device: Device, effects: Sequence[Effect] = ()) -> Target:
        """Raises ParameterError for an effect that does not fit the device."""
        made = Target(device, tuple(effects))
        _ = made.row
        return made

    @cached_property
    def row(self) -> Array:
        """(N_PARAMETERS,) parameter row."""
        return JointPlant.from_device(self.device).with_effects(self.effects).at_rate(1.0 / TICK)

    @cached_property
    def nominal(self) -> Array:
        """(N_PARAMETERS,) parameter row without effects."""
        return JointPlant.from_device(self.device).at_rate(1.0 / TICK)

    def of_axis(self, slot: int, axis: int) -> float:
        """Number in a slot of an axis: 0 link, 1, 2 motors."""
        return float(self.row[slot + axis])

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names of link and motors."""
        return (self.device.link_joint, *self.device.motor_joints)

    @property
    def drives(self) -> tuple[int, ...]:
        """Axes with a drive: the motors, or the link of a rigid joint."""
        return tuple(range(MOTOR_1, MOTOR_1 + self.device.n_motors)) or (LINK,)

    def is_servo(self, axis: int) -> bool:
        """Whether an axis follows its command as a position servo whatever its load."""
        return bool(self.row[P.axis_kind + axis] == SERVO)

    @property
    def inertia(self) -> float:
        """[kg m^2] of the link, payload included."""
        return self.of_axis(P.inertia, LINK)

    @property
    def gravity_torque(self) -> float:
        """[N m] largest gravity torque; the link hangs at `gravity_angle`."""
        return abs(float(self.row[P.gravity_torque]))

    @property
    def gravity_angle(self) -> float:
        """[rad] at which the link hangs at rest."""
        turned = np.pi if self.row[P.gravity_torque] < 0.0 else 0.0
        return float(self.row[P.gravity_angle]) + turned

    @property
    def centre(self) -> tuple[float, float, float]:
        """Mass [kg] of a body, distance [m] of its centre from the axis, inertia [kg m^2] about the centre.

        The body has the link's gravity torque and its inertia about the axis, half of which is that of the mass.
        """
        if self.gravity_torque == 0.0:
            return 1.0, 0.0, self.inertia
        moment = self.gravity_torque / GRAVITY  # [kg m]
        distance = 0.5 * self.inertia / moment
        return moment / distance, distance, 0.5 * self.inertia

    def viscous(self, axis: int) -> float:
        """[N m s/rad] mean of both directions, without dampers of transmissions and drives."""
        return self.of_axis(P.viscous_friction, axis)

    def constant(self, axis: int) -> float:
        """[N m] constant torque on an axis beside its drive: asymmetric dry friction, and on the link a push.

        Friction within [-forward, backward] is symmetric friction of the mean and a constant torque: (backward -
        forward)/2, moving or not.
        """
        torque = -self.of_axis(P.friction_asymmetry, axis)
        return torque + (self.lasting_push if axis == LINK else 0.0)

    @property
    def lasting_push(self) -> float:
        """[N m] external torque if it acts all the time, else 0."""
        row = self.row
        lasting = row[P.pulse_start] <= 0.0 and row[P.pulse_stop] >= 1e6
        return float(row[P.pulse_torque]) if lasting else 0.0

    def load_friction(self, axis: int) -> float:
        """[N m] constant in place of friction that depends on the load: its mean over a turn of the sliding link.

        The drive balances gravity, of which each transmission carries its share. Without gravity the load is unknown,
        and the friction is left out; so is its increase at standstill, which acts only where torques are opposed.
        """
        share = 1.0 if axis == LINK else 1.0 / max(self.device.n_transmissions, 1)
        coefficient = self.of_axis(P.load_friction, axis) + self.of_axis(P.counter_friction, axis)
        return coefficient * LOAD_SHARE * share * self.gravity_torque

    def dry(self, axis: int) -> tuple[float, float, float]:
        """Breakaway and kinetic friction [N m] and the speed [rad/s] that separates them; the bristle is apart."""
        row, more = self.row, self.load_friction(axis)
        return (
            float(row[P.breakaway_friction + axis]) + more,
            float(row[P.kinetic_friction + axis]) + more,
            float(row[P.stribeck_velocity + axis]),
        )

    def bristle(self, axis: int) -> tuple[float, float]:
        """Torque [N m] and stiffness [N m/rad] of the bristle."""
        return self.of_axis(P.bristle_torque, axis), self.of_axis(P.bristle_stiffness, axis)

    def ripple(self, axis: int) -> list[tuple[float, float, float]]:
        """Amplitude [N m], order [1/rev] and phase [rad] of each harmonic of the torque ripple."""
        first = [axis + 3 * k for k in range(RIPPLE_HARMONICS)]
        found = [
            tuple(float(self.row[s + k]) for s in (P.ripple_amplitude, P.ripple_order, P.ripple_phase)) for k in first
        ]
        return [(a, order, phase) for a, order, phase in found if a != 0.0]

    def limit(self, axis: int) -> float:
        """[N m] limit of the torque that a drive commands, infinite if none is known."""
        row = self.row
        if self.device.drive == "position":
            known = float(row[P.drive_torque_limit])
        else:
            known = float(row[P.torque_limit + axis - 1]) if axis else inf
        return min(known, float(row[P.saturation + axis]))

    @property
    def depends_on_preset(self) -> bool:
        """Whether the spring depends on a motor angle besides its deflection."""
        return any(spring.kind in (MACCEPA, TWO_LEVER) for spring in self.device.springs)

    @property
    def substeps(self) -> int:
        """Integration steps per millisecond that resolve the joint."""
        return int(substeps_for(self.row, self.device))

    @property
    def moving(self) -> tuple[int, ...]:
        """Axes that move together where springs are rigid: the link and its motors, not a preset motor or servos."""
        motors = [axis for axis in range(1, 1 + self.device.n_transmissions) if not self.is_servo(axis)]
        return (LINK, *motors)

    @property
    def rigid_inertia(self) -> float:
        """[kg m^2] of the link and of the motors that move with it."""
        return sum(self.of_axis(P.inertia, axis) for axis in self.moving)

    @property
    def rigid_viscous(self) -> float:
        """[N m s/rad] of the same axes and of the damper at command 0."""
        return sum(self.viscous(axis) for axis in self.moving) + float(self.device.damping_of(0.0))

    @property
    def rigid_dry(self) -> tuple[float, float]:
        """Breakaway and kinetic friction [N m] of the same axes, bristles included."""
        each = [(*self.dry(axis)[:2], self.bristle(axis)[0]) for axis in self.moving]
        return sum(a + c for a, _, c in each), sum(b + c for _, b, c in each)

    @property
    def effort(self) -> float:
        """[N m] limit of all drives that act on the link, times their gains; infinite if unknown."""
        axes = [axis for axis in self.moving if axis in self.drives] or [LINK]
        return sum(self.limit(axis) * self.of_axis(P.torque_gain, axis) for axis in axes)

    @property
    def integral_gain(self) -> float:
        """[N m/(rad s)] ki of a position drive, before the gain of its torque."""
        return float(self.row[P.integral_rate] * self.row[P.drive_stiffness])

    @property
    def integral_limit(self) -> float:
        """[N m] largest torque of the integral, before the gain; infinite if there is none."""
        return min(float(self.row[P.integral_limit]), self.limit(LINK))

    @property
    def speed(self) -> float:
        """[rad/s] limit of the joint's speed, infinite if unknown."""
        row = self.row
        known = [float(row[P.drive_speed_limit])]
        known += [motor.speed_limit for motor in self.device.torque_motors if motor.speed_limit is not None]
        known += [float(row[P.saturation + axis]) for axis in self.drives if self.is_servo(axis)]
        return min(known)

    @property
    def late(self) -> float:
        """[s] delay of commands, filters included."""
        return float(self.row[P.delay] + self.row[P.lag])

    @property
    def ends(self) -> tuple[float, float]:
        """[rad] range of the link: up to a wall."""
        if self.row[P.contact_stiffness] <= 0.0:
            return -inf, inf
        wall = float(self.row[P.contact_angle])
        return (-inf, wall) if self.row[P.contact_side] > 0.0 else (wall, inf)
