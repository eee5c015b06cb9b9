"""One report compared with one key: the case, the answer, and which parts of it are right by `rightness`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from via_validation.sealed.intervals import Inside, intervals_hold
from via_validation.sealed.rightness import ANSWERS, FORMER, MOST_TIED, Place, covered, names, places, same_site


@dataclass(frozen=True)
class Judged:
    """A case and its answer. None: does not apply to this case, or is not in the report."""

    name: str
    kind: str  # single, no_gap, unknown, pair
    level: str  # signal set
    dirty: bool  # a small unmodelled effect acts beside the truths
    quality: str  # of the recording: good, degraded
    family: str
    truths: tuple[Place, ...]
    ratio: float  # gap over noise
    verdict: str  # '': there is no report
    named: tuple[Place, ...]  # causes, best first
    probability: float | None  # of the first
    tied: tuple[Place, ...]  # the equivalence set
    conformal: tuple[Place, ...] | None  # the conformal set
    where: tuple[tuple[str, int], ...]  # sites and numbers, largest share first
    where_right: bool | None
    first_right: bool  # the first cause names a truth, for any verdict
    top1: bool | None  # a cause is named, and the first one is the truth
    place_right: bool | None  # top-1 with site and number
    in_set: bool | None  # a cause is named, and the truth is the first one or in the equivalence set
    in_conformal: bool | None  # every truth is in the conformal set
    both: bool | None  # of a pair: both and nothing else named
    explained: float | None  # fraction of the explainable error, as reported
    predicted: float | None  # reported relative decrease of the gap
    measured: float | None  # the same, measured on the withheld log
    measured_explained: float | None
    inside: tuple[Inside, ...]  # parameters of the effects that were named at the right location
    seconds: float | None
    trouble: str = ""
    seed: int | None = None

    @property
    def answered(self) -> bool:
        """Whether it named a cause."""
        return self.verdict in ANSWERS and bool(self.named)

    @property
    def tied_right(self) -> bool | None:
        """Whether the truth is named, or tied in a set of at most MOST_TIED causes."""
        return None if self.in_set is None else bool(self.top1 or (self.in_set and len(self.tied) <= MOST_TIED))

    @property
    def main_right(self) -> bool:
        """Whether the first cause is one of the truths, and the verdict names it."""
        return self.answered and self.first_right

    @property
    def confidently_wrong(self) -> bool:
        """A wrong first cause with probability .5 or more."""
        return self.answered and not self.first_right and (self.probability or 0.0) >= 0.5

    @property
    def alarmed(self) -> bool:
        """Whether it claims that there is a gap."""
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
    """The gap on the withheld log, before and after the repair; `floor`: what sensor noise leaves, if known."""

    before: float
    after: float
    floor: float | None = None

    @property
    def share(self) -> float | None:
        return 1.0 - self.after / self.before if self.before > 0.0 else None

    @property
    def explained(self) -> float | None:
        """Fraction of the explainable error: what the sensors leave cannot be explained."""
        if self.floor is None or not self.before > self.floor:
            return None
        return (self.before - self.after) / (self.before - self.floor)


def judge(
    name: str, key: dict[str, Any], report: dict[str, Any] | None, withheld: Shrinkage | None, seconds: float | None,
    trouble: str = "",
) -> Judged:  # fmt: skip
    """The evaluation of a case. A missing report is wrong in every respect."""
    truths = tuple(Place(each["effect"], each["site"], each["motor"]) for each in key["effects"])
    answer, kind, family = report or {}, key["kind"], key["family"]
    verdict = FORMER.get(answer.get("verdict", ""), answer.get("verdict", ""))
    named = tuple(map(_place, answer.get("causes", ())))
    repair = tuple(map(_place, answer.get("effects", ()))) or named[: 2 if verdict == "several_effects" else 1]
    tied = tuple(dict.fromkeys(map(_place, answer.get("equivalence_set", ()))))
    conformal = tuple(map(_place, answer["conformal_set"])) if answer.get("conformal_set") is not None else None
    where = tuple((each["site"], int(each.get("motor", 0))) for each in answer.get("where", ()))
    answers, gap = verdict in ANSWERS and bool(named), answer.get("gap") or {}
    beside = tuple(each for each in repair if each != named[0]) if named else ()
    first_right = bool(named) and any(names(named[0], truth, family, beside) for truth in truths)
    where_right = top1 = place_right = in_set = both = in_conformal = None
    if kind == "single":
        (truth,) = truths
        where_right = bool(where) and same_site(where[0], truth, family)
        top1 = answers and first_right
        place_right = answers and places((named[0], *beside), truth, family)
        in_set = answers and (first_right or any(names(each, truth, family) for each in tied))
    if kind == "pair":
        where_right = all(any(same_site(each, truth, family) for each in where[:2]) for truth in truths)
        several = verdict in ("several_effects", "main_effect") and len(repair) > 1
        both = several and covered(truths, repair, family)
        in_set = several and all(any(names(e, truth, family, repair) for e in (*repair, *tied)) for truth in truths)
    if truths and conformal is not None and kind != "unknown":
        in_conformal = all(any(names(each, truth, family, conformal) for each in conformal) for truth in truths)
    return Judged(
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


def _place(entry: dict[str, Any]) -> Place:
    return Place(entry["effect"], entry["site"], int(entry.get("motor", 0)))
