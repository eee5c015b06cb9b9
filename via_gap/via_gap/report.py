"""GapReport: what a diagnosis found, numbers only; pictures and sentences are made elsewhere.

report = diagnose([log], device)
text = report.to_json()                       # stable; the schema is shipped as gap_report.schema.json
again = GapReport.model_validate_json(text)
"""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from via_core.errors import ParameterError
from via_sim.catalogue import DEVICE_NUMBERS
from via_sim.effects import Effect
from via_sim.effects_file import save_effects

from via_gap.figures import Figures, Quantity

DEVIATIONS = 1.96  # of a normal distribution to either side hold 95 %
SITES = ("command", "motor", "transmission", "link", "sensor", "timing", "environment")
Verdict = Literal["effect", "two_effects", "no_gap", "unknown", "cannot_tell"]
Site = Literal["command", "motor", "transmission", "link", "sensor", "timing", "environment"]
Number = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Region(_Part):
    """A range of one quantity that holds more of the gap than its share of the data."""

    by: Quantity
    unit: str
    low: Number
    high: Number
    share: Share  # of the excess residual energy
    data: Share  # of the samples


class Where(_Part):
    """Where the gap lies; several entries, largest share first."""

    joint: str
    site: Site
    motor: int = 0  # of the motor or transmission; 0 where there is no number
    equation: str  # link, motor 1, motor 2, or simulation where no equation can be looked at
    share: Share
    regions: tuple[Region, ...] = ()


class Value(_Part):
    value: Number
    sd: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    unit: str


class Cause(_Part):
    """One effect at one place, with what speaks for it."""

    effect: str
    site: Site
    joint: str
    motor: int = 0
    probability: Share
    parameters: dict[str, Value]
    left: Number  # of the squared held-out error, relative to the device's tuned numbers alone: 0 explains all
    score: Number  # mean log squared error of the held-out shots, in units of the noise


class Place(_Part):
    effect: str
    site: Site
    joint: str
    motor: int = 0


class SignalGap(_Part):
    """Error of a simulated signal over the standard deviation of the measured one, on held-out data."""

    before: Number
    after: Number
    floor: Number
    ceiling: Number
    closes: Number


class Gap(_Part):
    """The gap over all signals: root mean square of those of each.

    before    the device file as it stands
    tuned     its numbers moved inside their tolerance, no effect
    after     those numbers and the effects named
    interval  95 % of `after`, from resampled blocks
    floor     what the sensors alone leave
    ceiling   what is left by the best this diagnosis reaches: a flexible model of each equation, or the named effects
    closes    (before - after) / (before - ceiling)
    by        'shots': short runs from measured states; 'free run': one run over the whole log;
              'equations': torque that the link's equation lacks, against the drive's
    """

    by: Literal["shots", "free run", "equations"]
    before: Number
    tuned: Number
    after: Number
    interval: tuple[Number, Number]
    floor: Number
    ceiling: Number
    closes: Number
    signals: dict[str, SignalGap]


class NuisanceValue(_Part):
    """A number of the device as filed and as fitted together with the effects."""

    name: str
    unit: str
    filed: Number
    fitted: Number
    deviations: Number  # in standard deviations of its tolerance
    at_bound: bool


class Stretch(_Part):
    """Part of a log that was judged and not fitted; [s] since its first sample.

    The sample at `begin` is in it, that at `end` only where the log ends.
    """

    log: str
    begin: Number
    end: Number


class Finding(_Part):
    """One thing the data check noticed."""

    log: str
    check: str
    signal: str
    severity: Literal["refuse", "downgrade", "note"]
    value: Number
    text: str


class Proposal(_Part):
    """A short motion that would separate the causes that this log cannot."""

    separates: tuple[Place, ...]
    expected_disagreement: Number  # [-] of their predictions, in units of the noise
    duration: Number  # [s]
    file: str  # of its commands, empty until one is written
    motion: str = ""  # its name
    text: str = ""  # which, why, and what the log must hold, in one sentence


class GapReport(_Part):
    version: Literal["1"] = "1"
    joint: str
    level: Literal["full", "no torque", "link only", "commands only", "encoder and command"]
    logs: tuple[str, ...]
    holdout: tuple[str, ...]  # names of logs, or 'blocks of the same logs'
    verdict: Verdict
    where: tuple[Where, ...]
    causes: tuple[Cause, ...]
    equivalence_set: tuple[Place, ...]
    effects: tuple[Place, ...]  # that were added for `after`, in the order they were found
    gap: Gap | None
    nuisance: tuple[NuisanceValue, ...]
    data_check: tuple[Finding, ...]
    not_judged: tuple[str, ...]  # what this log could not show, in plain words
    proposal: Proposal | None = None
    figures: Figures | None = None
    held_out: tuple[Stretch, ...] = ()  # where `gap` was measured

    def to_json(self) -> str:
        return self.model_dump_json(indent=2)

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
        """The named effects and the device numbers fitted beside them: a simulator with these has the gap `after`."""
        moved = {n.name: n.fitted / n.filed for n in self.nuisance if n.fitted != n.filed}
        return (*self.repair(), *((Effect(DEVICE_NUMBERS.name, "device", moved),) if moved else ()))

    def intervals(self) -> tuple[dict[str, tuple[float, float]], ...]:
        """95 % of the parameters of each effect in `repair`, within their bounds."""
        known = {(c.effect, str(c.site), c.motor): c.parameters for c in self.causes}
        return tuple(
            {
                p.name: (max(p.low, v.value - DEVIATIONS * v.sd), min(p.high, v.value + DEVIATIONS * v.sd))
                for p in effect.kind.parameters
                for v in (known[effect.name, effect.site, effect.motor][p.name],)
            }
            for effect in self.repair()
        )


def save_repair(report: GapReport, path: str | Path) -> None:
    """The effects file that repairs the simulator. Raises ParameterError where it cannot be written."""
    save_effects(path, report.repaired(), report.intervals())


def read_report(text: str, file: str) -> GapReport:
    """The report in JSON `text`; `file` is the name that errors show. Raises ParameterError."""
    try:
        return GapReport.model_validate_json(text)
    except ValueError as error:
        first = str(error).splitlines()
        raise ParameterError(f"{file}: is no gap report: {' '.join(first[:3])}") from None


def shipped_schema() -> dict[str, Any]:
    """The JSON schema that is shipped with the package."""
    return json.loads(resources.files("via_gap").joinpath("gap_report.schema.json").read_text(encoding="utf-8"))
