"""Limits of an arm under random starts and disturbances: how close do torques, speeds and springs come to them?

Every course begins with the links anywhere within `POSTURE` of the equilibrium, moving, the motors loaded for it. On
the way a blow changes the links' velocities at once, somebody holds the end effector for a while, samples get lost, and
the node is deactivated and activated again. A third of the courses runs a limit cycle on each of two modes; in the last
third the law is out of its mind: twice the torque limit, to and fro at random.
A blow that makes a link faster than its motor can be bends its spring whatever the motor does: none is that hard.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from via_bringup.demo.reference import ARM, EQUILIBRIUM
from via_controllers.arm_limits import ArmLimits
from via_controllers.contract import ArmController, ArmSample, Quantity, Torques
from via_controllers.hold_still import HoldStill
from via_controllers.supervision import Supervisor
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.arm import ArmState, arm_step
from via_sim.contacts import Hand

from via_validation.control.limit_cycle import law_of
from via_validation.tables.rows import Row

PERIOD = 1e-3  # [s]
DURATION = 0.8  # [s] of a course
POSTURE = 0.4  # [rad] to either side of the equilibrium
VELOCITY = 2.0  # [rad/s] of the links at the start, at most
BLOW = 3.0  # [rad/s] by which a link's velocity changes at once, at most
LOST = 0.01  # of the samples
OFF = 0.02  # share of the samples at which activity changes


@dataclass(frozen=True)
class Worst:
    """The largest of a course over its limit; 1 is the limit. Beyond the stop of a spring a course ends."""

    torque: float
    speed: float
    deflection: float
    guarded: float  # share of samples at which limits changed what the law wanted

    @property
    def within(self) -> bool:
        return max(self.torque, self.speed, self.deflection) <= 1.0


@dataclass(frozen=True, eq=False)
class Wild(ArmController[Array]):
    """A law that should not be: torques far beyond the limits, each held for some ten samples."""

    arm: VsaArm
    seed: int

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def told(self, state: Array) -> Array:
        return np.empty(0)

    def init(self, sample: ArmSample) -> Array:
        return np.zeros(self.arm.n)

    def step(self, state: Array, sample: ArmSample) -> tuple[Array, Torques]:
        random = np.random.default_rng([self.seed, round(sample.time / PERIOD)])
        if random.random() < 0.03:
            state = random.uniform(-2.0, 2.0, self.arm.n) * self.arm.torque_limit
        return state, Torques(state, False)


def supervisor_of(seed: int) -> Supervisor:
    """The law of a course by turns, under its limits."""
    law: ArmController = Wild(ARM, seed) if seed % 3 == 2 else law_of(seed % 3)
    return Supervisor(law, HoldStill(ARM), ArmLimits(ARM))


KINDS = ("limit cycle, mode 1", "limit cycle, mode 2", "a law out of its mind")
SETTINGS = (
    f"{ARM.name}, {DURATION:g} s, links within {POSTURE:g} rad and {VELOCITY:g} rad/s, a blow of {BLOW:g} rad/s, "
    f"a hold, {LOST:.0%} of samples lost, activity changed at {OFF:.0%}"
)


def limit_rows(seeds: Iterable[int]) -> list[Row]:
    """The worst of the courses of these seeds, law by law."""
    found: list[list[Worst]] = [[] for _ in KINDS]
    for seed in seeds:
        found[seed % len(KINDS)].append(course(seed, supervisor_of(seed)))
    return [row for number, courses in enumerate(found) if courses for row in _rows(number, courses)]


def _rows(number: int, courses: list[Worst]) -> list[Row]:
    return worst_rows(f"limits.{number + 1}", f"{len(courses)} courses, {KINDS[number]}", courses, SETTINGS)


def worst_rows(at: str, what: str, courses: list[Worst], settings: str) -> list[Row]:
    """The worst of these courses, limit by limit, and how often limits changed a torque."""
    rows = []
    for name in ("torque", "speed", "deflection"):
        most = max(getattr(each, name) for each in courses)
        known, remark = (most, "") if np.isfinite(most) else (None, "springs at their stops")
        rows.append(Row(f"{at}.{name}", what, f"largest {name} / limit [-]", None, known, 1.0, settings, 0, remark))
    share = float(np.mean([each.guarded for each in courses]))
    quantity = "samples at which limits changed a torque [-]"
    return [*rows, Row(f"{at}.guarded", what, quantity, None, share, None, settings)]


def course(seed: int, supervisor: Supervisor) -> Worst:
    """One course from random numbers of its own."""
    random, arm, unknown = np.random.default_rng(seed), ARM, np.full(ARM.n, np.nan)
    q = EQUILIBRIUM + random.uniform(-POSTURE, POSTURE, arm.n)
    body = ArmState(q, random.uniform(-VELOCITY, VELOCITY, arm.n), arm.rest(q), np.zeros(arm.n))
    ticks = round(DURATION / PERIOD)
    blow, held = random.integers(ticks // 8, ticks, 2)
    released = held + random.integers(20, ticks // 4)
    state, active = supervisor.init(), True
    hands: tuple[Hand, ...] = ()
    worst, guarded = np.zeros(3), 0
    for tick in range(ticks):
        sample = ArmSample(tick * PERIOD, body.q, body.velocity, body.theta, body.motor_velocity, unknown)
        if random.random() < LOST:
            sample = ArmSample(tick * PERIOD, unknown, unknown, unknown, unknown, unknown)
        active ^= bool(random.random() < OFF)
        state, answer = supervisor.step(state, sample, active)
        guarded += bool(answer.limited)
        velocity = body.velocity + (random.uniform(-BLOW, BLOW, arm.n) if tick == blow else 0.0)
        if tick == held:
            hands = (Hand(arm.tip_position(body.q)),)
        elif tick == released:
            hands = ()
        try:
            body = arm_step(
                arm, ArmState(body.q, velocity, body.theta, body.motor_velocity), answer.torque, np.zeros(arm.n),
                PERIOD, 4 if hands else 2, hands,
            )  # fmt: skip
        except ParameterError:
            worst[2] = np.inf
            break
        now = (
            answer.torque / arm.torque_limit,
            body.motor_velocity / arm.speed_limit,
            (body.q - body.theta) / arm.deflection_limit,
        )
        worst = np.maximum(worst, np.abs(now).max(axis=1))
    torque, speed, deflection = worst.tolist()
    return Worst(torque, speed, deflection, guarded / ticks)
