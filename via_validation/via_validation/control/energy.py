"""What a cycle costs: motors of flexible joints against the same motors on rigid joints, on the same trajectory.

Work that motors put in, joint by joint, none of it recovered by a motor that brakes and none lent to another motor:

    flexible   E   = sum_i integral of max(0, tau_i thd_i)        torques and motor angles as they were
    rigid      E_r = sum_i integral of max(0, tau_r,i qd_i)       what computed torque needs for the same q(t):
               tau_r = (M + B) qdd + C qd + Dq qd + g

What E / E_r lacks of 1 is what springs save. A rigid joint turns its rotor with its link, hence B, which `links_only`
leaves out.
Torques are held for a sample, so that tau_i (theta_i(k+1) - theta_i(k)) is the work of one; tau_r is the mean of both
ends of it. qdd is that of the springs' torques in the simulation, not a difference.

Of the limit cycle, K_d = c diag(K_0), K_0 the springs' stiffness without load. Matched to the springs is the c with
which mode k has the stiffness of the arm whose motors stand still,

    c = w' (sigma + dg/dq) w / w' diag(K_0) w   at rest,   w mode k

Then motors have least to add; `stiffness` scales it: with three times as much they fight their own springs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from via_bringup.demo.reference import damped_arm
from via_controllers.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.modal_transform import first_basis
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_validation.control.arm_run import ArmRun
from via_validation.control.bang_bang import FreeMotion
from via_validation.control.cycles import Cycles
from via_validation.control.limit_cycle import cycling, law_of


@dataclass(frozen=True)
class Energy:
    """Work put in per cycle [J], means over whole cycles."""

    flexible: float  # E
    rigid: float  # E_r
    links_only: float  # E_r of rigid joints whose motors weigh nothing
    cycles: int
    saturated: float  # share of samples at which a torque was cut

    @property
    def ratio(self) -> float:
        """E / E_r [-]."""
        return self.flexible / self.rigid

    @property
    def ratio_links_only(self) -> float:
        """E over what rigid joints with weightless motors need [-]."""
        return self.flexible / self.links_only


def positive_work(torque: Array, angles: Array) -> Array:
    """(N - 1,) [J] put in from sample to sample: `torque` (N - 1, n) [N m] held while `angles` (N, n) [rad] change."""
    return np.asarray(np.maximum(0.0, torque * np.diff(angles, axis=0)).sum(axis=1))


def rigid_torque(arm: VsaArm, run: ArmRun, rotors: bool = True) -> Array:
    """tau_r (N, n) [N m] of rigid joints on the trajectory of `run`, a run without contacts; without B on request."""
    B, out = arm.motor_inertia * rotors, np.empty_like(run.q)
    for k, (q, v, theta) in enumerate(zip(run.q, run.velocity, run.theta, strict=True)):
        tau_e, _, _ = arm.spring_state(q - theta)
        # M qdd + C qd + Dq qd + g is what the springs gave
        out[k] = -tau_e + B * arm.link_acceleration(q, v, -tau_e)
    return out


def energy(arm: VsaArm, run: ArmRun, phase: Array) -> Energy:
    """Per cycle of `phase` (N,), which rises through zero once in each."""
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


def matched(law: VsaModalLimitCycle) -> float:
    """c of this file for the law's mode, its K_d being diag(K_0)."""
    cycle, arm = law.cycle, law.cycle.arm
    q = cycle.equilibrium
    _, stiffness, _ = arm.spring_state(q - arm.rest(q))
    w = first_basis(arm.inertia(q), cycle.stiffness).W[:, cycle.mode]
    return float(w @ (np.diag(stiffness) + arm.gravity_slope(q)) @ w / (w @ cycle.stiffness @ w))


def limit_cycle_energy(
    mode: int, stiffness: float = 1.0, level: float | None = None, duration: float = 4.0
) -> tuple[float, Energy]:
    """c and what the limit cycle on mode k = `mode`, 0 the softest, costs in the second half of `duration` [s].

    stiffness  of the matched K_d
    level      H_d [kg m^2]; None: that of the reference set-up
    """
    law = law_of(mode)
    c = stiffness * matched(law)
    return c, scaled_energy(law, c, level, duration)


def scaled_energy(law: VsaModalLimitCycle, c: float, level: float | None = None, duration: float = 4.0) -> Energy:
    """What the cycle costs with c times the law's K_d; the arm starts on it, at a turning point."""
    cycle = replace(law.cycle, stiffness=c * law.cycle.stiffness, level=level or law.cycle.level)
    late = cycling(replace(law, cycle=cycle), duration, share=1.0).since(0.5 * duration)
    return energy(cycle.arm, late, late.quantity(f"z_{cycle.mode + 1}"))


def bang_bang_energy(motion: FreeMotion) -> Energy:
    """What the free motion of Section 6.2 costs in the second half of its run."""
    late = motion.run.since(0.5 * float(motion.run.time[-1]))
    return energy(damped_arm(), late, late.quantity("y"))
