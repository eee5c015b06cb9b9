"""What a diagnosis found, as messages."""

from __future__ import annotations

from collections.abc import Sequence

from via_interfaces.action import DiagnoseGap
from via_interfaces.msg import Effect, EffectHypothesis
from via_interfaces.msg import SiteShare as SiteMessage

from via_gap.candidates.localisation import SiteShare
from via_gap.rendering.words import headline
from via_gap.report.report import Cause, GapReport, Where

LEAST = 0.01  # probability from which a cause is published


def sites_of(shares: Sequence[SiteShare] | Sequence[Where]) -> list[SiteMessage]:
    """Where a gap lies, by equations or by a whole diagnosis."""
    return [
        SiteMessage(site=each.site, motor=each.motor, equation=each.equation, share=float(each.share))
        for each in shares
    ]


def hypotheses_of(report: GapReport) -> list[EffectHypothesis]:
    """The causes of a report from a probability of LEAST on, those named first."""
    return [_hypothesis(cause, report) for cause in report.causes if cause.probability >= LEAST]


def _hypothesis(cause: Cause, report: GapReport) -> EffectHypothesis:
    tied = {(place.effect, place.site, place.motor) for place in report.equivalence_set}
    key = (cause.effect, cause.site, cause.motor)
    return EffectHypothesis(
        effect=Effect(
            name=cause.effect,
            site=cause.site,
            joint=cause.joint,
            motor=cause.motor,
            parameter_names=list(cause.parameters),
            parameter_values=[float(each.value) for each in cause.parameters.values()],
        ),
        parameter_standard_deviation=[float(each.sd) for each in cause.parameters.values()],
        probability=float(cause.probability),
        explained=float(min(max(1.0 - cause.left, 0.0), 1.0)),
        identifiable=len(tied) < 2 or key not in tied,
    )


def result_of(report: GapReport) -> DiagnoseGap.Result:
    """The answer to a goal."""
    result = failure(headline(report))
    result.success, result.verdict, result.report = True, report.verdict, report.to_json()
    result.sites, result.hypotheses = sites_of(report.where), hypotheses_of(report)
    if report.gap is not None:
        result.gap_before, result.gap_after = float(report.gap.before), float(report.gap.after)
        result.closes = float(report.gap.explained)
    return result


def failure(reason: str) -> DiagnoseGap.Result:
    """The answer to a goal that came to nothing."""
    unknown = float("nan")
    return DiagnoseGap.Result(message=reason, gap_before=unknown, gap_after=unknown, closes=unknown)
