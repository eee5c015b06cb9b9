"""Limits of an arm under random starts and disturbances: largest torques, speeds and deflections over their limits.

Every run starts with moving links within `POSTURE` of the equilibrium and with springs loaded against gravity. During
the run an impact changes the links' velocities at once, the end effector is held for a while, samples are lost, and the
node is deactivated and activated. One third of the runs uses a limit cycle on mode 1, one third on mode 2, and the rest
a faulty controller that commands up to twice the torque limit in random directions.
An impact that accelerates a link beyond motor speed can exceed the spring's deflection limit; none here is that hard.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from via_bringup.demo.reference import ARM, EQUILIBRIUM
from via_controllers.contract import ArmController, ArmSample, Quantity, Torques
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import Supervised, Supervisor
from via_controllers.supervision.hold_still import HoldStill
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.robots.arm import ArmState, arm_step
from via_sim.robots.contacts import Hand

from via_validation.control.limit_cycle import limit_cycle_controller
from via_validation.provenance import provenance
from via_validation.tables.page import number, verdict
from via_validation.tables.rows import Row
from via_validation.template import write_page

PERIOD = 1e-3  # [s]
DURATION = 0.8  # [s] of a run
POSTURE = 0.4  # [rad] to either side of the equilibrium
VELOCITY = 2.0  # [rad/s] largest initial velocity of a link
IMPACT = 3.0  # [rad/s] largest change of a link's velocity by the impact
LOST = 0.01  # share of lost samples
OFF = 0.02  # share of samples at which the controller is activated or deactivated


@dataclass(frozen=True)
class Worst:
    """Largest values of a run over their limits; inf if a spring passes its stop, which ends the run."""

    torque: float
    speed: float
    deflection: float
    guarded: float  # share of samples at which a limit changed the controller's torque

    @property
    def within(self) -> bool:
        return max(self.torque, self.speed, self.deflection) <= 1.0


@dataclass(frozen=True, eq=False)
class FaultyController(ArmController[Array]):
    """A faulty controller: random torques up to twice the limit, constant for about 30 samples each."""

    arm: VsaArm
    seed: int

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def observe(self, state: Array) -> Array:
        return np.empty(0)

    def init(self, sample: ArmSample) -> Array:
        return np.zeros(self.arm.n)

    def step(self, state: Array, sample: ArmSample) -> tuple[Array, Torques]:
        random = np.random.default_rng([self.seed, round(sample.time / PERIOD)])
        if random.random() < 0.03:
            state = random.uniform(-2.0, 2.0, self.arm.n) * self.arm.torque_limit
        return state, Torques(state, False)


def supervisor_of(seed: int) -> Supervisor:
    """The controller of a run under its limits; the seed selects one of the three KINDS in turn."""
    controller: ArmController = FaultyController(ARM, seed) if seed % 3 == 2 else limit_cycle_controller(seed % 3)
    return Supervisor(controller, HoldStill(ARM), ArmLimits(ARM))


KINDS = ("limit cycle, mode 1", "limit cycle, mode 2", "faulty controller")
SETTINGS = (
    f"{ARM.name}, {DURATION:g} s, links within {POSTURE:g} rad and {VELOCITY:g} rad/s, an impact of {IMPACT:g} "
    f"rad/s, a hold, {LOST:.0%} of samples lost, activated or deactivated at {OFF:.0%} of samples"
)


def limit_rows(seeds: Iterable[int]) -> list[Row]:
    """Rows of the largest values over the runs of these seeds, controller by controller."""
    found: list[list[Worst]] = [[] for _ in KINDS]
    for seed in seeds:
        found[seed % len(KINDS)].append(disturbed_run(seed, supervisor_of(seed)))
    return [row for number, runs in enumerate(found) if runs for row in _rows(number, runs)]


def _rows(number: int, runs: list[Worst]) -> list[Row]:
    return worst_rows(f"limits.{number + 1}", f"{len(runs)} runs, {KINDS[number]}", runs, SETTINGS)


def worst_rows(at: str, what: str, runs: list[Worst], settings: str) -> list[Row]:
    """Rows of the largest values of these runs, limit by limit, and of how often a limit changed a torque."""
    rows = []
    for name in ("torque", "speed", "deflection"):
        most = max(getattr(each, name) for each in runs)
        known, remark = (most, "") if np.isfinite(most) else (None, "springs at their stops")
        rows.append(Row(f"{at}.{name}", what, f"largest {name} / limit [-]", None, known, 1.0, settings, 0, remark))
    share = float(np.mean([each.guarded for each in runs]))
    quantity = "samples at which limits changed a torque [-]"
    return [*rows, Row(f"{at}.guarded", what, quantity, None, share, None, settings)]


def write_markdown(rows: list[Row], command: str, path: Path) -> None:
    """Write the page of all rows of this benchmark, which `command` made."""
    settings = {row.id.rpartition(".")[0]: row.settings for row in rows}
    values = {
        "rows": rows,
        "limited": sum(row.ok is not None for row in rows),
        "missed": [row.id for row in rows if row.ok is False],
        "groups": settings,
        "source": provenance(command),
    }
    write_page(path, "bench/limits.md", values, {"number": number, "verdict": verdict})


def disturbed_run(
    seed: int, supervisor: Supervisor, plant: VsaArm = ARM, duration: float = DURATION,
    informed: Callable[[Supervised, ArmSample], Supervised] = lambda state, _: state,
) -> Worst:  # fmt: skip
    """One run of `duration` [s] with the random numbers of `seed`.

    plant     the real arm, which the supervisor's model need not be
    informed  the state after estimates that arrive before the controller's step
    """
    random, arm, unknown = np.random.default_rng(seed), ARM, np.full(ARM.n, np.nan)
    q = EQUILIBRIUM + random.uniform(-POSTURE, POSTURE, arm.n)
    body = ArmState(q, random.uniform(-VELOCITY, VELOCITY, arm.n), arm.rest(q), np.zeros(arm.n))
    ticks = round(duration / PERIOD)
    impact, held = random.integers(ticks // 8, ticks, 2)
    released = held + random.integers(20, ticks // 4)
    state, active = supervisor.init(), True
    hands: tuple[Hand, ...] = ()
    worst, guarded = np.zeros(3), 0
    for tick in range(ticks):
        sample = ArmSample(tick * PERIOD, body.q, body.velocity, body.theta, body.motor_velocity, unknown)
        if random.random() < LOST:
            sample = ArmSample(tick * PERIOD, unknown, unknown, unknown, unknown, unknown)
        active ^= bool(random.random() < OFF)
        state, answer = supervisor.step(informed(state, sample), sample, active)
        guarded += bool(answer.limited)
        velocity = body.velocity + (random.uniform(-IMPACT, IMPACT, arm.n) if tick == impact else 0.0)
        if tick == held:
            hands = (Hand(arm.tip_position(body.q)),)
        elif tick == released:
            hands = ()
        try:
            body = arm_step(
                plant, ArmState(body.q, velocity, body.theta, body.motor_velocity), answer.torque,
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
