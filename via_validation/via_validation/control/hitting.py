"""Section 6.2 with impacts: the 4-dof arm hits a wall after a hand has released its tip.

The wall crosses the tip's path on mode 1 at a fraction of the free turning point. The hand holds the tip on the other
side, also at a fraction of the free turning point, for one second, and releases it. The controller has no model of wall
or hand. Figure 17 of the document shows such a motion on the DLR Hand Arm System.

Walls from .2 to .9 of the turning point gave the same result; a wall at .1 dissipates more than the motors supply, and
the motion stops. From a release far below the steady amplitude, the motion grows slowly against friction (`WEAK`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from via_bringup.demo.reference import DIRECTIONS, HITTING_MODE, WallScene, damped_arm, wall_scene
from via_core.signals import Array
from via_sim.robots.arm import ArmState
from via_sim.robots.contacts import Hand, Wall

from via_validation.control.arm_run import ArmRun, Phase, run_arm
from via_validation.control.bang_bang import reference_controller
from via_validation.control.cycles import Cycles, relative_sd

WALLS = (0.3, 0.5, 0.7)  # [-] of the turning point
HOLDS = (0.9, 1.05, 1.2)  # [-] of the turning point
WEAK = (0.5, 0.4)  # wall and hold of a case that needs more than one cycle to become steady
HELD = 1.0  # [s]
STEADY = 8  # last cycles, which count as steady
SUBSTEPS = 4  # per millisecond


@dataclass(frozen=True)
class Impacts:
    """Results of number 6; swings are peak to peak along the tip's path, cycles count from the release."""

    wall: float  # [-] of the turning point
    hold: float  # [-] of the turning point
    swings: Array  # (c,) [m] of each whole cycle after the release
    peaks: Array  # (c,) [N] largest contact force of each cycle
    frequency: float  # [Hz] of the steady cycles

    @property
    def steady(self) -> float:
        """Steady swing [m]."""
        return float(self.swings[-STEADY:].mean())

    @property
    def second(self) -> float:
        """Largest relative difference of a cycle from the second on from the steady swing [-]."""
        return float(np.abs(self.swings[1:] / self.steady - 1.0).max())

    @property
    def steady_sd(self) -> float:
        """std / mean of the steady swings [-]."""
        return relative_sd(self.swings[-STEADY:])

    @property
    def least_force(self) -> float:
        """Force of the weakest impact of the steady cycles [N]."""
        return float(self.peaks[-STEADY:].min())

    @property
    def cycles_to_steady(self) -> int:
        """Number of cycles after which the swing stays within 5 % of the steady swing."""
        off = np.flatnonzero(np.abs(self.swings / self.steady - 1.0) > 0.05)
        return int(off[-1]) + 1 if off.size else 0


@dataclass(frozen=True)
class Hitting(Impacts):
    """Results of a case, with its motion."""

    run: ArmRun
    tip: Array  # (N, 3) [m] in the base frame, whole run


def hitting(wall: float, hold: float, duration: float = 10.0) -> Hitting:
    """One case, for `duration` [s] after the release; wall and hold as fractions of the free turning point."""
    arm, scene = damped_arm(), wall_scene(wall, hold)
    controller = reference_controller(arm, np.array(DIRECTIONS[HITTING_MODE]))
    barrier, hand = Wall(scene.face, -scene.along), Hand(arm.tip_position(scene.start))
    still = np.zeros(arm.n)
    start = ArmState(scene.rest, still, controller.motors.motors, still)
    phases = (Phase(HELD, (hand, barrier), SUBSTEPS), Phase(duration, (barrier,), SUBSTEPS))
    run = run_arm(arm, controller, start, phases)
    tip = np.array([arm.tip_position(q) for q in run.q])
    free = run.since(HELD)
    return Hitting(wall, hold, *impacts(scene, free.time, tip[-len(free.time) :], free.force), run, tip)


def impacts(scene: WallScene, time: Array, tip: Array, force: Array) -> tuple[Array, Array, float]:
    """Swings, peaks and frequency of `Impacts`; time (N,) [s] from the release, tip (N, 3) [m], force (N, 3) [N]."""
    path = (tip - damped_arm().tip_position(scene.rest)) @ scene.along
    late = path[len(path) // 2 :]
    cycles = Cycles(time, path, 0.5 * float(late.min() + late.max()))
    peaks = [float(np.linalg.norm(piece, axis=1).max()) for piece in cycles.each(force)]
    return cycles.swings, np.array(peaks), 1.0 / float(cycles.periods[-STEADY:].mean())


def cases() -> Iterator[Hitting]:
    """All cases: every wall with every hold."""
    for wall in WALLS:
        for hold in HOLDS:
            yield hitting(wall, hold)
