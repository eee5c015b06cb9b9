"""The page of the real robots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from via_gap.report.report import Cause, GapReport
from via_sim.effects import place_name

from via_validation.gap_real.cases import CASES, Case
from via_validation.gap_real.pictures import draw_gaps
from via_validation.gap_real.run import Elsewhere, Result
from via_validation.gap_real.summary import Pair, first_cause, gap_words, outcome_of, probability, summary, worse
from via_validation.gap_real.truth import named_causes, sizes
from via_validation.provenance import Provenance
from via_validation.template import rendered

PAGE = "gap-real.md"
PICTURE = "gap-real.png"
SHOWN = 5  # causes of a case; the probability of further ones is rarely above .01


def write(pairs: Sequence[Pair], source: Provenance, folder: Path) -> Path:
    """Write the page and its picture into `folder`; returns the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_gaps(pairs, folder / PICTURE)
    (folder / PAGE).write_text(page(pairs, str(source)), encoding="utf-8")
    return folder / PAGE


def page(pairs: Sequence[Pair], source: str) -> str:
    """The page as Markdown."""
    shown = {case.name for case, _ in pairs}
    values = {
        "causes": causes, "elsewhere": elsewhere, "first": first_cause, "gap": gap_words, "outcome": outcome_of,
        "numbers": numbers, "probability": probability, "recordings": recordings, "sizes": size_words, "worse": worse,
        "answer": answer, "pairs": pairs, "absent": [case.name for case in CASES if case.name not in shown],
        "source": source, "summary": summary(pairs), "picture": PICTURE,
    }  # fmt: skip
    return rendered("gap_real/page.md", values)


def answer(report: GapReport) -> str:
    """The verdict, the named causes, and the causes that are not distinguished from them."""
    named = named_causes(report)
    sentence = f"`{report.verdict}`"
    if named:
        sentence += f": {', '.join(f'{each.effect} ({each.site})' for each in named)}"
        others = [place.effect for place in report.equivalence_set if place not in report.effects]
        sentence += f"; not distinguished from {', '.join(others)}" if others else ""
    return f"{sentence}; {report.reason}." if report.reason else f"{sentence}."


def size_words(case: Case, result: Result) -> str:
    """Sizes of the named causes, with the documented ones."""
    if result.report is None:
        return ""
    found = sizes(named_causes(result.report), case.truth)
    return ", ".join(
        f"{each.effect} {each.found:.3g} ({each.documented:.3g} documented{', off' if each.off else ''})"
        for each in found
    )


def recordings(case: Case) -> str:
    """The fitted and the held-out recordings."""
    held_out = ", ".join(f"`{each}`" for each in case.held_out) or "alternating blocks of the same recording"
    return f"fitted {', '.join(f'`{each}`' for each in case.fitted)}, held out {held_out}"


def causes(report: GapReport) -> str:
    """The leading causes as a table."""
    rows = ["| cause | where | probability | squared error left | parameters |", "|---|---|---|---|---|"]
    return "\n".join((*rows, *map(_cause, report.causes[:SHOWN]))) if report.causes else "No cause was tried."


def _cause(cause: Cause) -> str:
    values = ", ".join(f"{name} {v.value:.3g} +- {v.sd:.1g} {v.unit}" for name, v in cause.parameters.items())
    place = place_name(cause.site, cause.motor)
    return f"| {cause.effect} | {place} | {cause.probability:.2f} | {100 * cause.left:.3g} % | {values} |"


def numbers(report: GapReport) -> str:
    """The device parameters whose fit is at the end of their tolerance; may be empty."""
    ends = [each for each in report.nuisance if each.at_bound]
    return ", ".join(f"{each.name} {each.fitted:.4g} {each.unit} (device file {each.filed:.4g})" for each in ends)


def elsewhere(each: Elsewhere) -> str:
    """The gap of another recording without and with the repair."""
    if each.failure:
        return f"`{each.log}` cannot be compared: {each.failure}"
    change = "worse" if each.worse else "not worse"
    return (
        f"`{each.log}` {100 * each.before:.3g} -> {100 * each.after:.3g} % ({change}; ratio {each.ratio[0]:.2f} to "
        f"{each.ratio[1]:.2f})"
    )
