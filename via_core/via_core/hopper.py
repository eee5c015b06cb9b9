"""Planar hopping robot: a trunk on two legs of two segments, knees mirrored, a motor and a spring per joint.

Order of joints: front hip, front knee, rear hip, rear knee; x points forward. At zero angles both legs hang straight
down; a positive hip angle moves the leg forward, a positive knee angle the shank:

    thigh at q_hip from the vertical, shank at q_hip + q_knee,   spring  tau_e = K (q - theta)

Springs and motors as in `vsa_arms`. Controllers use this model; `via_sim.robots.hopper` adds the ground in MuJoCo.
Source: set-up of the checks of (12), Section 6.2, after Figure 18.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import cos, pi, sin

import numpy as np

from via_core.errors import ParameterError
from via_core.signals import Array

GRAVITY = 9.81  # [m/s^2]
HORIZONTAL = 0.5 * pi  # [rad] angle of a thigh that lies on the ground
JOINTS = ("front_hip", "front_knee", "rear_hip", "rear_knee")


@dataclass(frozen=True)
class Hopper:
    """Masses, lengths, springs and motors. Raises ParameterError for values that are not positive."""

    trunk_mass: float = 10.0  # [kg]
    trunk_length: float = 0.5  # [m] distance of the hips
    trunk_height: float = 0.08  # [m] of its box
    payload: float = 0.0  # [kg] on the trunk, distributed like its mass
    thigh_mass: float = 0.8  # [kg]
    shank_mass: float = 0.45  # [kg]
    segment_length: float = 0.25  # [m] of thighs and shanks
    foot_radius: float = 0.015  # [m] of the spheres that touch the ground
    foot_friction: float = 1.0  # [-]
    hip_stiffness: float = 150.0  # K [N m/rad]
    knee_stiffness: float = 80.0
    joint_damping: float = 0.3  # [N m s/rad] of the links
    rotor_inertia: float = 0.02  # B [kg m^2], reflected to the joint
    strongest: float = 60.0  # [N m] of each motor

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            may_be_zero = each.name in ("payload", "joint_damping", "foot_friction")
            if not (np.isfinite(value) and (value > 0.0 or (may_be_zero and value == 0.0))):
                raise ParameterError(f"{each.name} must be {'>=' if may_be_zero else '>'} 0, got {value}")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(JOINTS)

    @property
    def stiffness(self) -> Array:
        """K (n,) [N m/rad]."""
        return np.array([self.hip_stiffness, self.knee_stiffness] * 2)

    @property
    def motor_inertia(self) -> Array:
        """B (n,) [kg m^2]."""
        return np.full(self.n, self.rotor_inertia)

    @property
    def torque_limit(self) -> Array:
        """(n,) [N m] of the motors."""
        return np.full(self.n, self.strongest)

    @property
    def motor_friction(self) -> Array:
        """D (n,) [N m s/rad]: none."""
        return np.zeros(self.n)

    @property
    def speed_limit(self) -> Array:
        """(n,) [rad/s] of the motors: none."""
        return np.full(self.n, np.inf)

    @property
    def deflection_limit(self) -> Array:
        """(n,) [rad] of the springs: none."""
        return np.full(self.n, np.inf)

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """Spring torques [N m] and zero link accelerations, (n,) each: these matter only for deflection limits."""
        return self.spring_state(q - theta)[0], np.zeros(self.n)

    def spring_state(self, deflection: Array) -> tuple[Array, Array, Array]:
        """tau_e [N m], sigma [N m/rad] and d sigma/d phi [N m/rad^2] at `deflection` (n,) [rad], each (n,)."""
        return self.stiffness * deflection, self.stiffness, np.zeros(self.n)

    def crouched(self, angle: float) -> Array:
        """Motor angles (n,) [rad]: feet below the hips, thighs at `angle` [rad] from the vertical, mirrored."""
        return angle * np.array([1.0, -2.0, -1.0, 2.0])

    def standing(self, angle: float) -> Array:
        """Joint angles (n,) [rad] at rest with the motors `crouched` at `angle` [rad]; friction keeps feet below hips.

        Raises ParameterError where the springs do not carry the robot.
        """
        half, low = 0.5 * (self.trunk_mass + self.payload), self.segment_length * GRAVITY
        # gravity torque over sin(a): masses are at 2 (trunk), 1.5 (thigh), .5 (shank) segment lengths times cos(a)
        weight = (2.0 * half + 1.5 * self.thigh_mass + 0.5 * self.shank_mass) * low
        stiffness = self.hip_stiffness + 4.0 * self.knee_stiffness

        def moment(a: float) -> float:
            return stiffness * (a - angle) - weight * sin(a)

        if not 0.0 < angle < HORIZONTAL or moment(HORIZONTAL) <= 0.0:
            raise ParameterError(f"the springs do not carry the robot crouched at {angle} rad")
        from scipy.optimize import brentq  # takes 0.2 s to import

        return self.crouched(brentq(moment, angle, HORIZONTAL, xtol=1e-14))

    def leg_height(self, leg: Array) -> float:
        """Height [m] of the hip above the sole at hip and knee angles `leg` (2,) [rad]."""
        return self.segment_length * (cos(leg[0]) + cos(leg[0] + leg[1])) + self.foot_radius
