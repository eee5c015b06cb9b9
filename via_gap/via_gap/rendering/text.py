"""A report as lines for a terminal: what the page says, without the pictures."""

from __future__ import annotations

from via_gap.rendering.numbers import chance, percent, with_sd
from via_gap.rendering.words import (
    capital,
    cautions,
    equivalence_words,
    findings,
    gap_words,
    headline,
    next_steps,
    place_words,
    where_words,
)
from via_gap.report.report import Cause, GapReport

LIKELY = 0.01  # probability from which a cause is listed


def text(report: GapReport) -> str:
    """Verdict, where, which, how far, what next, and the data check, in this order."""
    lines = [f"{report.joint}: {headline(report)}", *cautions(report)]
    if report.where:
        places = ", ".join(f"{where_words(w)} {chance(w.share)}" for w in report.where)
        lines.append(f"where: {places}")
    for number, cause in enumerate(c for i, c in enumerate(report.causes) if not i or c.probability >= LIKELY):
        lines.append(f"{number + 1}. {capital(place_words(cause))}: probability {chance(cause.probability)}; "
                     f"{_values(cause)}; leaves {percent(cause.left)} of the squared error")  # fmt: skip
    lines.extend(equivalence_words(report))
    if report.gap is not None:
        lines.append(f"gap by {report.gap.by}: {gap_words(report)}")
    lines.extend(f"next: {step}" for step in next_steps(report))
    lines.extend(f"{severity}: {log}: {said}" for severity, log, said in findings(report))
    lines.extend(f"not judged: {said}" for said in report.not_judged)
    return "\n".join(lines)


def _values(cause: Cause) -> str:
    return ", ".join(f"{name} {with_sd(v.value, v.sd, v.unit)}" for name, v in cause.parameters.items())
