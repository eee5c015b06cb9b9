"""Section 6.2 in free motion on the 4-dof arm: convergence to a mode, and regularity of the cycle.

The arm is linearised where it hangs at theta_0: (K + dg/dq, M), K the springs' stiffness under gravity. Its links have
the viscous friction d_i = 2 zeta sqrt(K_i M_ii) at rest.

From a w_1(0) that only selects joints, w_1 converges to modes 1 and 2 and stays there. The frequencies of modes 3 and 4
differ by 3 %, while friction makes the resonances 10 % wide: switching along either mode excites both, and w_1 stays in
their plane but on neither. The controller can only find motions of the arm at the actual amplitude (`nonlinear_mode`).
At this swing the nonlinear mode that grows out of mode 4 differs from it by 13 degrees; w_1 ends there, from mode 3 too
after a minute or more. Started on mode 3 or 4 with a third of the amplitude (`size`), w_1 stays on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from via_bringup.demo.reference import DIRECTIONS, MOTORS, damped_arm, linear_modes
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.motor_pd import MotorPd
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.robots.arm import ArmState

from via_validation.control.arm_run import ArmRun, Phase, run_arm
from via_validation.control.cycles import Cycles, relative_sd

BANDWIDTH = 60.0  # omega_m [rad/s]
AMPLITUDE = 0.03  # theta_hat [rad]
THRESHOLD = 0.5  # epsilon [N m]
ADAPTATION = 50.0  # gamma [1/(rad^2 s)]: .05 per sample of a millisecond
PUSH = 0.1  # [rad] initial deflection along w_1(0)


@dataclass(frozen=True)
class FreeMotion:
    """Results of number 5 of the specification, over the second half of a run."""

    mode: int  # 1 is the softest
    direction: Array  # w_1 (n,) at the end, of unit length
    angle: float  # [deg] between w_1 and the mode
    frequency: float  # [Hz]
    ratio: float  # f / f_lin
    period_sd: float  # std / mean
    swing: float  # [rad] peak to peak of w_1' (q - q_0)
    cycles: int
    run: ArmRun


def degrees_between(a: Array, b: Array) -> float:
    """Angle [deg], 0 to 90, between the lines along `a` and `b` (n,), both nonzero."""
    return float(np.degrees(np.arccos(min(1.0, float(abs(a @ b) / np.sqrt((a @ a) * (b @ b)))))))


def reference_controller(arm: VsaArm, direction: Array) -> ModalBangBang:
    """The controller of the reference set-up; `direction` is w_1(0) (n,)."""
    motors = np.array(MOTORS)
    hold = MotorPd(arm, motors, arm.hanging(motors), BANDWIDTH)
    return ModalBangBang(hold, direction, AMPLITUDE, THRESHOLD, ADAPTATION)


def pushed(controller: ModalBangBang) -> ArmState:
    """Links at rest, deflected by `PUSH` along w_1(0) from the hanging posture."""
    still = np.zeros(controller.motors.drives.n)
    return ArmState(controller.motors.equilibrium + PUSH * controller.direction, still, controller.motors.motors, still)


def free_motion(mode: int, duration: float = 20.0, on_mode: bool = False, size: float = 1.0) -> FreeMotion:
    """Number 5 for `duration` [s].

    on_mode  w_1(0) is the linear mode instead of the direction in `DIRECTIONS`
    size     [-] factor on theta_hat and epsilon, and thereby on the swing
    """
    arm = damped_arm()
    linear = linear_modes(arm, np.array(MOTORS))
    controller = reference_controller(arm, linear.directions[:, mode - 1] if on_mode else np.array(DIRECTIONS[mode]))
    controller = replace(controller, amplitude=size * controller.amplitude, threshold=size * controller.threshold)
    whole = run_arm(arm, controller, pushed(controller), (Phase(duration),))
    late = whole.since(0.5 * duration)
    w = late.values[-1, 3:] / np.linalg.norm(late.values[-1, 3:])
    cycles = Cycles(late.time, late.values[:, 0])
    frequency, nearest = 1.0 / float(cycles.periods.mean()), linear.directions[:, mode - 1]
    return FreeMotion(
        mode=mode,
        direction=w,
        angle=degrees_between(w, nearest),
        frequency=frequency,
        ratio=frequency / float(linear.frequencies[mode - 1]),
        period_sd=relative_sd(cycles.periods),
        swing=float(cycles.swings.mean()),
        cycles=len(cycles.periods),
        run=whole,
    )
