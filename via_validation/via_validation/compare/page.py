"""The comparison as decision table, full tables, picture, page, and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import isfinite
from pathlib import Path
from typing import Any

from via_controllers.joints.multisine import Multisine

from via_validation.compare import decision
from via_validation.compare.experiment import EQUILIBRIUM, PRESET
from via_validation.compare.figures import CONVERGED, START, WITHIN
from via_validation.compare.run import WRONG_LEVEL, WRONG_SEEDS, Case, Comparison
from via_validation.provenance import Provenance
from via_validation.tables.page import small_copy
from via_validation.template import write_page

DECISION = ("device", "noise", "use", "error [%]", "in 95 % interval", "converged [s]", "cost [us]", "the default")
SAME = "the same"
UNUSABLE = "(no usable interval)"
TITLES = ("method", "error [%] {}", "converged [s]", "in 95 % interval", "sd / scatter", "sd / error", "OK [%]",
          "wrong motors [%]", "cost [us]", "seeds")  # fmt: skip


def decision_rows(comparison: Comparison) -> Iterator[list[str]]:
    """One row per device and level: the best method and its figures, then those of the default."""
    for device in comparison.devices:
        for level in comparison.levels:
            cases = comparison.of(device, level.name)
            best, default = decision.best(cases), decision.default_case(comparison, device, level.name)
            note = "" if decision.usable(best) else f" {UNUSABLE}"
            yield [device, level.name, best.method + note, *_summary(best), _beside(default, best)]


def other_rules(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Titles and rows: what every other rule would choose; empty where it is the same."""
    rows = []
    for device in comparison.devices:
        for level in comparison.levels:
            cases = comparison.of(device, level.name)
            best, words = decision.best(cases).method, []
            for rule in decision.OTHER_RULES.values():
                other = rule(cases)
                words.append("-" if other is None else other.method if other.method != best else SAME)
            rows.append([device, level.name, best, *words])
    return ["device", "noise", "use", *decision.OTHER_RULES], rows


def titles(comparison: Comparison, level: str) -> list[str]:
    """Column titles of `level_rows`, with one column of errors per joint; wrong motors at one level only."""
    shown = [each for each in TITLES if level == WRONG_LEVEL or not each.startswith("wrong")]
    return [each.format(device) for each in shown for device in (comparison.devices if "{}" in each else ("",))]


def level_rows(comparison: Comparison, level: str) -> Iterator[list[str]]:
    """One row of cells per method; except for the errors, cells are the worst or the range over all joints."""
    for method in comparison.methods:
        cases = [comparison.case(method, device, level) for device in comparison.devices]
        wrong = [case.wrong_motors for case in cases if case.wrong_motors is not None]
        yield [
            method,
            *(percent(case.figures.accuracy) for case in cases),
            seconds(max(case.figures.convergence for case in cases)),
            value_range(case.figures.coverage for case in cases),
            value_range(case.figures.over_scatter for case in cases),
            value_range(case.figures.over_error for case in cases),
            percent(min(case.figures.trusted for case in cases)),
            *([percent(max(wrong))] if wrong else []),
            f"{max(case.cost for case in cases):.2g}",
            value_range(case.seeds for case in cases),
        ]


def _summary(case: Case) -> list[str]:
    return [
        percent(case.figures.accuracy),
        f"{case.figures.coverage:.2f}" if isfinite(case.figures.coverage) else "-",
        seconds(case.figures.convergence),
        f"{case.cost:.2g}",
    ]


def _beside(case: Case | None, best: Case) -> str:
    if case is None or case.method == best.method:
        return SAME
    error, coverage, converged, cost = _summary(case)
    unit = "" if converged == "never" else " s"
    return f"{case.method}: error {error} %, interval {coverage}, converged {converged}{unit}, {cost} us"


def percent(share: float) -> str:
    """A share as a number of percent with three digits."""
    return f"{100.0 * share:.3g}" if isfinite(share) else "-"


def seconds(value: float) -> str:
    """Whole seconds, 'never' for infinity."""
    return f"{value:.0f}" if isfinite(value) else "never"


def value_range(values: Iterable[float]) -> str:
    """Range of the finite values with two digits; '-' without any."""
    finite = [value for value in values if isfinite(value)]
    if not finite:
        return "-"
    low, high = (f"{float(f'{value:.2g}'):g}" for value in (min(finite), max(finite)))
    return low if low == high else f"{low} .. {high}"


def as_json(comparison: Comparison, source: Provenance) -> dict[str, Any]:
    """Everything except the examples; infinite and missing numbers are null."""

    def number(value: float | None) -> float | None:
        return value if value is not None and isfinite(value) else None

    return {
        "provenance": vars(source),
        "seeds": comparison.seeds,
        "budget_s": comparison.budget,
        "levels": {level.name: str(level) for level in comparison.levels},
        "defaults": comparison.defaults,
        "best": {
            device: {level.name: decision.best(comparison.of(device, level.name)).method for level in comparison.levels}
            for device in comparison.devices
        },
        "cases": [
            {
                "method": case.method,
                "device": case.device,
                "level": case.level,
                **{name: number(value) for name, value in vars(case.figures).items()},
                "wrong_motors": number(case.wrong_motors),
                "cost_us": case.cost,
                "seeds": case.seeds,
            }
            for case in comparison.cases
        ],
    }


def write_markdown(comparison: Comparison, picture: Path, source: Provenance, path: Path) -> None:
    """Write the page, with a small copy of the picture beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    target = path.with_suffix(".png")
    small_copy(picture, target)
    rows = list(decision_rows(comparison))
    values = {
        "c": comparison,
        "decision_titles": DECISION,
        "decision": rows,
        "best_default": sum(row[-1] == SAME for row in rows),
        "replaced": decision.replaced(comparison),
        "others": other_rules(comparison),
        "tables": [(level, titles(comparison, level.name), list(level_rows(comparison, level.name)))
                   for level in comparison.levels],
        "source": source,
        "picture": target.name,
        "equilibrium": _tones(EQUILIBRIUM),
        "preset": _tones(PRESET),
        "converged": CONVERGED,
        "start": START,
        "within": 100.0 * WITHIN,
        "wrong_level": WRONG_LEVEL,
        "wrong_seeds": WRONG_SEEDS,
        "unusable": UNUSABLE,
        "rule": {name.lower(): 100.0 * getattr(decision, name) for name in ("HONEST", "TRUSTED", "EQUAL")},
    }  # fmt: skip
    write_page(path, "compare/page.md", values)


def _tones(reference: Multisine) -> str:
    amplitudes, frequencies = (
        ", ".join(f"{x:g}" for x in part) for part in (reference.amplitudes, reference.frequencies)
    )
    return f"{reference.mean:g} rad with tones of {amplitudes} rad at {frequencies} Hz"
