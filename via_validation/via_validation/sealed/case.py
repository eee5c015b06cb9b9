"""One case from a seed: joint, effect, size, unmodelled effect (dirt), sensors, motion, and the recorded logs.

A draw is rejected if the simulation diverges, if the joint has no location for the effect, if the gap over noise is
outside its range, or if the joint's parameters can compensate the effect within the tolerances of the device file (then
there is no gap). Each attempt draws from the seed and the attempt's number. The key states the number of attempts.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import log
from typing import Any

import numpy as np
from numpy.random import Generator
from via_core.errors import ParameterError

from via_validation.sealed.catalogue import Entry, Location
from via_validation.sealed.experiment import DrawnEffect, RejectedError, draw_experiment, inside, noisier, search
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

RANGE, AIM = (3.0, 30.0), (4.0, 25.0)  # gap over noise: accepted, and drawn (narrower, so that the final run passes)
FAR_RANGE, FAR_AIM = (3.0, 2000.0), (20.0, 400.0)  # the same for controlled motors, whose disturbances are large
ATTEMPTS = 200
MAX_NOISE = 12.0  # largest factor on the drawn sensor noise
WIDE_SHARE, SHORT_SHARE, DIRTY_SHARE = 0.3, 0.15, 0.5  # share of cases with 10 % tolerance, short recordings, dirt
DECIMATED_SHARE = 0.5  # share of logs at a lower rate than the control loop
PAUSE = 0.5  # [s] between short recordings
TIME_DEPENDENT = ("external_torque", "stiffness_drift", "warming_friction")  # count time from the first sample


@dataclass(frozen=True)
class Case:
    """All data of a case. `nominal` and `logs` are written to the case's folder, the rest to the key."""

    nominal: Content
    logs: tuple[Log, ...]
    level: str
    seed: int
    kind: str
    family: str
    true: Content
    errors: dict[str, float]  # relative errors of the nominal parameters
    tolerance: float
    truths: tuple[Truth, ...]
    dirt: Dirt | None
    ratio: float  # gap over noise of all effects together, without dirt
    noise: float  # factor on the drawn sensor noise
    recorder: Recorder
    control_rate: float  # [Hz]
    withheld: Log
    attempts: int

    def key(self) -> dict[str, Any]:
        """The content to seal, except the withheld log."""
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
    """The case of a seed. Raises ParameterError if every attempt is rejected."""
    wanted = plan(seed)
    for attempt in range(ATTEMPTS):
        try:
            return _attempt(np.random.default_rng([seed, attempt]), seed, attempt, wanted, duration)
        except RejectedError:
            continue
    raise ParameterError(f"seed {seed}: all {ATTEMPTS} attempts were rejected")


