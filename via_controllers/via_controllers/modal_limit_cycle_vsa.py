"""The modal limit cycle on an arm of flexible joints: the rigid arm's torque is what the springs are made to give.

`modal_limit_cycle` says what must drive the links, tau(q, qd); tau_ed = -tau is the reference of `flexibility_torque`,
which also needs its derivatives by time. They are those of the law along the motion to come, which is known well:

    M qdd + C qd + g = -tau_e,   M qddd + (d/dt of the left side at constant qdd) = -tau_e',   q(t + s) to third order

with tau_e and its rate measured; the law is evaluated `spread` before and after and differenced.
Source: the document's Section 6.1, (107), which leaves the derivatives to the reader.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmController, ArmSample, Quantity, Torques, blind, require
from via_controllers.flexibility_torque import FlexibilityState, FlexibilityTorque, TorqueReference
from via_controllers.modal_limit_cycle import ModalLimitCycle, ModalMotion

ALONG = 1e-5  # [s] to either side: derivative of the links' equation along the motion


@dataclass(frozen=True, eq=False)
class VsaModalLimitCycle(ArmController[ModalMotion]):
    """The law of this file. Raises ParameterError for a bandwidth or spread <= 0."""

    cycle: ModalLimitCycle
    bandwidth: float  # omega_tau [rad/s] of the springs' torques
    spread: float = 2e-3  # [s]

    def __post_init__(self) -> None:
        require(self.spread > 0.0, f"spread must be > 0 s, got {self.spread}")
        _ = self.tracking

    @cached_property
    def tracking(self) -> FlexibilityTorque:
        """The law of the springs' torques."""
        return FlexibilityTorque(self.cycle.arm, self.bandwidth)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        modes = range(1, self.cycle.arm.n + 1)
        return (
            Quantity("H", "kg m^2"),
            Quantity("V", "kg^2 m^4"),
            *(Quantity(f"z_{mode}", "sqrt(kg m^2) rad") for mode in modes),
            *(Quantity(f"frequency_{mode}", "Hz") for mode in modes),
        )

    def told(self, state: ModalMotion) -> Array:
        return np.array([state.H, state.V, *state.z, *(np.sqrt(state.basis.eigenvalues) / (2.0 * np.pi))])

    def init(self, sample: ArmSample) -> ModalMotion:
        return self.cycle.at(self.cycle.init(sample.q), sample.q, sample.q_velocity)

    def step(self, state: ModalMotion, sample: ArmSample) -> tuple[ModalMotion, Torques]:
        if blind(sample):
            return state, Torques(np.zeros(self.cycle.arm.n), False)
        motion = self.cycle.at(state.basis, sample.q, sample.q_velocity)
        seen = self.tracking.observed(sample)
        return motion, self.tracking.torques(sample, seen, self.reference(motion, sample, seen))

    def reference(self, motion: ModalMotion, sample: ArmSample, seen: FlexibilityState) -> TorqueReference:
        """tau_ed and its derivatives at the sample, where the law wants `motion`."""
        q, v, a, jerk = sample.q, sample.q_velocity, seen.acceleration, self.link_jerk(sample, seen)
        around = []
        for s in (-self.spread, self.spread):
            around.append(-self.cycle.at(motion.basis, *_moved(q, v, a, jerk, s)).torque)
        behind, ahead = around
        rate, second = (ahead - behind) / (2.0 * self.spread), (ahead + 2.0 * motion.torque + behind) / self.spread**2
        return TorqueReference(-motion.torque, rate, second)

    def link_jerk(self, sample: ArmSample, seen: FlexibilityState) -> Array:
        """qddd (n,) [rad/s^3] of the links."""
        arm, v, a = self.cycle.arm, sample.q_velocity, seen.acceleration
        ahead, behind = (arm.link_torque(sample.q + s * v, v + s * a, a) for s in (ALONG, -ALONG))
        change = -seen.rate - (ahead - behind) / (2.0 * ALONG)
        # M^-1 of a torque is what it does to the arm at rest, gravity held
        return arm.link_acceleration(sample.q, np.zeros(arm.n), change + arm.gravity(sample.q))


@njit(cache=True, error_model="numpy")
def _moved(q: Array, v: Array, a: Array, jerk: Array, s: float) -> tuple[Array, Array]:
    """Angles and velocities (n,) `s` [s] later, to third order."""
    return q + s * (v + s * (a / 2.0 + s * jerk / 6.0)), v + s * (a + s * jerk / 2.0)
