"""One case from its seed: joint, effect, size, dirt, sensors, motion, and what is recorded of it.

A draw is rejected if it diverges, has no place for its effect, misses the declared range of gap over noise, or if the
joint's parameters can compensate its effect inside the tolerances of the device file (then there is no gap). The next
attempt draws from the seed and its own number. The key counts the attempts.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import log
from typing import Any

import numpy as np
from numpy.random import Generator
from via_core.errors import ParameterError

from via_validation.sealed.bench import AgainError, Drawn, draw_bench, inside, noisier, search
from via_validation.sealed.catalogue import Entry, Place
from via_validation.sealed.joints import (
    CONTROLLED,
    POSITIONED,
    TOLERANCE,
    WIDE,
    Content,
    believed,
    device_of,
    draw_joint,
    noisier_content,
)
from via_validation.sealed.model import STEP
from via_validation.sealed.physics import Physics
from via_validation.sealed.plan import Plan, plan
from via_validation.sealed.planted import NEAR, Dirt, Truth, plant, with_dirt
from via_validation.sealed.recorder import HIGHEST, RATES, Recorder, acting, draw_recorder
from via_validation.sealed.recording import Log, cut, limited, sense

RANGE, AIM = (3.0, 30.0), (4.0, 25.0)  # of gap over noise; what is drawn, so that the final run stays inside
FAR_RANGE, FAR_AIM = (3.0, 2000.0), (20.0, 400.0)  # the same of motors under control, whose disturbances are large
ATTEMPTS = 200
MAX_NOISE = 12.0  # times the drawn sensors' noise
WIDE_SHARE, SHORT_SHARE, DIRTY_SHARE = 0.3, 0.15, 0.5  # of cases: 10 % nuisance errors, short recordings, dirt
DECIMATED_SHARE = 0.5  # of logs below the loop's highest rate
PAUSE = 0.5  # [s] between short recordings
AT_A_TIME = ("external_torque", "stiffness_drift", "warming_friction")  # depend on the time since the first sample


@dataclass(frozen=True)
class Case:
    """All data of a case; `nominal` and `logs` go into its folder, the rest into the key."""

    nominal: Content
    logs: tuple[Log, ...]
    level: str
    seed: int
    kind: str
    family: str
    true: Content
    errors: dict[str, float]  # relative, of the nominal numbers
    tolerance: float
    truths: tuple[Truth, ...]
    dirt: Dirt | None
    ratio: float  # gap over noise, of all effects together, without dirt
    noise: float  # factor on the drawn sensors' noise
    recorder: Recorder
    control_rate: float  # [Hz]
    withheld: Log
    attempts: int

    def key(self) -> dict[str, Any]:
        """What is sealed, without the withheld log."""
        return {
            "seed": self.seed,
            "kind": self.kind,
            "level": self.level,
            "quality": self.recorder.quality,
            "family": self.family,
            "effects": [vars(truth) for truth in self.truths],
            "dirt": None if self.dirt is None else vars(self.dirt),
            "ratio": self.ratio,
            "true_device": self.true,
            "tolerance": self.tolerance,
            "nominal_errors": self.errors,
            "noise_factor": self.noise,
            "recordings": len(self.logs),
            "control_rate": self.control_rate,
            "recorder": asdict(self.recorder),
            "attempts": self.attempts,
        }


def draw_case(seed: int, duration: float = 40.0) -> Case:
    """The case of a seed. Raises ParameterError where no attempt makes one."""
    wanted = plan(seed)
    for attempt in range(ATTEMPTS):
        try:
            return _attempt(np.random.default_rng([seed, attempt]), seed, attempt, wanted, duration)
        except AgainError:
            continue
    raise ParameterError(f"seed {seed}: none of {ATTEMPTS} attempts made a case")


def _attempt(rng: Generator, seed: int, attempt: int, wanted: Plan, duration: float) -> Case:
    family = wanted.family or str(rng.choice(wanted.families()))
    true = draw_joint(rng, family)
    rate, control_rate = _rates(rng, family)
    true["sensors"] |= {"rate": rate}
    tolerance = WIDE if rng.uniform() < WIDE_SHARE else TOLERANCE
    nominal, errors = believed(rng, true, tolerance)
    recorder = draw_recorder(rng, round(control_rate / rate), not device_of(true).motors)
    entries = wanted.entries(rng, family)
    places = [_place(rng, true, entry, wanted) for entry in entries]
    windows = _windows(rng, duration, {each.name for each in entries})
    whole = windows[-1][1] if windows else duration
    bench = draw_bench(rng, true, family, whole, recorder)
    drawn = [Drawn(entry, place, entry.shape(rng, bench.scene)) for entry, place in zip(entries, places)]
    low, high = FAR_AIM if family == CONTROLLED else AIM
    aims = np.exp(rng.uniform(log(low), log(high), len(drawn)))
    if wanted.level != "full":
        aims = np.maximum(aims, 2.0 * low)
    noise = 1.0
    sizes = [search(bench, each, aim, NEAR) for each, aim in zip(drawn, aims)]
    above = max((found / aim for (_, found), aim in zip(sizes, aims)), default=1.0)
    if above > np.exp(NEAR):  # the smallest size exceeds the wanted gap: use noisier sensors
        noise = min(1.3 * above, MAX_NOISE)
        bench, nominal = noisier(bench, noise), noisier_content(nominal, noise)
        true = bench.true
        sizes = [search(bench, each, aim, NEAR) for each, aim in zip(drawn, aims)]
    physics, truths = Physics(), []
    for each, (size, _) in zip(drawn, sizes):
        alone, truth = plant(bench, each, size, (errors, tolerance), FAR_RANGE if family == CONTROLLED else RANGE)
        truths.append(truth)
        try:
            physics = physics.joined(alone)
        except ValueError:
            raise AgainError from None
    final = bench.run(physics, STEP)
    if final is None or not inside(bench.device, final):
        raise AgainError
    ratio = bench.ratio(physics, final)
    dirt = None
    if wanted.kind in ("single", "pair") and rng.uniform() < DIRTY_SHARE:
        physics, dirt = with_dirt(rng, bench, physics, ratio)
    if not physics.neighbour_period and rng.uniform() < 0.15:  # a neighbour without effect on this joint
        physics = physics.with_(neighbour_period=float(rng.uniform(1.5, 4.0)))
    log_rng, other_rng = rng.spawn(2)
    acts = acting(log_rng, recorder, len(bench.drive.references), control_rate)
    final = bench.run(physics, STEP, acts)
    if final is None or not inside(bench.device, final):
        raise AgainError
    recorded = limited(sense(log_rng, bench.device, physics, bench.drive, final, recorder), wanted.level)
    withheld = limited(bench.record_other(other_rng, family, physics, duration), wanted.level)
    return Case(
        nominal, cut(recorded, windows) if windows else (recorded,), wanted.level, seed, wanted.kind, family, true,
        errors, tolerance, tuple(truths), dirt, round(ratio, 3), noise, recorder, control_rate, withheld, attempt + 1,
    )  # fmt: skip


def _rates(rng: Generator, family: str) -> tuple[float, float]:
    """Rates [Hz] of log and loop; a slow loop is that of a servo or of a position drive."""
    rate = float(rng.choice(RATES))
    if family == POSITIONED:
        return rate, rate
    alone = rng.uniform() >= DECIMATED_SHARE and (rate > RATES[0] or family == "variable_damping")
    return rate, rate if alone and family != CONTROLLED else HIGHEST


def _windows(rng: Generator, duration: float, effects: set[str]) -> list[tuple[float, float]]:
    """(begin, end) [s] of several short recordings in place of one; empty: one long one."""
    if rng.uniform() >= SHORT_SHARE or effects & set(AT_A_TIME):
        return []
    count, length = int(rng.integers(10, 21)), float(rng.uniform(1.0, 2.0))
    if duration < count * (length + PAUSE):  # a short session
        count = max(int(duration / (length + PAUSE)), 2)
    return [(PAUSE + k * (length + PAUSE), (k + 1) * (length + PAUSE)) for k in range(count)]


def _place(rng: Generator, true: Content, entry: Entry, wanted: Plan) -> Place:
    """Where the effect sits, among the places at which a log of this level can show it."""
    places = entry.places(device_of(true))
    if wanted.both:
        return "motor", 0
    if wanted.level != "full":  # a wrong reading that was not recorded shows nowhere
        unseen = {"no_torque": entry.sensed is not None, "link_only": entry.sensed is None}.get(wanted.level, True)
        places = tuple(place for place in places if place[0] not in ("sensor", "timing") or not place[1] or not unseen)
    if not places:
        raise AgainError
    return places[int(rng.integers(len(places)))]