def _attempt(rng: Generator, seed: int, attempt: int, wanted: Plan, duration: float) -> Case:
    family = wanted.family or str(rng.choice(wanted.families()))
    true = draw_joint(rng, family)
    rate, control_rate = _rates(rng, family)
    true["sensors"] |= {"rate": rate}
    tolerance = WIDE if rng.uniform() < WIDE_SHARE else TOLERANCE
    nominal, errors = believed(rng, true, tolerance)
    recorder = draw_recorder(rng, round(control_rate / rate), not device_of(true).motors)
    entries = wanted.entries(rng, family)
    locations = [_location(rng, true, entry, wanted) for entry in entries]
    windows = _windows(rng, duration, {each.name for each in entries})
    whole = windows[-1][1] if windows else duration
    experiment = draw_experiment(rng, true, family, whole, recorder)
    drawn = [DrawnEffect(entry, at, entry.shape(rng, experiment.scene)) for entry, at in zip(entries, locations)]
    low, high = FAR_AIM if family == CONTROLLED else AIM
    aims = np.exp(rng.uniform(log(low), log(high), len(drawn)))
    if wanted.level != "full":
        aims = np.maximum(aims, 2.0 * low)
    noise = 1.0
    sizes = [search(experiment, each, aim, NEAR) for each, aim in zip(drawn, aims)]
    above = max((found / aim for (_, found), aim in zip(sizes, aims)), default=1.0)
    if above > np.exp(NEAR):  # the smallest size exceeds the wanted gap: use noisier sensors
        noise = min(1.3 * above, MAX_NOISE)
        experiment, nominal = noisier(experiment, noise), noisier_content(nominal, noise)
        true = experiment.true
        sizes = [search(experiment, each, aim, NEAR) for each, aim in zip(drawn, aims)]
    physics, truths = Physics(), []
    for each, (size, _) in zip(drawn, sizes):
        alone, truth = plant(experiment, each, size, (errors, tolerance), FAR_RANGE if family == CONTROLLED else RANGE)
        truths.append(truth)
        try:
            physics = physics.joined(alone)
        except ValueError:
            raise RejectedError from None
    final = experiment.run(physics, STEP)
    if final is None or not inside(experiment.device, final):
        raise RejectedError
    ratio = experiment.ratio(physics, final)
    dirt = None
    if wanted.kind in ("single", "pair") and rng.uniform() < DIRTY_SHARE:
        physics, dirt = with_dirt(rng, experiment, physics, ratio)
    if not physics.neighbour_period and rng.uniform() < 0.15:  # a neighbour without effect on this joint
        physics = physics.with_(neighbour_period=float(rng.uniform(1.5, 4.0)))
    log_rng, other_rng = rng.spawn(2)
    acts = acting(log_rng, recorder, len(experiment.drive.references), control_rate)
    final = experiment.run(physics, STEP, acts)
    if final is None or not inside(experiment.device, final):
        raise RejectedError
    recorded = limited(sense(log_rng, experiment.device, physics, experiment.drive, final, recorder), wanted.level)
    withheld = limited(experiment.record_other(other_rng, family, physics, duration), wanted.level)
    return Case(
        nominal, cut(recorded, windows) if windows else (recorded,), wanted.level, seed, wanted.kind, family, true,
        errors, tolerance, tuple(truths), dirt, round(ratio, 3), noise, recorder, control_rate, withheld, attempt + 1,
    )  # fmt: skip


def _rates(rng: Generator, family: str) -> tuple[float, float]:
    """Rates [Hz] of log and control loop; only servos and position drives have a slow loop."""
    rate = float(rng.choice(RATES))
    if family == POSITIONED:
        return rate, rate
    alone = rng.uniform() >= DECIMATED_SHARE and (rate > RATES[0] or family == "variable_damping")
    return rate, rate if alone and family != CONTROLLED else HIGHEST


def _windows(rng: Generator, duration: float, effects: set[str]) -> list[tuple[float, float]]:
    """(begin, end) [s] of several short recordings; empty for one long recording."""
    if rng.uniform() >= SHORT_SHARE or effects & set(TIME_DEPENDENT):
        return []
    count, length = int(rng.integers(10, 21)), float(rng.uniform(1.0, 2.0))
    if duration < count * (length + PAUSE):  # a short session
        count = max(int(duration / (length + PAUSE)), 2)
    return [(PAUSE + k * (length + PAUSE), (k + 1) * (length + PAUSE)) for k in range(count)]


def _location(rng: Generator, true: Content, entry: Entry, wanted: Plan) -> Location:
    """A random location of the effect, among those at which a log of this signal set can show it."""
    locations = entry.locations(device_of(true))
    if wanted.both:
        return "motor", 0
    if wanted.level != "full":  # an error in a measurement that is not recorded shows nowhere
        unseen = {"no_torque": entry.sensed is not None, "link_only": entry.sensed is None}.get(wanted.level, True)
        locations = tuple(at for at in locations if at[0] not in ("sensor", "timing") or not at[1] or not unseen)
    if not locations:
        raise RejectedError
    return locations[int(rng.integers(len(locations)))]
