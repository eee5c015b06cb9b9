"""Section 6.2 in free motion on the 4-dof arm: does the law find a mode of the arm, and how regular is its cycle?

The arm hangs at theta_0 and is linearised there: (K + dg/dq, M), K the springs' stiffness under gravity. Its links have
the viscous friction d_i = 2 zeta sqrt(K_i M_ii) at rest.

Modes 1 and 2 are found from a w_1(0) that only names joints, and kept. Modes 3 and 4 are 3 % apart where friction makes
resonances 10 % wide: motors that switch along either move both, and w_1 stays in their plane but not on either. What a
law can find there are motions of the arm as it swings (`nonlinear_mode`). That which grows out of mode 4 has left it by
13 degrees at this swing, and there w_1 ends, in a minute or more also from mode 3. Started on a mode itself and with a
third of the amplitude (`size`) it stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from via_bringup.demo.reference import DIRECTIONS, MOTORS, damped_arm, linear_modes
from via_controllers.bang_bang import ModalBangBang
from via_controllers.motor_pd import MotorPd
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.arm import ArmState

from via_validation.control.arm_run import ArmRun, Phase, run_arm
from via_validation.control.cycles import Cycles, spread

BANDWIDTH = 60.0  # omega_m [rad/s]
AMPLITUDE = 0.03  # theta_hat [rad]
THRESHOLD = 0.5  # epsilon [N m]
ADAPTATION = 50.0  # gamma [1/(rad^2 s)]: .05 per sample of a millisecond
PUSH = 0.1  # [rad] along w_1(0), from which the arm is let go


@dataclass(frozen=True)
class FreeMotion:
    """Figures of number 5, over the second half of a run."""

    mode: int  # 1 the softest
    direction: Array  # w_1 (n,) at the end, of unit length
    angle: float  # [deg] between w_1 and the mode
    frequency: float  # [Hz]
    ratio: float  # f / f_lin
    period_spread: float  # std / mean
    swing: float  # [rad] peak to peak of w_1' (q - q_0)
    cycles: int
    run: ArmRun


def degrees_between(a: Array, b: Array) -> float:
    """Angle [deg] between the lines along `a` and `b` (n,), neither zero; 0 to 90."""
    return float(np.degrees(np.arccos(min(1.0, float(abs(a @ b) / np.sqrt((a @ a) * (b @ b)))))))


def reference_law(arm: VsaArm, direction: Array) -> ModalBangBang:
    """The law with the reference set-up; `direction` is w_1(0) (n,)."""
    motors = np.array(MOTORS)
    hold = MotorPd(arm, motors, arm.hanging(motors), BANDWIDTH)
    return ModalBangBang(hold, direction, AMPLITUDE, THRESHOLD, ADAPTATION)


def pushed(law: ModalBangBang) -> ArmState:
    """Links at rest, `PUSH` along w_1(0) off where they hang."""
    still = np.zeros(law.motors.drives.n)
    return ArmState(law.motors.equilibrium + PUSH * law.direction, still, law.motors.motors, still)


def free_motion(mode: int, duration: float = 20.0, on_mode: bool = False, size: float = 1.0) -> FreeMotion:
    """Number 5, for `duration` [s].

    on_mode  whether w_1(0) is the linear mode instead of that of `DIRECTIONS`
    size     of theta_hat and epsilon, and with them of the swing
    """
    arm = damped_arm()
    linear = linear_modes(arm, np.array(MOTORS))
    law = reference_law(arm, linear.directions[:, mode - 1] if on_mode else np.array(DIRECTIONS[mode]))
    law = replace(law, amplitude=size * law.amplitude, threshold=size * law.threshold)
    whole = run_arm(arm, law, pushed(law), (Phase(duration),))
    late = whole.since(0.5 * duration)
    w = late.told[-1, 3:] / np.linalg.norm(late.told[-1, 3:])
    cycles = Cycles(late.time, late.told[:, 0])
    frequency, nearest = 1.0 / float(cycles.periods.mean()), linear.directions[:, mode - 1]
    return FreeMotion(
        mode=mode,
        direction=w,
        angle=degrees_between(w, nearest),
        frequency=frequency,
        ratio=frequency / float(linear.frequencies[mode - 1]),
        period_spread=spread(cycles.periods),
        swing=float(cycles.swings.mean()),
        cycles=len(cycles.periods),
        run=whole,
    )
