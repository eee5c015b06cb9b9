"""Evaluation of one report against one key: which parts of the answer are right, as defined in `rightness`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from via_validation.sealed.intervals import IntervalCheck, intervals_hold
from via_validation.sealed.rightness import ANSWERS, FORMER, MOST_TIED, Cause, covered, locates, names, same_site


@dataclass(frozen=True)
class Evaluation:
    """A case and its answer. None: not applicable to this case, or not in the report."""

    name: str
    kind: str  # single, no_gap, unknown, pair
    level: str  # signal set
    dirty: bool  # a small unmodelled effect acts as well
    quality: str  # of the recording: good, degraded
    family: str
    truths: tuple[Cause, ...]
    ratio: float  # gap over noise
    verdict: str  # '': no report
    named: tuple[Cause, ...]  # causes, best first
    probability: float | None  # of the first cause
    tied: tuple[Cause, ...]  # the equivalence set
    conformal: tuple[Cause, ...] | None  # the conformal set
    where: tuple[tuple[str, int], ...]  # (site, number), largest share of the gap first
    where_right: bool | None
    first_right: bool  # the first cause names a truth, whatever the verdict
    top1: bool | None  # a cause is named, and the first one is the truth
    place_right: bool | None  # top1, and site and number are right
    in_set: bool | None  # a cause is named, and the truth is the first cause or in the equivalence set
    in_conformal: bool | None  # every truth is in the conformal set
    both: bool | None  # for a pair: both causes and nothing else are named
    explained: float | None  # fraction of the explainable error, as reported
    predicted: float | None  # reported relative decrease of the gap
    measured: float | None  # decrease measured on the withheld log
    measured_explained: float | None
    inside: tuple[IntervalCheck, ...]  # parameters of effects named at the right location
    seconds: float | None
    trouble: str = ""
    seed: int | None = None

    @property
    def answered(self) -> bool:
        """Whether the answer names a cause."""
        return self.verdict in ANSWERS and bool(self.named)

    @property
    def tied_right(self) -> bool | None:
        """Whether the truth is named, or in an equivalence set of at most MOST_TIED causes."""
        return None if self.in_set is None else bool(self.top1 or (self.in_set and len(self.tied) <= MOST_TIED))

    @property
    def main_right(self) -> bool:
        """Whether the verdict names a cause, and the first cause is one of the truths."""
        return self.answered and self.first_right

    @property
    def confidently_wrong(self) -> bool:
        """Whether a wrong first cause has a probability of .5 or more."""
        return self.answered and not self.first_right and (self.probability or 0.0) >= 0.5

    @property
    def alarmed(self) -> bool:
        """Whether the answer claims a gap."""
        return self.verdict in (*ANSWERS, "unknown")

    @property
    def right(self) -> bool:
        """Whether the answer is right for this kind of case."""
        if self.kind in ("no_gap", "unknown"):
            return self.verdict == self.kind
        if self.kind == "pair":
            return bool(self.both)
        return bool(self.top1)


@dataclass(frozen=True)
class Shrinkage:
    """The gap on the withheld log before and after the repair; `floor`: gap from sensor noise alone, if known."""

    before: float
    after: float
    floor: float | None = None

    @property
    def share(self) -> float | None:
        return 1.0 - self.after / self.before if self.before > 0.0 else None

    @property
    def explained(self) -> float | None:
        """Fraction explained of the error above sensor noise."""
        if self.floor is None or not self.before > self.floor:
            return None
        return (self.before - self.after) / (self.before - self.floor)


def evaluate(
    name: str, key: dict[str, Any], report: dict[str, Any] | None, withheld: Shrinkage | None, seconds: float | None,
    trouble: str = "",
) -> Evaluation:  # fmt: skip
    """The evaluation of a case. A missing report is wrong in all respects.

    seconds  time of the diagnosis
    trouble  why there is no report or no measurement
    """
    truths = tuple(Cause(each["effect"], each["site"], each["motor"]) for each in key["effects"])
    answer, kind, family = report or {}, key["kind"], key["family"]
    verdict = FORMER.get(answer.get("verdict", ""), answer.get("verdict", ""))
    named = tuple(map(_place, answer.get("causes", ())))
    repair = tuple(map(_place, answer.get("effects", ()))) or named[: 2 if verdict == "several_effects" else 1]
    tied = tuple(dict.fromkeys(map(_place, answer.get("equivalence_set", ()))))
    conformal = tuple(map(_place, answer["conformal_set"])) if answer.get("conformal_set") is not None else None
    where = tuple((each["site"], int(each.get("motor", 0))) for each in answer.get("where", ()))
    answers, gap = verdict in ANSWERS and bool(named), answer.get("gap") or {}
    others = tuple(each for each in repair if each != named[0]) if named else ()
    first_right = bool(named) and any(names(named[0], truth, family, others) for truth in truths)
    where_right = top1 = place_right = in_set = both = in_conformal = None
    if kind == "single":
        (truth,) = truths
        where_right = bool(where) and same_site(where[0], truth, family)
        top1 = answers and first_right
        place_right = answers and locates((named[0], *others), truth, family)
        in_set = answers and (first_right or any(names(each, truth, family) for each in tied))
    if kind == "pair":
        where_right = all(any(same_site(each, truth, family) for each in where[:2]) for truth in truths)
        several = verdict in ("several_effects", "main_effect") and len(repair) > 1
        both = several and covered(truths, repair, family)
        in_set = several and all(any(names(e, truth, family, repair) for e in (*repair, *tied)) for truth in truths)
    if truths and conformal is not None and kind != "unknown":
        in_conformal = all(any(names(each, truth, family, conformal) for each in conformal) for truth in truths)
    return Evaluation(
        name=name,
        kind=kind,
        level=key["level"],
        dirty=key.get("dirt") is not None,
        quality=key.get("quality", "good"),
        family=family,
        truths=truths,
        ratio=key["ratio"],
        verdict=verdict,
        named=named,
        probability=float(answer["causes"][0]["probability"]) if named else None,
        tied=tied,
        conformal=conformal,
        where=where,
        where_right=where_right,
        first_right=first_right,
        top1=top1,
        place_right=place_right,
        in_set=in_set,
        in_conformal=in_conformal,
        both=both,
        explained=gap.get("explained"),
        predicted=1.0 - gap["after"] / gap["before"] if gap.get("before") else None,
        measured=withheld.share if withheld is not None else None,
        measured_explained=withheld.explained if withheld is not None else None,
        inside=intervals_hold(key["effects"], answer.get("causes", ()), repair, family) if answers else (),
        seconds=seconds,
        trouble=trouble,
        seed=key.get("seed"),
    )


def _place(entry: dict[str, Any]) -> Cause:
    return Cause(entry["effect"], entry["site"], int(entry.get("motor", 0)))
