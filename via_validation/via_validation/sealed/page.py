"""The score as two Markdown pages and a picture: every number with its limit, and every case, misses first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from via_validation.sealed.evaluation import Evaluation
from via_validation.sealed.intervals import IntervalCheck
from via_validation.sealed.scoring import BINS, OVERALL, Bin, Number, Score, parameter_coverage

PAGE, CASES, PICTURE = "gap.md", "gap-cases.md", "gap-reliability.svg"


def as_json(score: Score) -> dict[str, Any]:
    """The score as a JSON object; numbers are not rounded, and the distance of a parameter that is missing is null."""
    return {
        "numbers": [{**asdict(number), "kept": number.kept} for number in score.numbers],
        "reliability": [asdict(each) for each in score.reliability],
        "cases": [
            {**asdict(each), "right": each.right, "inside": [_checked(check) for check in each.inside]}
            for each in score.evaluations
        ],
    }


def _checked(check: IntervalCheck) -> dict[str, Any]:
    return {**asdict(check), "distance": check.distance if isfinite(check.distance) else None}


def write_page(score: Score, folder: Path, origin: str) -> None:
    """Write gap.md with its picture and gap-cases.md into `folder`; `origin` states the commit and the command."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / PAGE).write_text(markdown(score, origin), encoding="utf-8")
    (folder / CASES).write_text(cases_markdown(score, origin), encoding="utf-8")
    (folder / PICTURE).write_text(picture(score.reliability), encoding="utf-8")


def markdown(score: Score, origin: str) -> str:
    evaluations = score.evaluations
    kept = [number.kept for number in score.numbers if number.kept is not None]
    lines = [
        "# Sealed benchmark of the diagnosis",
        "",
        "A second simulator (MuJoCo, no code in common with the diagnosis) drew joints, effects and sizes from seeds,",
        "wrote recordings and nominal device files, and sealed the keys. The diagnosis read only recordings and device",
        "files; then the keys were opened. Gap over noise is the ratio of the residuals of the joint's equations with",
        "and without the effect, evaluated with the true parameters. In addition, inertias, frictions, stiffnesses and",
        "drive gains of the device file are wrong by up to their tolerance, 5 or 10 %. Draws whose effect these errors",
        "can compensate have no gap and were rejected.",
        "",
        "Each case belongs to a signal set: full; no torque; link only (the link's angle and the motor torques);",
        "encoder and command. It is dirty if a small unmodelled effect acts beside the truth, with 5 to 20 % of its",
        "gap, and clean otherwise. A recording is degraded if its stamps, ticks or commands differ from those of the",
        "drive. Limits on naming hold for recordings of good quality, those on false alarms and confidently wrong",
        "answers for all. `rightness.py` defines which answers are right: the same physics under another name is.",
        "",
        "- **where right**: the location that the report lists first is that of the effect (of two: both are",
        "  among the first two). **top-1**: the first named cause is the true effect. **abstained**: the verdict",
        "  is `cannot_tell`.",
        "- **in set**: the true cause is the first one or among those that the data do not separate from it",
        "  (**tied**).",
        "- **confidently wrong**: the first cause is wrong, and its probability is .5 or more.",
        "- **explained**: part of the achievable decrease of the gap that the repair reaches, by the report; *on",
        "  the withheld log*: in a recording of the same joint that the diagnosis never read. **predicted,",
        "  measured shrinkage**: decrease of the gap by the report, and in that recording.",
        "- Families: *rigid*; *controlled motor*: a rotor whose drive works mainly against friction; *position",
        "  drive*; *stiff*, *series elastic*: one spring; *polynomial pair*, *exponential pair*: two motors with",
        "  such springs.",
        "",
        f"{len(evaluations)} cases, {sum(kept)} of {len(kept)} limits kept, {len(score.missed)} cases missed;",
        f"[every case]({CASES}).",
        "",
        f"Made by: {origin}" + _seeds(evaluations),
        "",
        "## The numbers",
        "",
        *_table(_NUMBERS, [_row(number) for number in score.numbers if number.group == OVERALL]),
        "",
        "## By signal set, clean and dirty",
        "",
        *_by_group(score.numbers),
        "## Coverage of the 95 % intervals",
        "",
        *_table(
            ("parameter", "intervals", "hold the truth"),
            [(name, str(count), f"{share:.2f}") for name, count, share in parameter_coverage(evaluations)],
        ),
        "",
        "## Calibration of the probabilities",
        "",
        f"![reliability diagram]({PICTURE})",
        "",
        "The probability is that of the first cause named.",
        "",
        *_table(
            ("stated probability", "answers", "mean", "right"),
            [
                (
                    f"{each.low:.1f} to {each.low + 1 / BINS:.1f}",
                    str(each.count),
                    f"{each.probability:.2f}",
                    f"{each.right:.2f}",
                )
                for each in score.reliability
            ],
        ),
        "",
        "## By effect, by family, by signals, by gap over noise",
        "",
        *_groups(evaluations),
    ]
    return "\n".join(lines) + "\n"


def cases_markdown(score: Score, origin: str) -> str:
    missed = {each.name for each in score.missed}
    others = [each for each in score.evaluations if each.name not in missed]
    lines = [
        "# Sealed benchmark: every case",
        "",
        f"The answers behind the [numbers of the benchmark]({PAGE}), which explains the words of this page.",
        "",
        f"Made by: {origin}" + _seeds(score.evaluations),
        "",
        "## Missed",
        "",
        *(_table(_CASE, [_case(each) for each in score.missed]) if missed else ["None."]),
        "",
        "## Not missed",
        "",
        *(_table(_CASE, [_case(each) for each in others]) if others else ["None."]),
    ]
    return "\n".join(lines) + "\n"


