"""Section 6.2 with something to hit: the 4-dof arm against walls, let go by a hand that held its tip.

The wall stands across the tip's path on mode 1, at a share of the free turning point; the hand holds the tip on the far
side, at a share of the free turning point too, for a second, and lets go. Nothing in the law knows of either. Figure 17
of the document shows such a motion on the DLR Hand Arm System.

Walls from .2 to .9 of the turning point were tried with the same outcome; one at .1 takes more than motors give, and
the motion dies. Let go from one much smaller than the steady one, it grows as slowly as friction lets it (`WEAK`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from via_bringup.demo.reference import DIRECTIONS, HITTING_MODE, WallScene, damped_arm, wall_scene
from via_core.signals import Array
from via_sim.arm import ArmState
from via_sim.contacts import Hand, Wall

from via_validation.control.arm_run import ArmRun, Phase, run_arm
from via_validation.control.bang_bang import reference_law
from via_validation.control.cycles import Cycles, spread

WALLS = (0.3, 0.5, 0.7)  # of the turning point
HOLDS = (0.9, 1.05, 1.2)
WEAK = (0.5, 0.4)  # wall and hold of a case that needs more than one cycle
HELD = 1.0  # [s]
STEADY = 8  # cycles at the end that count as steady
SUBSTEPS = 4  # a millisecond


@dataclass(frozen=True)
class Impacts:
    """Figures of number 6; swings are peak to peak along the tip's path, cycles count from the release."""

    wall: float  # share of the turning point
    hold: float
    swings: Array  # (c,) [m] of each whole cycle after the release
    peaks: Array  # (c,) [N] largest contact force of each cycle
    frequency: float  # [Hz] of the steady cycles

    @property
    def steady(self) -> float:
        """[m] the steady swing."""
        return float(self.swings[-STEADY:].mean())

    @property
    def second(self) -> float:
        """How far any cycle from the second on is off the steady swing [-]."""
        return float(np.abs(self.swings[1:] / self.steady - 1.0).max())

    @property
    def steady_spread(self) -> float:
        """std / mean of the steady swings [-]."""
        return spread(self.swings[-STEADY:])

    @property
    def least_force(self) -> float:
        """[N] the weakest of the steady cycles' impacts."""
        return float(self.peaks[-STEADY:].min())

    @property
    def settled(self) -> int:
        """Cycles after which the swing stays within 5 % of the steady one."""
        off = np.flatnonzero(np.abs(self.swings / self.steady - 1.0) > 0.05)
        return int(off[-1]) + 1 if off.size else 0


@dataclass(frozen=True)
class Hitting(Impacts):
    """A case and its motion."""

    run: ArmRun
    tip: Array  # (N, 3) [m] in the base, whole run


def hitting(wall: float, hold: float, duration: float = 10.0) -> Hitting:
    """One case, for `duration` [s] after the release."""
    arm, stand = damped_arm(), wall_scene(wall, hold)
    law = reference_law(arm, np.array(DIRECTIONS[HITTING_MODE]))
    barrier, hand = Wall(stand.face, -stand.along), Hand(arm.tip_position(stand.start))
    still = np.zeros(arm.n)
    start = ArmState(stand.rest, still, law.motors.motors, still)
    run = run_arm(arm, law, start, (Phase(HELD, (hand, barrier)), Phase(duration, (barrier,))), SUBSTEPS)
    tip = np.array([arm.tip_position(q) for q in run.q])
    free = run.since(HELD)
    return Hitting(wall, hold, *impacts(stand, free.time, tip[-len(free.time) :], free.force), run, tip)


def impacts(stand: WallScene, time: Array, tip: Array, force: Array) -> tuple[Array, Array, float]:
    """Swings, peaks, frequency of `Impacts` from times (N,) [s] after the release, tip (N, 3) [m], force (N, 3) [N]."""
    path = (tip - damped_arm().tip_position(stand.rest)) @ stand.along
    late = path[len(path) // 2 :]
    cycles = Cycles(time, path, 0.5 * float(late.min() + late.max()))
    peaks = [float(np.linalg.norm(piece, axis=1).max()) for piece in cycles.each(force)]
    return cycles.swings, np.array(peaks), 1.0 / float(cycles.periods[-STEADY:].mean())


def cases() -> Iterator[Hitting]:
    """Every wall with every hold."""
    for wall in WALLS:
        for hold in HOLDS:
            yield hitting(wall, hold)
