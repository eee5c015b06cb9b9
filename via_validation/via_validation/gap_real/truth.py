"""Documented causes of a real robot, and the outcome of a report compared with them.

    named         every documented cause is named
    rightly tied  documented causes that are not named are in the set of causes that the recordings do not distinguish
    silent        a documented cause is missing, and no undocumented or contradicted cause is named
    wrong         an undocumented cause is named instead, a contradicted cause is named, or an answer that claims to be
                  complete (`effect`, `several_effects`) lacks a documented cause
    honest        in a control, no contradicted cause is named

Only named causes count, not the ranking: a report that names nothing is not wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from via_gap.report.report import Cause, EffectLocation, GapReport, Value

Outcome = Literal["named", "rightly tied", "silent", "wrong", "honest"]
COMPLETE = ("effect", "several_effects")  # verdicts that claim a complete explanation
NAMING = (*COMPLETE, "main_effect")
CONFIDENT = 0.5  # a wrong first cause is confidently wrong from this probability on
# Size of an effect: product of these parameters. For a payload m l is far better determined than m and l.
SIZE = {
    "coulomb_friction": ("torque",),
    "stribeck_friction": ("kinetic",),
    "presliding_friction": ("torque",),
    "load_dependent_friction": ("coefficient",),
    "actuator_delay": ("delay",),
    "torque_saturation": ("limit",),
    "payload": ("mass", "distance"),
}
FACTOR = 2.0  # largest ratio of sizes; two documents of the double pendulum differ by 2.4 in its dry friction


@dataclass(frozen=True)
class Truth:
    """The documented causes of one case.

    text       documentation in words, for the page
    causes     each must be named by one of its effects
    also       further documented effects, which need not be named
    refuted    effects that the documentation contradicts
    verdicts   the only right verdicts; empty: any
    sizes      documented size of an effect (see SIZE) [its SI unit]
    orders     documented orders of a torque ripple [1/rev]; empty: any
    """

    text: str
    causes: tuple[frozenset[str], ...] = ()
    also: frozenset[str] = frozenset()
    refuted: frozenset[str] = frozenset()
    verdicts: frozenset[str] = frozenset()
    sizes: Mapping[str, float] = field(default_factory=dict)
    orders: tuple[int, ...] = ()

    @property
    def control(self) -> bool:
        """Whether there is no cause to find."""
        return not self.causes


@dataclass(frozen=True)
class Size:
    """Size of a named effect and the documented size [same unit]."""

    effect: str
    found: float
    documented: float

    @property
    def off(self) -> bool:
        """Whether it differs by more than FACTOR, or in sign."""
        ratio = self.found / self.documented
        return not 1.0 / FACTOR <= ratio <= FACTOR


def outcome(report: GapReport, truth: Truth) -> Outcome:
    """The outcome of a report."""
    named = named_causes(report)
    effects = {each.effect for each in named if _documented_order(each, truth)}
    contradicted = {each.effect for each in named} & truth.refuted
    if contradicted or (truth.verdicts and report.verdict not in truth.verdicts):
        return "wrong"
    if truth.control:
        return "honest"
    missing = [each for each in truth.causes if not each & effects]
    if not missing:
        return "named"
    answers = {each.effect for each in named}
    tied = {place.effect for place in report.equivalence_set} - answers
    if named and all(each & tied for each in missing):
        return "rightly tied"
    documented = truth.also.union(*truth.causes) & effects
    return "wrong" if answers - documented or (named and report.verdict in COMPLETE) else "silent"


def confidently_wrong(report: GapReport, truth: Truth) -> bool:
    """Whether the answer is wrong with a probability of CONFIDENT or more."""
    first = max((each.probability for each in named_causes(report)), default=0.0)
    return outcome(report, truth) == "wrong" and first >= CONFIDENT


def named_causes(report: GapReport) -> list[Cause]:
    """The named causes in the order of the report; empty if its verdict names none."""
    if report.verdict not in NAMING:
        return []
    locations = {_location(each) for each in report.effects}
    return [each for each in report.causes if _location(each) in locations]


def sizes(causes: Sequence[Cause], truth: Truth) -> list[Size]:
    """Sizes of the causes with a documented size."""
    return [
        Size(cause.effect, found, truth.sizes[cause.effect])
        for cause in causes
        if cause.effect in truth.sizes and (found := size(cause.effect, cause.parameters)) is not None
    ]


def size(effect: str, parameters: Mapping[str, Value]) -> float | None:
    """Size of an effect [SI]; None if undefined."""
    names = SIZE.get(effect, ())
    if not names or any(name not in parameters for name in names):
        return None
    product = 1.0
    for name in names:
        product *= parameters[name].value
    return product


def _documented_order(cause: Cause, truth: Truth) -> bool:
    """Whether one of a ripple's orders is documented; True for other effects."""
    orders = [round(value.value) for name, value in cause.parameters.items() if name.startswith("order")]
    return not orders or not truth.orders or bool(set(orders) & set(truth.orders))


def _location(each: Cause | EffectLocation) -> tuple[str, str, int]:
    return each.effect, each.site, each.motor
