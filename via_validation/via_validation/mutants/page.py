"""The page of mutations: how many the tests killed, and which survived."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from via_validation.mutants.operators import Mutation
from via_validation.mutants.running import Limits, Outcome
from via_validation.provenance import Provenance
from via_validation.template import write_page

WANTED = 0.95  # [-] of the mutations that are not equivalent


@dataclass(frozen=True)
class Results:
    """Outcomes of a run: of the sample and of the named mutations."""

    sample: Sequence[Outcome]
    named: Sequence[Outcome]
    equivalent: Collection[Mutation]  # of the list, which are not run
    available: int
    modules: int
    seed: int
    limits: Limits

    def counts(self, outcomes: Sequence[Outcome]) -> tuple[int, int, int, int]:
        """Mutations, killed, equivalent and survived."""
        equivalent = sum(each.mutation in self.equivalent for each in outcomes)
        killed = sum(bool(each.killed_by) for each in outcomes)
        return len(outcomes), killed, equivalent, len(outcomes) - killed - equivalent

    @property
    def survivors(self) -> list[Outcome]:
        every = [*self.named, *self.sample]
        return [each for each in every if not each.killed_by and each.mutation not in self.equivalent]


def summary(results: Results) -> list[list[str]]:
    """Rows of the first table: the sample, the named mutations, both."""
    rows = []
    for title, outcomes in (
        ("sample", results.sample), ("named", results.named), ("both", [*results.sample, *results.named]),
    ):  # fmt: skip
        count, killed, equivalent, survived = results.counts(outcomes)
        share = f"{100.0 * killed / max(count - equivalent, 1):.1f} %"
        rows.append([title, f"{count}", f"{killed}", f"{equivalent}", f"{survived}", share])
    return rows


def write(results: Results, source: Provenance, path: Path) -> None:
    """Write the page."""
    count, killed, equivalent, _ = results.counts([*results.sample, *results.named])
    share = killed / max(count - equivalent, 1)
    modules: tuple[Counter[str], ...] = Counter(), Counter(), Counter()
    for each in (*results.sample, *results.named):
        kind = 0 if each.killed_by else 2 if each.mutation in results.equivalent else 1
        modules[kind][each.mutation.path] += 1
    names = sorted({name for each in modules for name in each})
    values = {
        "count": count,
        "summary": summary(results),
        "wanted": f"{100.0 * WANTED:g}",
        "verdict": f"{'Kept' if share >= WANTED else '**Missed**'}: {100.0 * share:.1f} %.",
        "seed": results.seed,
        "available": results.available,
        "modules": results.modules,
        "seconds": results.limits.seconds,
        "per_file": results.limits.per_file,
        "survivors": results.survivors,
        "by_module": [[f"`{name}`", *(each[name] for each in modules)] for name in names],
        "source": source,
    }
    write_page(path, "mutants/page.md", values)
