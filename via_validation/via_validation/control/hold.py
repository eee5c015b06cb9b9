"""End effector of an arm on its limit cycle, held and released at phases all around the cycle: Section 6.3.

A hand holds the tip in place; the arm hardly moves, and H at the release is z_k^2 / 2. Held near z_k = 0 the arm starts
with almost no energy. The document's controller then converges slowly (`approach`), like any controller that is
continuous in z_k and zd_k alone; ours stores a direction (`self_start`) and pushes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from via_controllers.arms.self_start import START
from via_sim.robots.contacts import Hand

from via_validation.control.arm_run import PERIOD, Phase, run_arm
from via_validation.control.limit_cycle import GAIN, CycleCourse, cycling, in_modes, limit_cycle_controller

SETTLING, AFTER = 2.5, 2.5  # [s] before the first hold, after a release


@dataclass(frozen=True)
class Released:
    """Results of one hold and release."""

    phase: float  # [rad] of the cycle at the start of the hold: z_k ~ cos(phase)
    grip: float  # |z_k| at the start of the hold over the cycle's amplitude [-]
    share: float  # H / H_d at release [-]
    period: float  # [s] of the cycle
    eigenvalue: float  # lambda_k [1/s^2], mean over a cycle
    course: CycleCourse  # from the release on
    saturated: bool  # during the hold
    force: float  # [N] largest force on the hand in the second half of the hold

    def error(self, periods: float) -> float:
        """Largest |H / H_d - 1| later than `periods` periods after the release."""
        return float(np.abs(self.course.H[round(periods * self.period / PERIOD) :]).max())


def held_and_released(
    mode: int, phases: int, duration: float = 1.0, gain: float = GAIN, start: float = START
) -> Iterator[Released]:
    """Hold mode `mode` for `duration` [s] at `phases` evenly distributed phases of the cycle, and release it.

    gain, start  as for `limit_cycle_controller`
    """
    controller = limit_cycle_controller(mode, gain, start=start)
    arm = controller.cycle.arm
    run = cycling(controller, SETTLING, share=1.0)
    steady = in_modes(controller.cycle, run.q, run.velocity)
    period = 1.0 / steady.frequencies()[0]
    eigenvalue = float(steady.eigenvalue[-round(period / PERIOD) :].mean())
    for _ in range(phases):
        run = run_arm(arm, controller, run.body, (Phase(period / phases),), state=run.state)
        seen = run.state.motion
        z, speed = seen.z[mode], seen.z_velocity[mode] / np.sqrt(seen.basis.eigenvalues[mode])
        hand = Hand(arm.tip_position(run.body.q))
        held = run_arm(arm, controller, run.body, (Phase(duration, (hand,), 4),), run.state)
        free = run_arm(arm, controller, held.body, (Phase(AFTER),), state=held.state)
        after = in_modes(controller.cycle, free.q, free.velocity)
        force = float(np.linalg.norm(held.force[len(held.force) // 2 :], axis=1).max())
        phase, grip = float(np.arctan2(-speed, z)), abs(float(z)) / controller.cycle.amplitude
        yield Released(phase, grip, float(after.H[0]) + 1.0, period, eigenvalue, after, held.saturated > 0.0, force)
