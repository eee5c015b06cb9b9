"""Energy of a cycle: motors of flexible joints compared with the same motors on rigid joints, on the same trajectory.

Positive work of the motors, joint by joint, without recuperation and without transfer between motors:

    flexible   E   = sum_i integral of max(0, tau_i thd_i)        torques and motor angles of the run
    rigid      E_r = sum_i integral of max(0, tau_r,i qd_i)       computed torque for the same q(t):
               tau_r = (M + B) qdd + C qd + Dq qd + g

The springs save the fraction 1 - E / E_r. The rotor of a rigid joint turns with its link, hence B; `links_only` leaves
it out. Torques have zero-order hold, so that tau_i (theta_i(k+1) - theta_i(k)) is the work of one sample; tau_r is the
mean of both ends of a sample. qdd follows from the springs' torques in the simulation, not from differences.

For the limit cycle, K_d = c diag(K_0), K_0 the springs' stiffness without load. K_d matches the springs for the c at
which mode k has the stiffness of the arm with its motors held,

    c = w' (sigma + dg/dq) w / w' diag(K_0) w   at rest,   w mode k

Then the motors do the least work. With three times this stiffness they work against their own springs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from via_bringup.demo.reference import damped_arm
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.arms.modal_transform import first_basis
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_validation.control.arm_run import ArmRun
from via_validation.control.bang_bang import FreeMotion
from via_validation.control.cycles import Cycles
from via_validation.control.limit_cycle import cycling, limit_cycle_controller


@dataclass(frozen=True)
class Energy:
    """Positive work per cycle [J], mean over whole cycles."""

    flexible: float  # E
    rigid: float  # E_r
    links_only: float  # E_r for massless rotors
    cycles: int
    saturated: float  # share of samples at which a torque was clipped

    @property
    def ratio(self) -> float:
        """E / E_r [-]."""
        return self.flexible / self.rigid

    @property
    def ratio_links_only(self) -> float:
        """E over E_r for massless rotors [-]."""
        return self.flexible / self.links_only


def positive_work(torque: Array, angles: Array) -> Array:
    """(N - 1,) [J] positive work of each sample, from `torque` (N - 1, n) [N m] and `angles` (N, n) [rad]."""
    return np.asarray(np.maximum(0.0, torque * np.diff(angles, axis=0)).sum(axis=1))


def rigid_torque(arm: VsaArm, run: ArmRun, rotors: bool = True) -> Array:
    """tau_r (N, n) [N m] of rigid joints on the trajectory of `run`, which has no contacts; `rotors`: include B."""
    B, out = arm.motor_inertia * rotors, np.empty_like(run.q)
    for k, (q, v, theta) in enumerate(zip(run.q, run.velocity, run.theta, strict=True)):
        tau_e, _, _ = arm.spring_state(q - theta)
        # M qdd + C qd + Dq qd + g equals the springs' torque.
        out[k] = -tau_e + B * arm.link_acceleration(q, v, -tau_e)
    return out


def energy(arm: VsaArm, run: ArmRun, phase: Array) -> Energy:
    """Energy per cycle of `phase` (N,), which crosses zero upwards once per cycle."""
    cycles = Cycles(run.time, phase)
    first, last = cycles.first[0], cycles.first[-1]
    count = len(cycles.first) - 1

    def each(torque: Array, angles: Array) -> float:
        return float(positive_work(torque, angles)[first:last].sum()) / count

    whole, links = (rigid_torque(arm, run, rotors) for rotors in (True, False))
    return Energy(
        flexible=each(run.torque[:-1], run.theta),
        rigid=each(0.5 * (whole[1:] + whole[:-1]), run.q),
        links_only=each(0.5 * (links[1:] + links[:-1]), run.q),
        cycles=count,
        saturated=run.saturated,
    )


def matched(controller: VsaModalLimitCycle) -> float:
    """The matching factor c for the controller's mode; its K_d must be diag(K_0)."""
    cycle, arm = controller.cycle, controller.cycle.arm
    q = cycle.equilibrium
    _, stiffness, _ = arm.spring_state(q - arm.rest(q))
    w = first_basis(arm.inertia(q), cycle.stiffness).W[:, cycle.mode]
    return float(w @ (np.diag(stiffness) + arm.gravity_slope(q)) @ w / (w @ cycle.stiffness @ w))


def limit_cycle_energy(
    mode: int, stiffness: float = 1.0, level: float | None = None, duration: float = 4.0
) -> tuple[float, Energy]:
    """c, and the energy of the limit cycle on mode k = `mode`, 0 the softest, in the second half of `duration` [s].

    stiffness  [-] factor on the matched K_d
    level      H_d [kg m^2]; None: level of the reference set-up
    """
    controller = limit_cycle_controller(mode)
    c = stiffness * matched(controller)
    return c, scaled_energy(controller, c, level, duration)


def scaled_energy(
    controller: VsaModalLimitCycle, c: float, level: float | None = None, duration: float = 4.0
) -> Energy:
    """Energy of the cycle with c times the controller's K_d; the arm starts on the cycle, at a turning point."""
    cycle = replace(controller.cycle, stiffness=c * controller.cycle.stiffness, level=level or controller.cycle.level)
    late = cycling(replace(controller, cycle=cycle), duration, share=1.0).since(0.5 * duration)
    return energy(cycle.arm, late, late.quantity(f"z_{cycle.mode + 1}"))


def bang_bang_energy(motion: FreeMotion) -> Energy:
    """Energy of the free motion of Section 6.2 in the second half of its run."""
    late = motion.run.since(0.5 * float(motion.run.time[-1]))
    return energy(damped_arm(), late, late.quantity("y"))
