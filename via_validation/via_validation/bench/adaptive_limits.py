"""Limits of an arm with the adaptive limit cycle, and bounds of its model, under right and under faulty estimates.

Runs are those of `limits`, shorter, with a random payload and springs that differ from the file. In half of them the
estimates are right: true payload, friction and stiffness with 2 % noise, status OK. In the other half they are faulty:
random, infinite or NaN values and standard deviations with random status, constant for about 20 samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from via_bringup.demo.reference import ARM
from via_controllers.arm_methods import ModalLimitCycleParameters
from via_controllers.arms.adaptive_limit_cycle import AdaptiveLimitCycle, AdaptiveSwing
from via_controllers.contract import ArmSample
from via_controllers.correction import LARGEST_FACTOR
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import Supervised, Supervisor
from via_controllers.supervision.hold_still import HoldStill
from via_core.signals import Array
from via_core.status import Status
from via_core.vsa_arms import VsaArm

from via_validation.bench.limits import Worst, disturbed_run, worst_rows
from via_validation.tables.rows import Row

DURATION = 0.4  # [s] of a run
PAYLOAD, SPRINGS = 1.1, 0.2  # [kg] largest payload; largest relative change of a spring's torque
FRICTION = 0.5  # [N m s/rad] largest viscous friction of a link
QUICK = 0.02  # [s] times of the correction, so that a short run corrects and falls back
CHANGED = 0.05  # share of samples at which faulty estimates change
NOISE = 0.02  # relative noise of right estimates
WRONG = (np.nan, np.inf, -np.inf, -1e9, 0.0, 0.5, 30.0, 1e9)  # faulty values and standard deviations
KINDS = ("right estimates", "faulty estimates")
SETTINGS = (
    f"as limits.1, {DURATION:g} s; payload up to {PAYLOAD:g} kg, friction of links up to {FRICTION:g} N m s/rad, "
    f"springs up to {SPRINGS:.0%} off; modes 1 and 2 in turn; times of the correction {QUICK:g} s"
)


@dataclass(eq=False)
class _Informant:
    """Sends an estimate of each parameter before each step, and keeps the largest correction."""

    controller: AdaptiveLimitCycle
    supervisor: Supervisor
    truth: VsaArm
    payload: float
    friction: Array  # (n,) [N m s/rad] of the links
    faulty: bool
    random: np.random.Generator
    wrong: tuple[Array, Array, list[Status]] | None = None  # faulty values, standard deviations and status
    furthest: Array = field(default_factory=lambda: np.zeros(3))  # payload, friction, log scale over their bounds

    def __call__(self, state: Supervised, sample: ArmSample) -> Supervised:
        if not sample.valid:
            return state
        changed = self.supervisor.updated(state, partial(self._informed, sample))
        if isinstance(changed.inner, AdaptiveSwing):
            own, parts = self.controller, changed.inner
            rules = (own.payload_rule, own.friction_rule, own.spring_rule)
            groups = ((parts.payload,), parts.friction, parts.springs)
            now = [
                max(abs(each.value) for each in group) / rule.high for group, rule in zip(groups, rules, strict=True)
            ]
            self.furthest = np.maximum(self.furthest, now)
        return changed

    def _informed(self, sample: ArmSample, state: AdaptiveSwing) -> AdaptiveSwing:
        n = ARM.n
        if self.faulty:
            if self.wrong is None or self.random.random() < CHANGED:
                status = [Status(int(each)) for each in self.random.integers(0, len(Status), 1 + n)]
                self.wrong = (*self.random.choice(WRONG, (2, 1 + 2 * n)), status)
            values, sds, status = self.wrong
        else:
            stiffness = self.truth.spring_state(sample.q - sample.theta)[1]
            truth = np.concatenate([[self.payload], self.friction, stiffness])
            values = truth * (1.0 + self.random.normal(0.0, NOISE, 1 + 2 * n))
            sds, status = NOISE * np.abs(values), [Status.OK] * (1 + n)
        time, of_links = sample.time, slice(0, 1 + n)
        state = self.controller.with_payload(state, time, status[0], values[of_links], sds[of_links])
        for joint in range(n):
            value, sd = float(values[1 + n + joint]), float(sds[1 + n + joint])
            state = self.controller.with_stiffness(state, joint, time, status[1 + joint], value, sd)
        return state


def adaptive_run(seed: int) -> tuple[Worst, Array]:
    """Largest values of a run, and its largest corrections over their bounds; faulty estimates for odd seeds."""
    random = np.random.default_rng([seed, 1])
    payload, scale = float(random.uniform(0.0, PAYLOAD)), 1.0 + random.uniform(-SPRINGS, SPRINGS, ARM.n)
    friction = random.uniform(0.0, FRICTION, ARM.n)
    plant = ARM.corrected(payload, scale, friction)
    parameters = ModalLimitCycleParameters(
        mode=1 + seed // 2 % 2, adapt=True, correction_time=QUICK, fallback_time=QUICK
    )
    controller = parameters.adaptive()
    supervisor = Supervisor(controller, HoldStill(ARM), ArmLimits(ARM))
    informant = _Informant(controller, supervisor, plant, payload, friction, bool(seed % 2), random)
    return disturbed_run(seed, supervisor, plant, DURATION, informant), informant.furthest


def adaptive_limit_rows(seeds: Iterable[int]) -> list[Row]:
    """Rows of the largest values over the runs of these seeds, for right and for faulty estimates."""
    found: list[list[tuple[Worst, Array]]] = [[] for _ in KINDS]
    for seed in seeds:
        found[seed % len(KINDS)].append(adaptive_run(seed))
    rows: list[Row] = []
    for number, runs in enumerate(found):
        if not runs:
            continue
        at, what = f"limits.adaptive.{number + 1}", f"{len(runs)} runs, adaptive limit cycle, {KINDS[number]}"
        rows += worst_rows(at, what, [worst for worst, _ in runs], SETTINGS)
        payload, viscous, scale = np.max([furthest for _, furthest in runs], axis=0).tolist()
        rows += [
            Row(f"{at}.payload", what, "largest payload of the model / bound [-]", None, payload, 1.0, SETTINGS),
            Row(f"{at}.friction", what, "largest change of a link's friction / bound [-]", None, viscous, 1.0,
                SETTINGS),
            Row(f"{at}.springs", what, f"largest log scale of a spring / log {LARGEST_FACTOR:g} [-]", None, scale,
                1.0, SETTINGS),
        ]  # fmt: skip
    return rows
