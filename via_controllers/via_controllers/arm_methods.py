"""Parameters of the controllers of arms, each declared once, and the controllers built from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log
from typing import Any

import numpy as np
from via_core.hopper import JOINTS, Hopper
from via_core.parameters import parameter
from via_core.vsa_arms import load_vsa_arm

from via_controllers.arms.adaptive_limit_cycle import AdaptiveLimitCycle
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.modal_limit_cycle import ModalLimitCycle
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.arms.motor_pd import MotorPd
from via_controllers.arms.orbit_demand import require_possible
from via_controllers.arms.self_start import START
from via_controllers.contract import require
from via_controllers.correction import LARGEST_FACTOR, CorrectionRule
from via_controllers.robot import ControlledArm, ControllerParameters, joint_values
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import Supervisor


@dataclass(frozen=True)
class ModalLimitCycleParameters(ControllerParameters):
    """Parameters of `modal_limit_cycle_vsa`, or with `adapt` of `adaptive_limit_cycle`, which subscribes to estimates.

    The default `level` suits the soft modes of reference_4dof. A level that motors or springs cannot give is refused,
    with the largest one.
    """

    arm: str = parameter("reference_4dof", "arm name or path to its YAML")
    equilibrium: tuple[float, ...] = parameter((0.2, 0.4, 0.3, 1.2), "q_d, link angles at the equilibrium", "rad")
    stiffness: tuple[float, ...] = parameter((), "diagonal of K_d; empty: stiffness of the springs at rest", "N m/rad")
    mode: int = parameter(1, "mode that swings, 1 is the softest", "", (1, 64))
    damping_ratio: float = parameter(0.7, "xi of the other modes", "-", (1e-3, 10.0), live=True)
    gain: float = parameter(3.0, "k_V, rate at which H converges to H_d", "s/(kg m^2)", (1e-6, 1e6), live=True)
    level: float = parameter(0.02, "H_d, half the squared amplitude of z", "kg m^2", (1e-9, 1e3), live=True)
    start: float = parameter(
        START, "shift of the rest position that starts the motion, over the amplitude; 0: wait for a push", "-", (0, 1)
    )
    bandwidth: float = parameter(100.0, "omega_tau of the spring torque control", "rad/s", (1.0, 1e4))
    adapt: bool = parameter(False, "correct payload and springs of the model by estimators")
    correction_time: float = parameter(0.5, "T, mean delay of the correction", "s", (1e-2, 1e4))
    fallback_time: float = parameter(
        1.0, "time constant at which the correction ends while an estimator is not OK", "s", (1e-2, 1e6)
    )
    trusted_deviation: float = parameter(
        0.1, "S, relative standard deviation at which a stiffness estimate has half weight", "-", (1e-3, 10.0)
    )
    trusted_payload: float = parameter(
        0.2, "S, standard deviation at which a payload estimate has half weight", "kg", (1e-6, 1e3)
    )
    trusted_friction: float = parameter(
        0.1, "S, standard deviation at which the friction of a link has half weight", "N m s/rad", (1e-9, 1e3)
    )
    heaviest: float = parameter(5.0, "largest payload that the model is corrected for", "kg", (0.0, 1e3))
    most_friction: float = parameter(
        2.0, "largest change of a link's viscous friction that the model is corrected for", "N m s/rad", (0.0, 1e3)
    )

    def adaptive(self) -> AdaptiveLimitCycle:
        """The controller that corrects its model; raises ParameterError or DeviceError."""
        times, scale = (self.correction_time, self.fallback_time), log(LARGEST_FACTOR)
        return AdaptiveLimitCycle(
            self.controller(),
            CorrectionRule(*times, self.trusted_payload, 0.0, self.heaviest),
            CorrectionRule(*times, self.trusted_friction, -self.most_friction, self.most_friction),
            CorrectionRule(*times, self.trusted_deviation, -scale, scale),
        )

    def build(self) -> ControlledArm:
        published = self.controller()
        require_possible(published.cycle)
        controller: Any = self.adaptive() if self.adapt else published
        return ControlledArm.with_holding(load_vsa_arm(self.arm), controller)

    def controller(self) -> VsaModalLimitCycle:
        """The controller with the model of the file; raises ParameterError or DeviceError."""
        arm = load_vsa_arm(self.arm)
        stiffness = self.stiffness or tuple(arm.spring_state(np.zeros(arm.n))[1])
        own = {
            "arm": arm,
            "equilibrium": joint_values("equilibrium", self.equilibrium, arm),
            "stiffness": np.diag(joint_values("stiffness", stiffness, arm)),
            "mode": self.mode - 1,
        }
        return VsaModalLimitCycle(ModalLimitCycle(**self.shared(ModalLimitCycle) | own), self.bandwidth)


@dataclass(frozen=True)
class BangBangParameters(ControllerParameters):
    """Parameters of `bang_bang` on an arm."""

    arm: str = parameter("reference_4dof", "arm name or path to its YAML")
    motors: tuple[float, ...] = parameter((0.2, 0.5, 0.3, 1.3), "theta_0, motor angles at the equilibrium", "rad")
    direction: tuple[float, ...] = parameter((0.0, 1.0, 0.0, 1.0), "w_1(0), initial direction of the swing", "-")
    bandwidth: float = parameter(60.0, "omega_m of the motor control", "rad/s", (1.0, 1e4))
    amplitude: float = parameter(0.03, "theta_hat, switching amplitude of the motors", "rad", (0.0, 10.0), live=True)
    threshold: float = parameter(0.5, "epsilon, least |tau_z| at which the motors switch", "N m", (0.0, 1e6), live=True)
    adaptation: float = parameter(50.0, "gamma, adaptation rate of w_1", "1/(rad^2 s)", (0.0, 1e6), live=True)

    def build(self) -> ControlledArm:
        arm = load_vsa_arm(self.arm)
        motors, direction = joint_values("motors", self.motors, arm), joint_values("direction", self.direction, arm)
        hold = MotorPd(arm, motors, arm.hanging(motors), self.bandwidth)
        controller = ModalBangBang(hold, direction, self.amplitude, self.threshold, self.adaptation)
        return ControlledArm.with_holding(arm, controller)


@dataclass(frozen=True)
class HoppingParameters(ControllerParameters):
    """Parameters of `bang_bang` on the hopper; while inactive the hopper stands on its springs."""

    crouch: float = parameter(0.6, "a_0, angle of the thighs from the vertical", "rad", (0.01, 1.5))
    bandwidth: float = parameter(120.0, "omega_m of the motor control", "rad/s", (1.0, 1e4))
    amplitude: float = parameter(0.1, "theta_hat, switching amplitude of the motors", "rad", (0.0, 10.0), live=True)
    threshold: float = parameter(1.0, "epsilon, least |tau_z| at which the motors switch", "N m", (0.0, 1e6), live=True)
    adaptation: float = parameter(50.0, "gamma, adaptation rate of w_1", "1/(rad^2 s)", (0.0, 1e6), live=True)

    def build(self) -> ControlledArm:
        require(self.delay == 0.0, "delay: contacts of the feet cannot be predicted; leave it 0")
        legs = Hopper()
        motors = legs.crouched(self.crouch)
        hold = MotorPd(legs, motors, legs.standing(self.crouch), self.bandwidth)
        controller = ModalBangBang(hold, np.sign(motors), self.amplitude, self.threshold, self.adaptation)
        holding = replace(controller, amplitude=0.0)
        return ControlledArm("hopper", JOINTS, Supervisor(controller, holding, ArmLimits(legs)))
