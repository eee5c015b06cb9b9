"""Modal limit cycle of an arm of flexible joints: the springs provide the torque of the rigid arm's controller.

`modal_limit_cycle` gives the torque tau(q, qd) on the links; tau_ed = -tau is the reference of `flexibility_torque`,
which also needs its time derivatives. These are derivatives of the controller along the predicted motion:

    M qdd + C qd + g = -tau_e,   M qddd + (d/dt of the left side at constant qdd) = -tau_e',   q(t + s) to third order

with tau_e and its rate measured. The controller is evaluated `difference_step` before and after and differenced; the
direction of `self_start` turns likewise.
Source: the document's Section 6.1, (107), which does not state the derivatives.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_controllers.arms import self_start
from via_controllers.arms.flexibility_torque import FlexibilityState, FlexibilityTorque, TorqueReference
from via_controllers.arms.modal_limit_cycle import ModalLimitCycle, ModalMotion
from via_controllers.contract import ArmController, ArmSample, Quantity, Torques, passive, require

ALONG = 1e-5  # [s] step of the central difference of the links' equation along the motion
LONGEST = 0.01  # [s] longest time step of the direction; after a longer gap this step is used


@dataclass(frozen=True)
class Swing:
    """State after a sample."""

    motion: ModalMotion
    time: float  # [s]


@dataclass(frozen=True, eq=False)
class VsaModalLimitCycle(ArmController[Swing]):
    """The controller. Raises ParameterError for a bandwidth or difference step <= 0."""

    cycle: ModalLimitCycle
    bandwidth: float  # omega_tau [rad/s] of the spring torque control
    difference_step: float = 2e-3  # [s]

    def __post_init__(self) -> None:
        require(self.difference_step > 0.0, f"difference_step must be > 0 s, got {self.difference_step}")
        _ = self.tracking

    @cached_property
    def tracking(self) -> FlexibilityTorque:
        """The control of the spring torques."""
        return FlexibilityTorque(self.cycle.arm, self.bandwidth)

    def on(self, arm: VsaArm) -> VsaModalLimitCycle:
        """This controller with another model of the same arm (`VsaArm.corrected`), not validated again."""
        other, cycle = copy(self), copy(self.cycle)
        object.__setattr__(cycle, "arm", arm)
        object.__setattr__(other, "cycle", cycle)
        other.__dict__["tracking"] = FlexibilityTorque(arm, self.bandwidth)
        return other

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        modes = range(1, self.cycle.arm.n + 1)
        return (
            Quantity("H", "kg m^2"),
            Quantity("V", "kg^2 m^4"),
            Quantity("s", "sqrt(kg m^2) rad"),
            *(Quantity(f"z_{mode}", "sqrt(kg m^2) rad") for mode in modes),
            *(Quantity(f"frequency_{mode}", "Hz") for mode in modes),
        )

    def observe(self, state: Swing) -> Array:
        seen = state.motion
        return np.array([seen.H, seen.V, seen.push, *seen.z, *(np.sqrt(seen.basis.eigenvalues) / (2.0 * np.pi))])

    def init(self, sample: ArmSample) -> Swing:
        return Swing(self.cycle.at(self.cycle.init(sample.q), sample.q, sample.q_velocity), sample.time)

    def step(self, state: Swing, sample: ArmSample) -> tuple[Swing, Torques]:
        if not sample.valid:
            return state, passive(self.cycle.arm.n)
        before, passed = state.motion, min(max(sample.time - state.time, 0.0), LONGEST)
        direction = self_start.turned(before.direction, before.turning, passed)
        motion = self.cycle.at(before.basis, sample.q, sample.q_velocity, direction)
        seen = self.tracking.observed(sample)
        torques = self.tracking.torques(sample, seen, self.reference(motion, sample, seen))
        return Swing(motion, sample.time), torques

    def reference(self, motion: ModalMotion, sample: ArmSample, seen: FlexibilityState) -> TorqueReference:
        """tau_ed and its derivatives at the sample with the desired `motion`."""
        q, v, a, jerk = sample.q, sample.q_velocity, seen.acceleration, self.link_jerk(sample, seen)
        around = []
        for s in (-self.difference_step, self.difference_step):
            direction = self_start.turned(motion.direction, motion.turning, s)
            there, speed = _moved(q, v, a, jerk, s)
            around.append(self.cycle.at(motion.basis, there, speed, direction).torque)
        return TorqueReference(*_differenced(*around, motion.torque, self.difference_step))

    def link_jerk(self, sample: ArmSample, seen: FlexibilityState) -> Array:
        """qddd (n,) [rad/s^3] of the links."""
        arm, v, a = self.cycle.arm, sample.q_velocity, seen.acceleration
        ahead, behind = (arm.link_torque(sample.q + s * v, v + s * a, a) for s in (ALONG, -ALONG))
        change = -seen.rate - (ahead - behind) / (2.0 * ALONG)
        # M^-1 of a torque: the acceleration of the arm at rest with gravity compensated
        return arm.link_acceleration(sample.q, np.zeros(arm.n), change + arm.gravity(sample.q))


@njit(cache=True, error_model="numpy")
def _differenced(before: Array, after: Array, torque: Array, step: float) -> tuple[Array, Array, Array]:
    """tau_ed (n,) and its derivatives, from the desired link torques `step` [s] before, after, and now."""
    ahead, behind = -after, -before
    return -torque, (ahead - behind) / (2.0 * step), (ahead + 2.0 * torque + behind) / step**2


@njit(cache=True, error_model="numpy")
def _moved(q: Array, v: Array, a: Array, jerk: Array, s: float) -> tuple[Array, Array]:
    """Angles and velocities (n,) `s` [s] later, to third order."""
    return q + s * (v + s * (a / 2.0 + s * jerk / 6.0)), v + s * (a + s * jerk / 2.0)
