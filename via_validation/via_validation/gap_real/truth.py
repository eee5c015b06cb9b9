"""What is documented of a real robot, and how a report is judged by it.

    named         every documented cause is named
    rightly tied  those that are not named are in the set of causes that the recordings do not tell apart
    silent        a documented cause is missing, and nothing is named that the documentation contradicts or lacks
    wrong         something else is named in place of it, a cause that the documentation contradicts, or an answer that
                  claims to be complete (`effect`, `several_effects`) lacks a documented cause
    honest        of a control: no cause is named that the documentation contradicts

Only named causes count, not the ranking: a report that names nothing is not wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from via_gap.report.report import Cause, EffectLocation, GapReport, Value

Outcome = Literal["named", "rightly tied", "silent", "wrong", "honest"]
COMPLETE = ("effect", "several_effects")  # verdicts that everything is explained
NAMING = (*COMPLETE, "main_effect")
CONFIDENT = 0.5  # probability from which a wrong first cause is a lie: more likely than not
# Size of an effect: the product of these parameters. A payload's mass and arm are known apart far worse than m l.
SIZE = {
    "coulomb_friction": ("torque",),
    "stribeck_friction": ("kinetic",),
    "presliding_friction": ("torque",),
    "load_dependent_friction": ("coefficient",),
    "actuator_delay": ("delay",),
    "torque_saturation": ("limit",),
    "payload": ("mass", "distance"),
}
FACTOR = 2.0  # that a size may be off: the double pendulum's own two documents differ by 2.4 in its dry friction


@dataclass(frozen=True)
class Truth:
    """The documented causes of one case.

    text       what is documented, for the page
    causes     each must be named; one of the effects of each suffices
    also       effects that are documented as well and need not be named
    refuted    effects that the documentation contradicts
    verdicts   the only verdicts that are right; empty: any
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
    """Size of a named effect beside the documented one [same unit]."""

    effect: str
    found: float
    documented: float

    @property
    def off(self) -> bool:
        """Whether it differs by more than FACTOR, or in sign."""
        ratio = self.found / self.documented
        return not 1.0 / FACTOR <= ratio <= FACTOR


def outcome(report: GapReport, truth: Truth) -> Outcome:
    """The report judged by what is documented."""
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


def lies(report: GapReport, truth: Truth) -> bool:
    """Whether a wrong answer is given with a probability of CONFIDENT or more."""
    first = max((each.probability for each in named_causes(report)), default=0.0)
    return outcome(report, truth) == "wrong" and first >= CONFIDENT


def named_causes(report: GapReport) -> list[Cause]:
    """The causes that the report names, as it ranks them; none where its verdict names nothing."""
    if report.verdict not in NAMING:
        return []
    places = {_spot(each) for each in report.effects}
    return [each for each in report.causes if _spot(each) in places]


def sizes(causes: Sequence[Cause], truth: Truth) -> list[Size]:
    """Sizes of those causes whose size is documented."""
    return [
        Size(cause.effect, found, truth.sizes[cause.effect])
        for cause in causes
        if cause.effect in truth.sizes and (found := size(cause.effect, cause.parameters)) is not None
    ]


def size(effect: str, parameters: Mapping[str, Value]) -> float | None:
    """Size of an effect [SI]; None where none is defined."""
    names = SIZE.get(effect, ())
    if not names or any(name not in parameters for name in names):
        return None
    product = 1.0
    for name in names:
        product *= parameters[name].value
    return product


def _documented_order(cause: Cause, truth: Truth) -> bool:
    """Whether one of a ripple's orders is documented; true of other effects."""
    orders = [round(value.value) for name, value in cause.parameters.items() if name.startswith("order")]
    return not orders or not truth.orders or bool(set(orders) & set(truth.orders))


def _spot(each: Cause | EffectLocation) -> tuple[str, str, int]:
    return each.effect, each.site, each.motor
