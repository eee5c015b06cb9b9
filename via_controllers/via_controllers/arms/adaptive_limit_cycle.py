"""Modal limit cycle whose model is corrected while it runs: payload at the tip, friction of links, scales of springs.

    M, C, g      those of the file plus a point mass x_0 at the tip
    Dq           of joint i: that of the file plus c_i
    tau_e, sigma of joint i: those of the file times exp(x_i)

x and c follow estimates as `correction` describes; with 0 it is `modal_limit_cycle_vsa` itself. Payload and friction
are estimated as such; x_i comes from an estimate of the joint's stiffness, divided by that of the spring law at the
same deflection. K_d, q_d and H_d remain those of the parameters: the arm moves in its modes with payload, on the same
level H_d.

With x and c within delta of the truth the links accelerate by qdd + O(delta) for the wanted qdd. (103) becomes
Hd = -k_V (H - H_d) zd_k^2 + O(delta) zd_k, so that |H - H_d| and the other modes, which are damped, are ultimately
bounded in proportion to delta, which vanishes with the estimator's error. The changing model adds x' times a bounded
torque: the motion stays slow against it because |x'| is bounded. Limits of torque, speed and deflection are enforced
from the file's model (`arm_limits`) and do not depend on x, but for the prediction of late torques (`delay`).
Source: certainty equivalence with estimates from equations of the plant, as in indirect adaptive control (Slotine and
Li, Applied Nonlinear Control, Section 9.2), applied to the document's Section 6.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, log

import numpy as np
from via_core.signals import Array
from via_core.status import Status
from via_core.vsa_arms import VsaArm

from via_controllers.arms.modal_limit_cycle_vsa import Swing, VsaModalLimitCycle
from via_controllers.contract import ArmController, ArmSample, Quantity, Torques, passive
from via_controllers.correction import Correction, CorrectionRule

OLDEST = 0.02  # [s] age of a stiffness estimate up to which the deflection is extrapolated backward


@dataclass(frozen=True)
class AdaptiveSwing:
    """State after a sample."""

    swing: Swing
    measured: float  # [s] stamp of the sample, which may be predicted
    arm: VsaArm  # the model used for it
    payload: Correction  # [kg]
    friction: tuple[Correction, ...]  # of each link, beyond the file's [N m s/rad]
    springs: tuple[Correction, ...]  # log of each spring's scale [-]
    deflection: Array  # (n,) [rad] at the last sample
    deflection_rate: Array  # (n,) [rad/s]


@dataclass(frozen=True, eq=False)
class AdaptiveLimitCycle(ArmController[AdaptiveSwing]):
    """`published` with a corrected model; the rules bound payload [kg], friction [N m s/rad] and log scales [-]."""

    published: VsaModalLimitCycle
    payload_rule: CorrectionRule
    friction_rule: CorrectionRule
    spring_rule: CorrectionRule

    @property
    def arm(self) -> VsaArm:
        """The arm of the file."""
        return self.published.cycle.arm

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        joints = range(1, self.arm.n + 1)
        friction = (Quantity(f"link_friction_{joint}", "N m s/rad") for joint in joints)
        scales = (Quantity(f"spring_scale_{joint}", "-") for joint in joints)
        return (*self.published.quantities, Quantity("payload", "kg"), *friction, *scales)

    def observe(self, state: AdaptiveSwing) -> Array:
        friction, scales = [each.value for each in state.friction], [exp(each.value) for each in state.springs]
        return np.concatenate([self.published.observe(state.swing), [state.payload.value, *friction, *scales]])

    def init(self, sample: ArmSample) -> AdaptiveSwing:
        none, each = Correction(), (Correction(),) * self.arm.n
        measured = sample.time - sample.lead
        return AdaptiveSwing(self.published.init(sample), measured, self.arm, none, each, each, *_deflected(sample))

    def model(self, state: AdaptiveSwing) -> VsaArm:
        return state.arm

    def step(self, state: AdaptiveSwing, sample: ArmSample) -> tuple[AdaptiveSwing, Torques]:
        if not sample.valid:
            return state, passive(self.arm.n)
        now = sample.time - sample.lead
        passed = max(now - state.measured, 0.0)
        payload = self.payload_rule.advanced(state.payload, now, passed)
        friction = tuple(self.friction_rule.advanced(each, now, passed) for each in state.friction)
        springs = tuple(self.spring_rule.advanced(each, now, passed) for each in state.springs)
        controller = self.controller_for(payload, friction, springs)
        swing, torques = controller.step(state.swing, sample)
        return AdaptiveSwing(swing, now, controller.cycle.arm, payload, friction, springs, *_deflected(sample)), torques

    def controller_for(
        self, payload: Correction, friction: tuple[Correction, ...], springs: tuple[Correction, ...]
    ) -> VsaModalLimitCycle:
        """The controller with this model; `published` itself without any correction."""
        more, logs = [each.value for each in friction], [each.value for each in springs]
        if payload.value == 0.0 and not any(more) and not any(logs):
            return self.published
        viscous = np.maximum(more, -self.arm.link_friction)  # links dissipate
        return self.published.on(self.arm.corrected(payload.value, np.exp(logs), viscous))

    def with_payload(
        self, state: AdaptiveSwing, stamp: float, status: Status, value: Array, standard_deviation: Array
    ) -> AdaptiveSwing:
        """`state` with an estimate of payload [kg] and friction of the links [N m s/rad], (1 + n,), at `stamp` [s].

        Stamps are in the time of samples.
        """
        payload = self.payload_rule.informed(state.payload, stamp, status, value[0], standard_deviation[0])
        found = zip(state.friction, value[1:], standard_deviation[1:], strict=True)
        friction = tuple(self.friction_rule.informed(each, stamp, status, *estimate) for each, *estimate in found)
        return replace(state, payload=payload, friction=friction)

    def with_stiffness(
        self, state: AdaptiveSwing, joint: int, stamp: float, status: Status, value: float, standard_deviation: float
    ) -> AdaptiveSwing:
        """`state` with an estimate of a joint's stiffness [N m/rad], `joint` from 0, as in `with_payload`."""
        age = state.measured - stamp
        phi = state.deflection - (state.swing.time - stamp) * state.deflection_rate
        nominal = float(self.arm.spring_state(phi)[1][joint])
        good = status == Status.OK and value > 0.0 and nominal > 0.0 and abs(age) <= OLDEST
        ratio, relative_sd = (log(value / nominal), standard_deviation / value) if good else (0.0, 0.0)
        usable = status if good or status != Status.OK else Status.BAD_SAMPLE
        changed = self.spring_rule.informed(state.springs[joint], stamp, usable, ratio, relative_sd)
        springs = (*state.springs[:joint], changed, *state.springs[joint + 1 :])
        return replace(state, springs=springs)


def _deflected(sample: ArmSample) -> tuple[Array, Array]:
    """Deflections [rad] and their rates [rad/s], (n,) each."""
    return sample.q - sample.theta, sample.q_velocity - sample.theta_velocity
