"""The page of the real robots, from its template and the results."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from via_bringup.provenance import Provenance
from via_gap.report.report import Cause, GapReport
from via_sim.effects import place_name

from via_validation.gap_real.cases import CASES, Case
from via_validation.gap_real.pictures import draw_gaps
from via_validation.gap_real.run import Elsewhere, Result
from via_validation.gap_real.summary import Pair, first_cause, gap_words, judged, summary, worse
from via_validation.gap_real.truth import named_causes, sizes

PAGE = "gap-real.md"
PICTURE = "gap-real.png"
SHOWN = 5  # causes of a case; those further down are hardly ever above a probability of .01


def write(pairs: Sequence[Pair], source: Provenance, folder: Path) -> Path:
    """The page and its picture in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_gaps(pairs, folder / PICTURE)
    (folder / PAGE).write_text(page(pairs, str(source)), encoding="utf-8")
    return folder / PAGE


def page(pairs: Sequence[Pair], source: str) -> str:
    """The page as Markdown."""
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.globals.update(
        causes=causes, elsewhere=elsewhere, first=first_cause, gap=gap_words, judged=judged, numbers=numbers,
        probability=probability, recordings=recordings, sizes=size_words, worse=worse, answer=answer,
    )  # fmt: skip
    template = environment.from_string(files("via_validation.gap_real").joinpath("page.md").read_text("utf-8"))
    shown = {case.name for case, _ in pairs}
    absent = [case.name for case in CASES if case.name not in shown]
    return template.render(pairs=pairs, absent=absent, source=source, summary=summary(pairs), picture=PICTURE)


def answer(report: GapReport) -> str:
    """The verdict, what it names, and what it does not tell apart."""
    named = named_causes(report)
    sentence = f"`{report.verdict}`"
    if named:
        sentence += f": {', '.join(f'{each.effect} ({each.site})' for each in named)}"
        others = [place.effect for place in report.equivalence_set if place not in report.effects]
        sentence += f"; not told apart from {', '.join(others)}" if others else ""
    return f"{sentence}; {report.reason}." if report.reason else f"{sentence}."


def probability(result: Result) -> str:
    """Of the first cause."""
    report = result.report
    return f"{report.causes[0].probability:.2f}" if report is not None and report.causes else ""


def size_words(case: Case, result: Result) -> str:
    """Sizes of the named causes beside those documented."""
    if result.report is None:
        return ""
    found = sizes(named_causes(result.report), case.truth)
    return ", ".join(
        f"{each.effect} {each.found:.3g} ({each.documented:.3g} documented{', off' if each.off else ''})"
        for each in found
    )


def recordings(case: Case) -> str:
    """Which recordings are fitted and which are judged."""
    judges = ", ".join(f"`{each}`" for each in case.judged) or "alternating blocks of the same recording"
    return f"fitted {', '.join(f'`{each}`' for each in case.fitted)}, judged {judges}"


def causes(report: GapReport) -> str:
    """The leading causes as a table."""
    rows = ["| cause | where | probability | squared error left | parameters |", "|---|---|---|---|---|"]
    return "\n".join((*rows, *map(_cause, report.causes[:SHOWN]))) if report.causes else "No cause was tried."


def _cause(cause: Cause) -> str:
    values = ", ".join(f"{name} {v.value:.3g} +- {v.sd:.1g} {v.unit}" for name, v in cause.parameters.items())
    place = place_name(cause.site, cause.motor)
    return f"| {cause.effect} | {place} | {cause.probability:.2f} | {100 * cause.left:.3g} % | {values} |"


def numbers(report: GapReport) -> str:
    """The device's numbers that were fitted to the end of their tolerance; empty where there are none."""
    ends = [each for each in report.nuisance if each.at_bound]
    return ", ".join(f"{each.name} {each.fitted:.4g} {each.unit} (filed {each.filed:.4g})" for each in ends)


def elsewhere(each: Elsewhere) -> str:
    """The gap of another recording without and with the repair."""
    if each.failure:
        return f"`{each.log}` cannot be compared: {each.failure}"
    change = "worse" if each.worse else "not worse"
    return (
        f"`{each.log}` {100 * each.before:.3g} -> {100 * each.after:.3g} % ({change}; ratio {each.ratio[0]:.2f} to "
        f"{each.ratio[1]:.2f})"
    )