def picture(bins: Sequence[Bin]) -> str:
    """Reliability diagram: stated probability against share of right answers."""
    size, edge = 260, 46
    most = max((each.count for each in bins), default=1)

    def x(value: float) -> float:
        return edge + value * size

    def y(value: float) -> float:
        return 20 + (1.0 - value) * size

    marks = [
        f'<circle cx="{x(each.probability):.1f}" cy="{y(each.right):.1f}" r="{3 + 9 * (each.count / most) ** 0.5:.1f}" '
        f'fill="#1f6fb4" fill-opacity="0.7"><title>{each.count} answers</title></circle>'
        for each in bins
    ]
    ticks = [
        f'<text x="{x(v):.1f}" y="{y(0) + 16:.1f}" text-anchor="middle">{v:.1f}</text>'
        f'<text x="{x(0) - 6:.1f}" y="{y(v) + 4:.1f}" text-anchor="end">{v:.1f}</text>'
        for v in (0.0, 0.5, 1.0)
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{edge + size + 20}" height="{size + 66}" '
        'font-family="sans-serif" font-size="12">'
        f'<rect width="100%" height="100%" fill="#fff"/>'
        f'<rect x="{x(0)}" y="{y(1)}" width="{size}" height="{size}" fill="none" stroke="#888"/>'
        f'<line x1="{x(0)}" y1="{y(0)}" x2="{x(1)}" y2="{y(1)}" stroke="#888" stroke-dasharray="4"/>'
        f"{''.join(ticks)}{''.join(marks)}"
        f'<text x="{x(0.5)}" y="{y(0) + 34}" text-anchor="middle">stated probability [-]</text>'
        f'<text x="14" y="{y(0.5)}" text-anchor="middle" transform="rotate(-90 14 {y(0.5)})">right [-]</text></svg>\n'
    )


_NUMBERS = ("number", "ours", "limit", "cases", "verdict")


def _by_group(numbers: Sequence[Number]) -> list[str]:
    """A table for each group of cases."""
    lines = []
    for group in dict.fromkeys(number.group for number in numbers if number.group != OVERALL):
        rows = [_row(number) for number in numbers if number.group == group]
        lines += [f"### {group[0].upper()}{group[1:]}", "", *_table(_NUMBERS, rows), ""]
    return lines


_CASE = ("case", "truth", "gap over noise", "verdict", "first causes", "where", "gap decrease: predicted, measured")


def _case(each: Evaluation) -> tuple[str, ...]:
    truth = " and ".join(map(str, each.truths)) or "no gap"
    if each.kind == "unknown":
        truth = f"outside the catalogue: {truth}"
    signals = "" if each.level == "full" else f", {each.level.replace('_', ' ')}"
    signals += (", dirty" if each.dirty else "") + (f", {each.quality}" if each.quality != "good" else "")
    first = ", ".join(map(str, each.named[:2])) or "-"
    stated = f" ({each.probability:.2f})" if each.probability is not None else ""
    where = ", ".join(f"{site}{f' {number}' if number else ''}" for site, number in each.where[:2]) or "-"
    decrease = f"{_percent(each.predicted)}, {_percent(each.measured)}"
    verdict = each.verdict.replace("_", " ") or f"no report: {reason(each.trouble)}"
    return each.name, f"{truth} ({each.family}{signals})", f"{each.ratio:.1f}", verdict, first + stated, where, decrease


def _row(number: Number) -> tuple[str, ...]:
    limit = "-" if number.limit is None else f"{'>=' if number.at_least else '<='} {number.limit:g}"
    verdict = {None: "shown", True: "ok", False: "MISSED"}[number.kept]
    return number.name, "-" if number.value is None else f"{number.value:.3f}", limit, str(number.cases), verdict


def _groups(evaluations: Sequence[Evaluation]) -> list[str]:
    """Shares of right answers by effect, family, signal set and gap over noise."""
    known = [each for each in evaluations if each.kind == "single"]
    rows = []
    for name in sorted({each.truths[0].effect for each in known}):
        rows.append(_group(name, [each for each in known if each.truths[0].effect == name]))
    for name in sorted({each.family for each in evaluations}):
        rows.append(_group(name, [each for each in evaluations if each.family == name]))
    for name in sorted({each.level for each in evaluations}):
        rows.append(_group(f"signals: {name.replace('_', ' ')}", [each for each in evaluations if each.level == name]))
    for low, high in ((3.0, 6.0), (6.0, 12.0), (12.0, 30.0)):
        there = [each for each in known if low <= each.ratio < high]
        if there:
            rows.append(_group(f"{low:g} to {high:g}", there))
    return _table(("group", "cases", "right", "in set", "where right"), rows)


def _group(name: str, cases: Sequence[Evaluation]) -> tuple[str, ...]:
    def share(values: list[bool]) -> str:
        return f"{sum(values) / len(values):.2f}" if values else "-"

    sets = [each.in_set for each in cases if each.in_set is not None]
    where = [each.where_right for each in cases if each.where_right is not None]
    return name, str(len(cases)), share([each.right for each in cases]), share(sets), share(where)


def _seeds(evaluations: Sequence[Evaluation]) -> str:
    seeds = [each.seed for each in evaluations if each.seed is not None]
    return f"; seeds {min(seeds)} to {max(seeds)}" if seeds else ""


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.0f} %"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cells = [[str(cell).replace("|", "/").replace("\n", " ") for cell in row] for row in (head, *rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return [lines[0], "|" + "---|" * len(head), *lines[1:]]


def reason(trouble: str) -> str:
    """The message of an exception without its traceback; other text unchanged."""
    lines = trouble.splitlines()
    last = max((k for k, line in enumerate(lines) if "Error" in line and not line.startswith(" ")), default=0)
    return " ".join(line.strip() for line in lines[last:])
