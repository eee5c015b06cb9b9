"""The modal limit cycle of Section 6.1 on the simulated arm: reference set-up, and evaluation of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp

import numpy as np
from via_bringup.demo.reference import ARM, EQUILIBRIUM, LEVEL, STIFFNESS
from via_controllers.arms.modal_limit_cycle import ModalLimitCycle, ModalMotion
from via_controllers.arms.modal_limit_cycle_vsa import Swing, VsaModalLimitCycle
from via_controllers.arms.modal_transform import ModalBasis, first_basis
from via_controllers.arms.self_start import START, turned
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.robots.arm import ArmState

from via_validation.control.arm_run import PERIOD, ArmRun, Phase, TorqueNoise, run_arm

DAMPING_RATIO, GAIN, BANDWIDTH = 0.7, 3.0, 100.0  # xi, k_V [s/(kg m^2)], omega_tau [rad/s]
PUSH = 0.5  # [-] initial deflection over the cycle's amplitude
ALONG = 1e-5  # [s] step of the central difference of the initial torque


def limit_cycle_controller(
    mode: int, gain: float = GAIN, damping_ratio: float = DAMPING_RATIO, start: float = START
) -> VsaModalLimitCycle:
    """The controller on mode k = `mode`, 0 the softest; `start` = 0: as published, it waits for a push."""
    cycle = ModalLimitCycle(ARM, EQUILIBRIUM, STIFFNESS, mode, damping_ratio, gain, LEVEL, start)
    return VsaModalLimitCycle(cycle, BANDWIDTH)


def loaded_state(arm: VsaArm, q: Array, velocity: Array, spring_torque: Array, spring_rate: Array) -> ArmState:
    """State with spring torques tau_e `spring_torque` [N m] that change at `spring_rate` [N m/s], (n,) each."""
    phi = arm.deflection(spring_torque)
    _, stiffness, _ = arm.spring_state(phi)
    return ArmState(q, velocity, q - phi, velocity - spring_rate / stiffness)


def start(controller: VsaModalLimitCycle, share: float = PUSH) -> ArmState:
    """Initial state at rest, deflected by `share` of the cycle's amplitude, with the spring torques demanded there."""
    cycle, arm = controller.cycle, controller.cycle.arm
    z, still = np.zeros(arm.n), np.zeros(arm.n)
    z[cycle.mode] = share * np.sqrt(2.0 * cycle.level)
    q = cycle.equilibrium + first_basis(arm.inertia(cycle.equilibrium), cycle.stiffness).W @ z
    motion = cycle.at(cycle.init(q), q, still)
    ahead, behind = (cycle.at(motion.basis, q, s * motion.acceleration).torque for s in (ALONG, -ALONG))
    return loaded_state(arm, q, still, -motion.torque, -(ahead - behind) / (2.0 * ALONG))


def approach(share: float, gain: float, level: float, eigenvalue: float, time: float) -> float:
    """h = H / H_d [-], averaged over a cycle, `time` [s] after the value `share` > 0 (`modal_limit_cycle`)."""
    return 1.0 / (1.0 + (1.0 / share - 1.0) * exp(-gain * eigenvalue * level * time))


def least_share(after: float, gain: float, level: float, eigenvalue: float, time: float) -> float:
    """The least h(0) [-] from which h reaches `after` within `time` [s]: `approach` backwards in time."""
    return approach(after, gain, level, eigenvalue, -time)


@dataclass(frozen=True)
class CycleCourse:
    """Modal quantities of a run, N samples."""

    H: Array  # (N,) H / H_d - 1 [-]
    leak: Array  # (N,) largest of the other modes over mode k's amplitude [-]
    z: Array  # (N,) mode k
    eigenvalue: Array  # (N,) of mode k [1/s^2]

    @property
    def late(self) -> slice:
        """The second half of the run."""
        return slice(len(self.H) // 2, None)

    def frequencies(self) -> tuple[float, float]:
        """Frequency of z_k by its upward zeros, and sqrt(mean lambda_k) / 2 pi of the same cycles [Hz]; second half."""
        z, values = self.z[self.late], self.eigenvalue[self.late]
        up = np.flatnonzero((z[:-1] < 0.0) & (z[1:] >= 0.0))
        zeros = (up + z[up] / (z[up] - z[up + 1])) * PERIOD
        return 1.0 / float(np.diff(zeros).mean()), float(np.sqrt(values[up[0] : up[-1]].mean())) / (2.0 * np.pi)


def cycling(
    controller: VsaModalLimitCycle, duration: float, share: float = PUSH, noise: TorqueNoise | None = None
) -> ArmRun[Swing]:
    """Run the controller on its arm from `start` for `duration` [s]; `noise` as for `run_arm`."""
    return run_arm(controller.cycle.arm, controller, start(controller, share), (Phase(duration),), noise=noise)


def in_modes(cycle: ModalLimitCycle, q: Array, velocity: Array) -> CycleCourse:
    """Modal quantities of the motion q (N, n) [rad], qd (N, n) [rad/s] of `cycle.arm`.

    That arm is the one that moved. The controller's model may differ from it, its own H and z are then not the arm's.
    """
    basis, seen = cycle.init(q[0]), []
    for angles, speeds in zip(q, velocity, strict=True):
        seen.append(cycle.at(basis, angles, speeds))
        basis = seen[-1].basis
    return _course(cycle, seen)


def _course(cycle: ModalLimitCycle, seen: Sequence[ModalMotion]) -> CycleCourse:
    z = np.array([motion.z for motion in seen])
    return CycleCourse(
        H=np.array([motion.H for motion in seen]) / cycle.level - 1.0,
        leak=np.abs(np.delete(z, cycle.mode, axis=1)).max(axis=1) / cycle.amplitude,
        z=z[:, cycle.mode],
        eigenvalue=np.array([motion.basis.eigenvalues[cycle.mode] for motion in seen]),
    )


def rigid(cycle: ModalLimitCycle, duration: float, step: float = 2e-3, others: float = 0.03) -> CycleCourse:
    """Control of a rigid arm in continuous time, evaluated at every stage of Runge-Kutta steps of `step` [s].

    The run starts at rest at half of the amplitude, with the other modes at `others` [sqrt(kg m^2) rad].
    """
    arm, k, n = cycle.arm, cycle.mode, cycle.arm.n
    z0 = np.full(n, others)
    z0[k] = 0.5 * np.sqrt(2.0 * cycle.level)
    q = cycle.equilibrium + first_basis(arm.inertia(cycle.equilibrium), cycle.stiffness).W @ z0
    v, h, basis, direction, seen = np.zeros(n), step, cycle.init(q), 0.0, []
    for _ in range(round(duration / step)):
        motion = cycle.at(basis, q, v, direction)
        basis, rate = motion.basis, motion.turning
        seen.append(motion)
        later = turned(direction, rate, 0.5 * h)

        def pulled(q: Array, v: Array, direction: float = later, near: ModalBasis = basis) -> Array:
            return arm.link_acceleration(q, v, cycle.at(near, q, v, direction).torque)

        direction = turned(direction, rate, h)
        a1 = arm.link_acceleration(q, v, motion.torque)
        a2 = pulled(q + 0.5 * h * v, v + 0.5 * h * a1)
        a3 = pulled(q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2)
        a4 = pulled(q + h * v + 0.5 * h * h * a2, v + h * a3, direction)
        q, v = q + h * v + h * h / 6.0 * (a1 + a2 + a3), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return _course(cycle, seen)
