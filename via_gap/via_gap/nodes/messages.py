"""Reports and the state of the monitor as messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from via_core.status import Status
from via_interfaces.action import DiagnoseGap
from via_interfaces.msg import Effect, EffectHypothesis, GapStatus
from via_interfaces.msg import SiteShare as SiteMessage
from via_ros.conversions import set_stamp
from via_ros.reports import pairs, status_name
from via_sim.effects import place_name

from via_gap.candidates.localisation import SiteShare
from via_gap.rendering.words import headline
from via_gap.report.report import Cause, GapReport, Where
from via_gap.run.comparison import Comparison
from via_gap.run.monitor import Monitor

LEAST = 0.01  # probability from which a cause is published
UNKNOWN = float("nan")
NONE = Comparison(0.0, UNKNOWN, UNKNOWN, UNKNOWN, (), moves=False, levels=())


def fill_status(message: GapStatus, monitor: Monitor, status: Status, text: str) -> None:
    """Write the state of the monitor into a message; `status` and `text` are those of its last comparison."""
    report, newest = monitor.report, monitor.rolling.newest or 0
    found = NONE if monitor.comparison is None or status == Status.WARMING_UP else monitor.comparison
    set_stamp(message.header.stamp, newest)
    set_stamp(message.diagnosed, 0 if report is None else monitor.diagnosed)
    message.window, message.error, message.normalised_error = found.window, found.error, found.normalised_error
    message.residual_ratio, message.sites = found.residual_ratio, _sites(found.sites)
    message.hypotheses = [] if report is None else _hypotheses(report)
    message.status = int(status)
    message.method = "nominal model" if monitor.model is monitor.device else "tuned model"
    message.verdict = "" if report is None else report.verdict
    message.message = (
        text if report is None else f"{text}; {monitor.rolling.age(monitor.diagnosed):.0f} s ago: {headline(report)}"
    )


def diagnostics_of(
    node: Any, message: GapStatus, monitor: Monitor, counters: Mapping[str, str | float], lossy: bool
) -> DiagnosticStatus:
    """The same for /diagnostics, with counters of `node`; `lossy`: publishers do not send lost messages again."""
    status = Status(message.status)
    level = DiagnosticStatus.WARN
    if status == Status.BAD_SAMPLE and monitor.comparison is not None:
        level = DiagnosticStatus.STALE
    elif status == Status.OK and message.verdict in ("", "no_gap") and monitor.change is None and not lossy:
        level = DiagnosticStatus.OK
    values: dict[str, str | float] = {
        "status": status.name, "residual ratio [-]": message.residual_ratio, "error [rad]": message.error,
        "normalised error [-]": message.normalised_error,
        "sites": ", ".join(f"{place_name(s.site, s.motor)} {100 * s.share:.0f} %" for s in message.sites),
        "model": message.method, "verdict": message.verdict,
        "change of the gap [s ago]": UNKNOWN if monitor.change is None else monitor.rolling.age(monitor.change),
        "causes": ", ".join(f"{h.effect.name} {100 * h.probability:.0f} %" for h in message.hypotheses),
        "age of the diagnosis [s]": UNKNOWN if monitor.report is None else monitor.rolling.age(monitor.diagnosed),
        "diagnosing": monitor.doing, "trouble of the last diagnosis": monitor.trouble,
        "window [s]": monitor.rolling.duration, "samples": monitor.samples, "foreign messages": monitor.foreign,
        "clock ran back": monitor.rolling.restarts, **counters,
    }  # fmt: skip
    return DiagnosticStatus(
        level=level, name=status_name(node, monitor.device.name), message=message.message,
        hardware_id=monitor.device.name, values=pairs(values),
    )  # fmt: skip


def result_of(report: GapReport) -> DiagnoseGap.Result:
    """The result of a goal."""
    result = failure(headline(report))
    result.success, result.verdict, result.report = True, report.verdict, report.to_json()
    result.sites, result.hypotheses = _sites(report.where), _hypotheses(report)
    if report.gap is not None:
        result.gap_before, result.gap_after = float(report.gap.before), float(report.gap.after)
        result.explained = float(report.gap.explained)
    return result


def failure(reason: str) -> DiagnoseGap.Result:
    """The result of a goal that ended without a report."""
    return DiagnoseGap.Result(message=reason, gap_before=UNKNOWN, gap_after=UNKNOWN, explained=UNKNOWN)


def _sites(shares: Sequence[SiteShare] | Sequence[Where]) -> list[SiteMessage]:
    return [
        SiteMessage(site=each.site, motor=each.motor, equation=each.equation, share=float(each.share))
        for each in shares
    ]


def _hypotheses(report: GapReport) -> list[EffectHypothesis]:
    """The causes with a probability of at least LEAST, those named first."""
    return [_hypothesis(cause, report) for cause in report.causes if cause.probability >= LEAST]


def _hypothesis(cause: Cause, report: GapReport) -> EffectHypothesis:
    tied = report.equivalence_set
    return EffectHypothesis(
        effect=Effect(
            name=cause.effect, site=cause.site, joint=cause.joint, motor=cause.motor,
            parameter_names=list(cause.parameters),
            parameter_values=[float(each.value) for each in cause.parameters.values()],
        ),
        parameter_standard_deviation=[float(each.sd) for each in cause.parameters.values()],
        probability=float(cause.probability),
        explained=float(min(max(1.0 - cause.left, 0.0), 1.0)),
        identifiable=len(tied) < 2 or cause.place not in tied,
    )  # fmt: skip
