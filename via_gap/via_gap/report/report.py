"""GapReport: the result of a diagnosis, numbers only.

    report = diagnose([log], device)
    text = report.to_json()                       # its schema: gap_report.schema.json
    again = GapReport.model_validate_json(text)

`rendering` makes text and pages of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError, model_validator
from via_core.errors import ParameterError
from via_core.records import problems
from via_sim.effects import Effect
from via_sim.effects.device_numbers import DEVICE_NUMBERS
from via_sim.effects.files import save_effects

from via_gap.candidates.localisation import Region
from via_gap.logs.between import in_lines
from via_gap.logs.findings import Finding, Number, Record, Share
from via_gap.logs.log import JointLog, Level
from via_gap.report.figures import Figures, NotNegative
from via_gap.selection.gap import Gap
from via_gap.selection.verdict import Verdict

DEVIATIONS = 1.96  # standard deviations to either side of a 95 % interval
Site = Literal["command", "motor", "transmission", "link", "sensor", "timing", "environment"]


class Where(Record):
    """A site with its share of the gap; several sites are listed largest share first."""

    joint: str
    site: Site
    motor: int = 0  # number of the motor or transmission; 0: none, or both
    equation: str  # link, motor 1, motor 2; 'simulation' where no equation can be evaluated; 'measurements'
    share: Share
    regions: tuple[Region, ...] = ()


class Value(Record):
    """A fitted parameter with its standard deviation, the range it was fitted in, and its value without the effect."""

    value: Number
    sd: NotNegative
    unit: str
    low: Number | None = None
    high: Number | None = None
    neutral: Number | None = None


class Combination(Record):
    """A function of a cause's parameters that the data determine better than the single parameters."""

    expression: str  # of the names of the parameters
    value: Number
    sd: NotNegative  # by the delta method, from the covariance of the parameters
    unit: str


class Noise(Record):
    """Noise of one channel of one log, as declared by the device file and as estimated from the log."""

    log: str
    channel: str  # q, theta_1, theta_2, tau_1, tau_2
    unit: str
    declared: NotNegative | None  # standard deviation; None: the device file states none
    estimated: NotNegative  # standard deviation, rounding included
    jitter: NotNegative  # [s] standard deviation of the time stamps, as this channel shows it


class EffectLocation(Record):
    """An effect at a site; `motor` numbers motors, transmissions and sensors, 0 the link's, both or none."""

    effect: str
    site: Site
    joint: str
    motor: int = 0


class Cause(Record):
    """One effect at one location, with the evidence for it."""

    effect: str
    site: Site
    joint: str
    motor: int = 0
    probability: Share
    share: Share  # of resampled comparisons in which it is in the best model, ties shared
    parameters: dict[str, Value]
    combinations: tuple[Combination, ...] = ()
    left: Number  # squared held-out error, relative to that of the fitted device parameters alone; 0 explains all
    score: Number  # mean loss of the held-out segments, see docs/method.md
    without: Number | None = None  # `left` of the repair without this effect, if the repair has further effects

    @property
    def place(self) -> EffectLocation:
        return EffectLocation(effect=self.effect, site=self.site, joint=self.joint, motor=self.motor)


class NuisanceValue(Record):
    """A device parameter as filed and as fitted together with the effects."""

    name: str
    unit: str
    filed: Number
    fitted: Number
    offset: Number  # fitted minus filed, in standard deviations of the tolerance
    at_bound: bool
    low: Number | None = None  # of the range it was fitted in
    high: Number | None = None

    @model_validator(mode="after")
    def _is_a_factor(self) -> NuisanceValue:
        if self.filed == 0.0 and self.fitted != 0.0:
            raise ValueError(f"{self.name}: filed as 0 and fitted as {self.fitted:g}, which is no factor")
        return self


class LogInterval(Record):
    """Part of a log; [s] since its first sample.

    It includes the sample at `begin`; the one at `end` only where the log ends.
    """

    log: str
    begin: Number
    end: Number


class Proposal(Record):
    """The short motion that separates the tied causes best."""

    separates: tuple[EffectLocation, ...]
    expected_disagreement: Number  # [-] between their predictions, in units of the noise
    duration: Number  # [s]
    file: str  # with its commands; empty: not written
    motion: str = ""  # its name
    text: str = ""  # which motion, why, and what the log must contain
    separable: bool = True  # whether a diagnosis of such a log is expected to separate them


