"""One report against one key: what was asked, what was answered, what is right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

VERDICTS = ("effect", "two_effects", "no_gap", "unknown", "cannot_tell")
NUMBERED = ("motor", "transmission")  # sites whose number counts from 1: 0 says that it is not told
READINGS = ("sensor", "timing")  # sites whose number 0 is the link


@dataclass(frozen=True)
class Place:
    effect: str
    site: str
    motor: int

    def __str__(self) -> str:
        return f"{self.effect} at {self.site}{f' {self.motor}' if self.motor else ''}"


@dataclass(frozen=True)
class Judged:
    """A case as asked and as answered. None: does not apply to this case, or was not told."""

    name: str
    kind: str  # single, no_gap, unknown, pair, limited
    level: str
    family: str
    truths: tuple[Place, ...]
    ratio: float  # gap over noise
    verdict: str  # '': there is no report
    named: tuple[Place, ...]  # causes, best first
    probability: float | None  # of the first
    tied: tuple[Place, ...]  # the equivalence set
    where: tuple[tuple[str, int], ...]  # sites and numbers, largest share first
    where_right: bool | None
    top1: bool | None
    place_right: bool | None  # top-1 with site and number
    in_set: bool | None
    both: bool | None  # of a pair
    closes: float | None
    predicted: float | None  # share of the gap that goes
    measured: float | None  # the same on the withheld log
    measured_closes: float | None
    seconds: float | None
    trouble: str = ""
    seed: int | None = None

    @property
    def answered(self) -> bool:
        """Whether it named a cause."""
        return self.verdict in ("effect", "two_effects") and bool(self.named)

    @property
    def right(self) -> bool:
        """Whether the answer is the one that counts for this kind of case."""
        if self.kind == "no_gap":
            return self.verdict == "no_gap"
        if self.kind == "unknown":
            return self.verdict == "unknown"
        if self.kind == "pair":
            return bool(self.both)
        return bool(self.top1)


@dataclass(frozen=True)
class Shrinkage:
    """The gap on the withheld log, before and after the repair; `floor` is what the sensors leave, where it is told."""

    before: float
    after: float
    floor: float | None = None

    @property
    def share(self) -> float | None:
        return 1.0 - self.after / self.before if self.before > 0.0 else None

    @property
    def closes(self) -> float | None:
        """Share of what can be closed."""
        if self.floor is None or not self.before > self.floor:
            return None
        return (self.before - self.after) / (self.before - self.floor)


def judge(
    name: str, key: dict[str, Any], report: dict[str, Any] | None, withheld: Shrinkage | None, seconds: float | None,
    trouble: str = "",
) -> Judged:  # fmt: skip
    """What became of a case. A missing report is an answer that is wrong everywhere."""
    truths = tuple(Place(each["effect"], each["site"], each["motor"]) for each in key["effects"])
    told = report or {}
    verdict = told.get("verdict", "")
    named = tuple(map(_place, told.get("causes", ())))
    tied = tuple(dict.fromkeys(map(_place, told.get("equivalence_set", ()))))
    where = tuple((each["site"], int(each.get("motor", 0))) for each in told.get("where", ()))
    answers = verdict in ("effect", "two_effects") and bool(named)
    gap = told.get("gap") or {}
    where_right = top1 = place_right = in_set = both = None
    if key["kind"] in ("single", "limited"):
        (truth,) = truths
        where_right = bool(where) and _same_site(where[0], truth)
        top1 = answers and named[0].effect == truth.effect
        place_right = answers and _same_place(named[0], truth)
        in_set = answers and truth.effect in {each.effect for each in (named[0], *tied)}
    if key["kind"] == "pair":
        places = where[:2]
        where_right = all(any(_same_site(each, truth) for each in places) for truth in truths)
        found = {each.effect for each in named[:2]}
        both = verdict == "two_effects" and {truth.effect for truth in truths} == found
        in_set = verdict == "two_effects" and {truth.effect for truth in truths} <= found | {p.effect for p in tied}
    return Judged(
        name=name,
        kind=key["kind"],
        level=key["level"],
        family=key["family"],
        truths=truths,
        ratio=key["ratio"],
        verdict=verdict,
        named=named,
        probability=float(told["causes"][0]["probability"]) if named else None,
        tied=tied,
        where=where,
        where_right=where_right,
        top1=top1,
        place_right=place_right,
        in_set=in_set,
        both=both,
        closes=gap.get("closes"),
        predicted=1.0 - gap["after"] / gap["before"] if gap.get("before") else None,
        measured=withheld.share if withheld is not None else None,
        measured_closes=withheld.closes if withheld is not None else None,
        seconds=seconds,
        trouble=trouble,
        seed=key.get("seed"),
    )


def _place(told: dict[str, Any]) -> Place:
    return Place(told["effect"], told["site"], int(told.get("motor", 0)))


def _same_site(where: tuple[str, int], truth: Place) -> bool:
    """A number counts where the site has one and the report tells one."""
    site, number = where
    untold = number == 0 and site in NUMBERED
    return site == truth.site and (number == truth.motor or untold or site not in (*NUMBERED, *READINGS))


def _same_place(named: Place, truth: Place) -> bool:
    return named.effect == truth.effect and _same_site((named.site, named.motor), truth)
