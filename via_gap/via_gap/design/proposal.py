"""The short motion that would separate the tied causes of a report, found by prediction.

Each tied cause in turn is taken for the truth and simulated, sensors included, on every motion of a small family. The
others are fitted to that. What they cannot imitate is the disagreement. The chosen motion is the one that separates
the hardest pair best, by the score that a diagnosis of the new log will use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, permutations
from math import inf

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Signals
from via_sim.plants import JointPlant

from via_gap.candidates.location import Location
from via_gap.design.commands import RANGE, all_within_limits, angles_under, commands_of
from via_gap.design.imitation import TiedCause
from via_gap.design.motions import DURATION, MOTIONS, Motion
from via_gap.logs.noise import stated_noise
from via_gap.report.report import Cause, EffectLocation, GapReport, Proposal
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_with_noise

SMALLER = (1.0, 0.5, 0.25)  # times the largest angle, tried until all limits are kept
MOST = 4  # causes that are compared
LIKELY = 0.02  # probability from which a cause is compared, for the verdict cannot_tell
ENOUGH = 0.03  # difference of scores that separates causes: the margin of docs/method.md


@dataclass(frozen=True, eq=False)
class Proposed:
    """A motion, its commands, and what it is expected to show.

    commands      held: motor (N, m) [N m]; of servos equilibrium, preset [rad], damping [-]; rigid: external_torque
    reference     (N, m) [rad] motor angles under them with the likeliest cause; None without torque motors
    size          [rad] largest motor angle
    pair          the causes that are hardest to separate
    disagreement  [-] root mean square difference of their predictions, in units of the noise
    score         difference of their held-out scores; below ENOUGH the motion does not separate them
    """

    motion: Motion
    size: float
    commands: Signals
    reference: Array | None
    separates: tuple[Location, ...]
    pair: tuple[Location, Location]
    disagreement: float
    score: float

    @property
    def text(self) -> str:
        """The proposal in one sentence."""
        first, second = (str(location).replace("_", " ") for location in self.pair)
        if self.score < ENOUGH:
            return (
                f"no motion within the device's limits separates {first} from {second}: in the best, "
                f"{self.motion.name}, their predictions differ by {self.disagreement:.2g} standard deviations of the "
                f"sensors; a hold with the torque measured at the joint, or a known load, could separate them"
            )
        return (
            f"run '{self.motion.name}' ({self.motion.shows}) for {DURATION:g} s, up to {self.size:.2g} rad: the "
            f"predictions of {first} and {second} differ there by at least {self.disagreement:.2g} standard deviations "
            f"of the sensors; the log must contain the link angle, all motor angles and the commands, from rest to rest"
        )

    def summary(self, joint: str, file: str = "") -> Proposal:
        """The proposal as a report contains it; `file` holds the commands."""
        return Proposal(
            separates=tuple(
                EffectLocation(effect=p.name, site=p.site, joint=joint, motor=p.motor)  # type: ignore[arg-type]
                for p in self.separates
            ),
            expected_disagreement=self.disagreement, duration=DURATION, file=file,
            motion=self.motion.name, text=self.text, separable=self.score >= ENOUGH,
        )  # fmt: skip


def tied(report: GapReport) -> tuple[Cause, ...]:
    """The causes that a log left undecided, likeliest first; fewer than two where all is decided.

    Only single causes are compared: one motion does not separate sets of effects.
    """
    if report.verdict in ("effect", "main_effect") and len(report.effects) == 1:
        return tuple(c for c in report.causes if c.place in report.equivalence_set)[:MOST]
    if report.verdict == "cannot_tell":
        return tuple(c for c in report.causes if c.probability >= LIKELY)[:MOST]
    return ()


def with_proposal(report: GapReport, device: Device) -> GapReport:
    """The report with a proposal, where causes are tied and a motion keeps within the limits.

    `via gap propose` also compares the likeliest causes of `cannot_tell` without ties.
    """
    if not report.equivalence_set:
        return report
    try:
        found = propose(report, device)
    except ParameterError:
        return report
    return report if found is None else report.model_copy(update={"proposal": found.summary(device.name)})


def propose(report: GapReport, device: Device, reach: float = RANGE) -> Proposed | None:
    """The motion that separates the tied causes of `report` best; None where none are tied that a motion can separate.

    A cause under which no motion keeps within the limits, such as a strong push, is left out if it prevents all.

    reach  [rad] largest motor angle from rest

    Raises ParameterError where the report is of another device.
    """
    blank = ResidualModel.of_plant(JointPlant.from_device(device))
    found = {value.name: value.offset for value in report.nuisance}
    if found.keys() != {nuisance.name for nuisance in blank.nuisances if nuisance.start == 0.0}:
        raise ParameterError(f"the report's numbers are not those of '{device.name}'")
    causes = [TiedCause.of(cause) for cause in tied(report)]
    if len(causes) < 2:
        return None
    offsets = np.array([found.get(nuisance.name, 0.0) for nuisance in blank.nuisances])
    proposals = _proposals(blank, causes, offsets, reach)
    if not proposals:
        plants = _plants(blank, causes, offsets)
        causes = [c for c, plant in zip(causes, plants, strict=True) if _keeps(plant, SMALLER[-1] * reach)]
        proposals = _proposals(blank, causes, offsets, reach) if len(causes) > 1 else []
    return max(proposals, key=lambda each: each.score, default=None)


def _proposals(blank: ResidualModel, causes: Sequence[TiedCause], offsets: Array, reach: float) -> list[Proposed]:
    """Every motion of the family in the largest size that keeps within limits whichever cause is true.

    A motion that separates one pair worse than an earlier motion separates all is not tried on the other pairs.
    """
    made: list[Proposed] = []
    for motion in MOTIONS:
        best = max(made, key=lambda each: each.score, default=None)
        sizes = (_tried(blank, causes, offsets, motion, share * reach, best) for share in SMALLER)
        made += islice((each for each in sizes if each is not None), 1)
    return made


def general_motion(device: Device, reach: float = RANGE, name: str = "ladder of speeds") -> tuple[Motion, Signals]:
    """A motion of the family, by default of many speeds, and its commands.

    Raises ParameterError where no size of it keeps within the limits of the device.
    """
    plant = JointPlant.from_device(device)
    motion = next(each for each in MOTIONS if each.name == name)
    for size in (share * reach for share in SMALLER):
        commands, start = commands_of(plant, motion, size)
        if all_within_limits([plant], commands, start, size):
            return motion, commands
    raise ParameterError(f"'{motion.name}' does not keep '{device.name}' within its limits")


def _plants(blank: ResidualModel, causes: Sequence[TiedCause], offsets: Array) -> list[JointPlant]:
    """The joint with each cause."""
    return [JointPlant(blank.device, blank.row([each.effect()], offsets), (each.effect(),)) for each in causes]


def _keeps(plant: JointPlant, size: float) -> bool:
    """Whether any motion of this size keeps the plant within limits."""
    return any(all_within_limits([plant], *commands_of(plant, motion, size), size) for motion in MOTIONS)


def _tried(
    blank: ResidualModel,
    causes: Sequence[TiedCause],
    offsets: Array,
    motion: Motion,
    size: float,
    best: Proposed | None,
) -> Proposed | None:
    """The motion of this size, if it keeps within limits whichever cause is true.

    best  the best motion so far. Its hardest pair comes first; once a pair has no higher score, no other one is tried
    """
    plants = _plants(blank, causes, offsets)
    commands, start = commands_of(plants[0], motion, size)
    logs = all_within_limits(plants, commands, start, size)
    if logs is None:
        return None
    problems: list[tuple[ResidualModel, Array]] = []
    noise = stated_noise(logs[0])  # of the same sensors in every log
    for log, plant in zip(logs, plants, strict=True):
        segments = cut_with_noise(log, noise)
        problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
        problems.append((problem, problem.per_segment(problem.residual([plant.parameters])[0])))
    hardest, pair, apart = inf, (causes[0].location, causes[1].location), 0.0
    ordered = [*permutations(zip(causes, problems, strict=True), 2)]
    if best is not None:
        ordered.sort(key=lambda each: (each[0][0].location, each[1][0].location) != best.pair)
    for (true, (problem, own)), (other, _) in ordered:
        if other.includes(true.location):
            continue  # the diagnosis prefers the simpler effect, so the richer one need not fail
        begin = np.pad(offsets, (0, len(problem.nuisances) - len(offsets)))  # what belongs to a recording is 0 at first
        wrong = problem.per_segment(other.imitated(problem, begin))
        score = float(np.mean(np.log1p(wrong) - np.log1p(own)))
        if score < hardest:
            hardest, pair = score, (true.location, other.location)
            apart = float(np.sqrt(max(float(np.mean(wrong) - np.mean(own)), 0.0)))
        if best is not None and hardest <= best.score:
            break
    reference = angles_under(plants[0], commands)
    return Proposed(motion, size, commands, reference, tuple(c.location for c in causes), pair, apart, hardest)