class GapReport(Record):
    """The answer, the evidence, and everything that pages and texts show."""

    version: Literal["3"] = "3"
    joint: str
    level: Level
    logs: tuple[str, ...]
    holdout: tuple[str, ...]  # names of the held-out logs, or 'blocks of the same logs'
    verdict: Verdict
    reason: str = ""  # why nothing is named, for the verdict cannot_tell
    explained: Share = 0.0  # fraction of the explainable error that the named effects explain
    where: tuple[Where, ...]
    causes: tuple[Cause, ...]
    equivalence_set: tuple[EffectLocation, ...]  # the named causes and those tied with them on held-out data
    # contains the true cause in 95 % of cases like the calibration's; None: no cause is named, or no set is known
    conformal_set: tuple[EffectLocation, ...] | None = None
    effects: tuple[EffectLocation, ...]  # the repair, its main effect first
    gap: Gap | None
    nuisance: tuple[NuisanceValue, ...]
    data_check: tuple[Finding, ...]
    noise: tuple[Noise, ...] = ()
    not_evaluated: tuple[str, ...]  # what this log cannot show, in sentences
    proposal: Proposal | None = None
    figures: Figures | None = None
    part: LogInterval | None = None  # where the effects act, and what all numbers are about; None: the whole log
    held_out: tuple[LogInterval, ...] = ()  # where `gap` was measured
    # [s] by which commands act late on lines between samples; negative: measured torques are late; None: in steps
    lined: Number | None = None
    widened: NotNegative = 1.0  # factor of the standard deviations of named parameters, by calibration
    # `left` of a main effect on half of the motion when fitted to the other, by what divides it
    transfer: dict[str, NotNegative] = Field(default_factory=dict)
    # parameters of the main effect, fitted to either half of the motion between which it transfers worst
    halves: dict[str, tuple[Number, Number]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _repair_is_among_the_causes(self) -> GapReport:
        known = {(c.effect, c.site, c.motor) for c in self.causes}
        for place in self.effects:
            if (place.effect, place.site, place.motor) not in known:
                raise ValueError(f"effects: {place.effect} at {place.site} {place.motor} is not among the causes")
        return self

    def to_json(self) -> str:
        return self.model_dump_json(indent=2)

    @property
    def by_equations(self) -> bool:
        """Whether the gap was measured by inverse dynamics."""
        return self.gap is not None and self.gap.by == "inverse dynamics"

    def as_read(self, logs: Sequence[JointLog]) -> list[JointLog]:
        """Logs with commands as this report took them between samples."""
        return [log if self.lined is None else in_lines(log, self.lined) for log in logs]

    def repair(self) -> tuple[Effect, ...]:
        """The named effects with their values, as via_sim takes them."""
        by_place = {(c.effect, c.site, c.motor): c for c in self.causes}
        found = []
        for place in self.effects:
            cause = by_place[(place.effect, place.site, place.motor)]
            values = {name: value.value for name, value in cause.parameters.items()}
            found.append(Effect(cause.effect, cause.site, values, cause.motor))
        return tuple(found)

    def repaired(self) -> tuple[Effect, ...]:
        """The named effects and the fitted device parameters: a simulator with both has the gap `after`."""
        moved = {n.name: n.fitted / n.filed for n in self.nuisance if n.fitted != n.filed}
        return (*self.repair(), *((Effect(DEVICE_NUMBERS.name, "device", moved),) if moved else ()))

    def intervals(self) -> tuple[dict[str, tuple[float, float]], ...]:
        """95 % intervals of the parameters of each effect in `repair`, within their bounds."""
        known = {(c.effect, str(c.site), c.motor): c.parameters for c in self.causes}
        return tuple(
            {
                p.name: (max(p.low, v.value - DEVIATIONS * v.sd), min(p.high, v.value + DEVIATIONS * v.sd))
                for p in effect.kind.all_parameters
                if p.name in effect.parameters
                for v in (known[effect.name, effect.site, effect.motor][p.name],)
            }
            for effect in self.repair()
        )


def save_repair(report: GapReport, path: str | Path) -> None:
    """Write the effects file that repairs the simulator. Raises ParameterError if it cannot be written."""
    save_effects(path, report.repaired(), report.intervals())


def read_report(text: str, file: str) -> GapReport:
    """The report in JSON `text`; `file` is the name that errors show. Raises ParameterError."""
    try:
        return GapReport.model_validate_json(text)
    except ValidationError as error:
        raise ParameterError(f"{file}: not a gap report: {problems(error, 1)}") from None
    except ValueError as error:
        raise ParameterError(f"{file}: not a gap report: {' '.join(str(error).split())}") from None
