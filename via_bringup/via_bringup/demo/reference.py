"""Reference set-ups of (12), Sections 6 and 7: arm, modes, wall of the hitting scene, throwing joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg import eigh
from via_controllers.joints.max_velocity import MaxVelocity, joint_of
from via_core.devices import Device
from via_core.signals import Array
from via_core.vsa_arms import VsaArm, load_vsa_arm

# Section 6.1: the modal limit cycle.
ARM = load_vsa_arm("reference_4dof")
EQUILIBRIUM = np.array([0.2, 0.4, 0.3, 1.2])  # q_d [rad]
STIFFNESS = np.diag([100.0, 100.0, 60.0, 60.0])  # K_d [N m/rad], of the springs at rest
LEVEL = 0.02  # H_d [kg m^2]

# Section 6.2: bang-bang control of the arm with friction in its links.
MOTORS = (0.2, 0.5, 0.3, 1.3)  # theta_0 [rad]
DAMPING = 0.05  # zeta [-]
# w_1(0) as a user would choose it: the joints that should swing together.
DIRECTIONS = {1: (0.0, 1.0, 0.0, 1.0), 2: (1.0, 0.0, 1.0, 0.0), 3: (-0.5, 0.0, 1.0, 1.0), 4: (0.0, 0.0, -0.5, 1.0)}
HITTING_MODE = 1
TURNING = 0.138  # [rad] w_1' (q - q_0) at the turning point of the free motion


@dataclass(frozen=True)
class Linear:
    """Modes of the arm about its rest position, softest first."""

    rest: Array  # q_0 (n,) [rad]
    frequencies: Array  # (n,) [Hz]
    directions: Array  # (n, n) [-], unit columns


@cache
def damped_arm() -> VsaArm:
    """The 4-DOF reference arm with viscous friction d_i = 2 zeta sqrt(K_i M_ii) in its links."""
    arm, motors = ARM, np.array(MOTORS)
    q = arm.hanging(motors)
    _, stiffness, _ = arm.spring_state(q - motors)
    return replace(arm, link_friction=2.0 * DAMPING * np.sqrt(stiffness * np.diag(arm.inertia(q))))


def linear_modes(arm: VsaArm, motors: Array) -> Linear:
    """Modes of small oscillations about the rest position, with the motors fixed at `motors` (n,) [rad]."""
    q = arm.hanging(motors)
    _, stiffness, _ = arm.spring_state(q - motors)
    values, modes = eigh(np.diag(stiffness) + arm.gravity_slope(q), arm.inertia(q))
    return Linear(q, np.sqrt(values) / (2.0 * np.pi), modes / np.linalg.norm(modes, axis=0))


@dataclass(frozen=True)
class WallScene:
    """Wall and initial posture of the hitting scene."""

    rest: Array  # (n,) [rad] link angles at rest
    direction: Array  # (n,) [-] direction of the mode
    along: Array  # (3,) [-] direction of the tip's path at rest, towards the wall
    face: Array  # (3,) [m] point on the wall
    start: Array  # (n,) [rad] link angles at which the arm is released


def wall_scene(wall: float, release: float) -> WallScene:
    """Scene with wall and release at these fractions [-] of the distance to the free turning point."""
    arm = damped_arm()
    linear = linear_modes(arm, np.array(MOTORS))
    direction = linear.directions[:, HITTING_MODE - 1]
    direction = direction * np.sign(direction @ np.array(DIRECTIONS[HITTING_MODE]))
    along = arm.tip_jacobian(linear.rest) @ direction
    face, start = linear.rest + wall * TURNING * direction, linear.rest - release * TURNING * direction
    return WallScene(linear.rest, direction, along / np.linalg.norm(along), arm.tip_position(face), start)


def throwing_controller(device: Device, damping_command: float, turns: int) -> tuple[MaxVelocity, float]:
    """Controller with horizon t_n, n = `turns`, and the link velocity [rad/s] that an ideal motor would reach."""
    joint = joint_of(device, damping_command)
    horizon = joint.first_turn + turns * joint.between_turns
    controller = MaxVelocity.from_device(device, horizon, damping_command)
    return controller, controller.velocity * joint.fastest(horizon)
