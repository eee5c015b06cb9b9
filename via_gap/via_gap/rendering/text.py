"""A report as lines for a terminal: the sentences of the page without its charts."""

from __future__ import annotations

from via_gap.rendering.evidence_words import conformal_words, evidence, findings, tie_words, values_words
from via_gap.rendering.names import capital, place_words, plain, spot_of, where_words
from via_gap.rendering.numbers import chance
from via_gap.rendering.words import cautions, gap_words, headline, next_steps
from via_gap.report.report import Cause, GapReport

LIKELY = 0.01  # probability from which a cause that is not named is listed


def text(report: GapReport) -> str:
    """Verdict, where, which, how far, what next, and the data check, in this order."""
    lines = [f"{report.joint}: {headline(report)}", *cautions(report)]
    if report.where:
        places = ", ".join(f"{where_words(w)} {chance(w.share)}" for w in report.where)
        lines.append(f"where: {places}")
    for number, cause in enumerate(ranked(report)):
        lines.append(f"{number + 1}. {capital(place_words(cause))}: probability {chance(cause.probability)}; "
                     f"{', '.join(values_words(cause))}. {evidence(report, cause)}")  # fmt: skip
    lines.extend(each for each in (*tie_words(report), conformal_words(report)) if each)
    if report.gap is not None:
        lines.append(f"gap by {report.gap.by}: {gap_words(report)}")
    lines.extend(f"next: {step}" for step in next_steps(report))
    lines.extend(f"{severity}: {log}: {said}" for severity, log, said in findings(report))
    lines.extend(f"not evaluated: {plain(said)}" for said in report.not_evaluated)
    return "\n".join(lines)


def ranked(report: GapReport) -> tuple[Cause, ...]:
    """The causes that are listed, in the report's order: the first, every named one, and others that are likely."""
    named = {spot_of(each) for each in report.effects}
    return tuple(
        cause
        for i, cause in enumerate(report.causes)
        if i == 0 or spot_of(cause) in named or cause.probability >= LIKELY
    )
