"""Charts of a report's figures: which curves, over what, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from via_gap.candidates.localisation import Quantity
from via_gap.rendering.chart import Curve, Panel, Rung, chart, ladder
from via_gap.rendering.names import SIGNALS, capital, place_words
from via_gap.rendering.number_lines import Line, number_lines
from via_gap.rendering.numbers import number
from via_gap.report.figures import ErrorBin, ErrorFigure, OrderSpectrum, ResidualBin, ResidualFigure, TraceFigure
from via_gap.report.report import DEVIATIONS, Cause, GapReport
from via_gap.selection.gap import Gap

PEAKS = 6  # of a spectrum, named in its caption
AXES = {
    "q": "the link", "theta_1": "motor 1", "theta_2": "motor 2", "tau": "the joint", "tau_link": "the link",
    "tau_1": "motor 1", "tau_2": "motor 2",
}  # fmt: skip


@dataclass(frozen=True)
class Drawn:
    """A chart and its caption."""

    caption: str
    svg: str


@dataclass(frozen=True)
class Row:
    """Charts that belong together; `leading` ones are shown, the others unfold."""

    title: str
    charts: tuple[Drawn, ...]
    leading: bool


def residual_rows(report: GapReport) -> tuple[Row, ...]:
    """One row per equation; those in which the gap was found lead, else the one with the largest residual."""
    each: dict[str, list[ResidualFigure]] = {}
    for figure in report.figures.residuals if report.figures is not None else ():
        each.setdefault(figure.equation, []).append(figure)
    if not each:
        return ()
    named = report.where[0].equation if report.where else ""
    leading = {name for name in each if name in named.split(" and ")}
    leading = leading or {max(each, key=lambda name: max(_excess(figure) for figure in each[name]))}
    rows = [
        Row(
            f"Equation of {'the link' if name == 'link' else name}",
            tuple(_residual(figure, _antagonistic(report), after_words(report)) for figure in group),
            name in leading,
        )
        for name, group in each.items()
    ]
    return tuple(sorted(rows, key=lambda row: not row.leading))


def after_words(report: GapReport) -> str:
    """Name of the simulator that is compared with the device as filed."""
    return "repaired" if report.effects else "fitted"


def spectrum_row(report: GapReport) -> Row | None:
    """Order spectra of the missing torque; none where no periodic effect was compared or no angle turned far enough."""
    spectra = report.figures.spectra if report.figures is not None else ()
    if not spectra:
        return None
    return Row("Order spectrum of the missing torque", tuple(_spectrum(each, report) for each in spectra), True)


def parameter_lines(cause: Cause) -> str:
    """The parameters of a cause beside their neutral values and limits."""
    lines = [
        Line(name, v.unit, v.value, v.neutral, v.low, v.high, DEVIATIONS * v.sd) for name, v in cause.parameters.items()
    ]
    return number_lines(f"Parameters of {place_words(cause)}", lines, "no effect")


def device_lines(report: GapReport) -> str:
    """The fitted parameters of the device beside their filed values and tolerances."""
    lines = [Line(n.name, n.unit, n.fitted, n.filed, n.low, n.high) for n in report.nuisance]
    return number_lines("Device parameters", lines, "as filed")


def error_rows(report: GapReport) -> tuple[Row, ...]:
    """One row per simulated signal, the link first and shown."""
    each: dict[str, list[ErrorFigure]] = {}
    for figure in report.figures.errors if report.figures is not None else ():
        each.setdefault(figure.signal, []).append(figure)
    return tuple(
        Row(
            capital(SIGNALS.get(signal, signal)),
            tuple(_error(figure, _antagonistic(report), after_words(report)) for figure in group),
            signal in ("q", "tau", "tau_link"),
        )
        for signal, group in each.items()
    )


def trace_rows(report: GapReport) -> tuple[Row, ...]:
    """One row per interval, or one of them all where a interval is a single signal: measured, as filed, repaired."""
    each: dict[tuple[str, str, float], list[TraceFigure]] = {}
    for figure in report.figures.traces if report.figures is not None else ():
        each.setdefault((figure.log, figure.worst, figure.time[0] if figure.time else 0.0), []).append(figure)
    titles = {"before": "largest error as filed", "after": f"largest error {after_words(report)}"}
    rows, seen = [], set()
    for count, ((log, worst, begin), group) in enumerate(each.items()):
        title = f"{log}, from {begin:.2f} s: {'second ' if worst in seen else ''}{titles[worst]}"
        seen.add(worst)
        rows.append(Row(title, tuple(_trace(figure, after_words(report)) for figure in group), count == 0))
    if rows and all(len(row.charts) == 1 for row in rows):
        return (Row("", tuple(Drawn(row.title, row.charts[0].svg) for row in rows), True),)
    return tuple(rows)


def gap_ladder(gap: Gap, repaired: str) -> Drawn:
    """How far the gap shrinks, over all and per signal."""
    tuned = gap.tuned if repaired == "repaired" else None
    rungs = [Rung("all signals", gap.before, gap.after, gap.floor, gap.bound, tuned, gap.interval)]
    if len(gap.signals) > 1:
        for name, each in gap.signals.items():
            rungs.append(Rung(SIGNALS.get(name, name), each.before, each.after, each.floor, each.bound))
    return Drawn(
        "The gap on held-out data", ladder("The gap before and after, with sensor noise and bound", rungs, repaired)
    )


def _over(by: Quantity, axis: str, antagonistic: bool) -> str:
    """The quantity of a figure in words."""
    spring = f" {2 if axis == 'motor 2' else 1}" if antagonistic else ""
    known = {
        "speed": f"speed |v| of {axis}",
        "deflection": f"deflection of transmission{spring}",
        "angle": "link angle q",
        "motor angle": f"angle of {axis}",
    }
    return known.get(by, by)


def _before_and_after(
    x: Sequence[float], columns: tuple[Sequence[float], ...], repaired: str, breaks: Sequence[int] = (),
    mirrored: bool = False,
) -> list[Curve]:  # fmt: skip
    """Curves of the columns (sensor noise, before, after) over x."""
    floor, before, after = columns
    return [
        Curve("sensor noise", "floor", x, floor, mirrored=mirrored),
        Curve("as filed", "before", x, before, breaks),
        Curve(repaired, "after", x, after, breaks),
    ]


def _columns(bins: Sequence[ResidualBin | ErrorBin], *names: str) -> tuple[list[float], ...]:
    return tuple([getattr(each, name) for each in bins] for name in names)


def _residual(figure: ResidualFigure, antagonistic: bool, repaired: str) -> Drawn:
    x, breaks = [b.centre for b in figure.bins], _gaps(figure.bins)
    over = _over(figure.by, "the link" if figure.equation == "link" else figure.equation, antagonistic)
    speed = figure.by == "speed"
    mean = _before_and_after(x, _columns(figure.bins, "floor", "before", "after"), repaired, breaks, mirrored=True)
    rms = _before_and_after(x, _columns(figure.bins, "floor", "before_rms", "after_rms"), repaired, breaks)
    panels = [Panel("mean along v" if speed else "mean", "N m", mean, zero=True), Panel("rms", "N m", rms, zero=True)]
    caption = f"against {over}" + (" (negative: it brakes)" if speed else "")
    return Drawn(caption, chart(f"Missing torque {caption}", over, figure.unit, panels))


def _spectrum(figure: OrderSpectrum, report: GapReport) -> Drawn:
    noise = [figure.level] * len(figure.orders)
    curves = _before_and_after(figure.orders, (noise, figure.before, figure.after), after_words(report))
    axis = "the link" if figure.equation == "link" else figure.equation
    peaks = ", ".join(number(each) for each in _peaks(figure))
    caption = f"equation of {axis}: largest at orders {peaks}; the log holds {number(figure.turns)} turns"
    panel = Panel("amplitude", "N m", curves, zero=True)
    return Drawn(caption, chart(f"Order spectrum, {caption}", "periods per turn", "1/rev", [panel]))


def _peaks(figure: OrderSpectrum) -> list[float]:
    """The orders of the largest local maxima as filed, in ascending order."""
    padded = (0.0, *figure.before, 0.0)
    tops = [k for k, (a, b, c) in enumerate(zip(padded, padded[1:], padded[2:], strict=False)) if a < b >= c]
    largest = sorted(tops, key=lambda k: -figure.before[k])[:PEAKS]
    return sorted(figure.orders[k] for k in largest)


def _error(figure: ErrorFigure, antagonistic: bool, repaired: str) -> Drawn:
    x, axis = [b.centre for b in figure.bins], AXES.get(figure.signal, figure.signal)
    over = _over(figure.by, axis, antagonistic)
    columns = _columns(figure.bins, "floor", "before", "after")
    curves = _before_and_after(x, columns, repaired, _gaps(figure.bins))
    panel = Panel("rms error", _unit(figure.signal), curves, log=True)
    return Drawn(f"against {over}", chart(f"Error of {axis} against {over}", over, figure.unit, [panel]))


def _gaps(bins: Sequence[ResidualBin | ErrorBin]) -> list[int]:
    """Bins that do not begin where the one before ends: no line is drawn where there are no data."""
    return [i + 1 for i, (a, b) in enumerate(pairwise(bins)) if b.low > a.high + 1e-6 * (b.high - a.low)]


def _trace(figure: TraceFigure, repaired: str) -> Drawn:
    def two(before: Sequence[float], after: Sequence[float]) -> list[Curve]:
        return [
            Curve("as filed", "before", figure.time, before, figure.restarts),
            Curve(repaired, "after", figure.time, after, figure.restarts),
        ]

    errors = [[s - m for s, m in zip(each, figure.measured, strict=True)] for each in (figure.before, figure.after)]
    name, unit = SIGNALS.get(figure.signal, figure.signal), _unit(figure.signal)
    measured = Curve("measured", "measured", figure.time, figure.measured)
    panels = [Panel(name, unit, [measured, *two(figure.before, figure.after)]), Panel("error", unit, two(*errors))]
    return Drawn(capital(name), chart(f"{name} measured and simulated", "time", "s", panels))


def _unit(signal: str) -> str:
    return "N m" if signal.startswith("tau") else "rad"


def _antagonistic(report: GapReport) -> bool:
    return report.figures is not None and report.figures.joint.arrangement == "antagonistic"


def _excess(figure: ResidualFigure) -> float:
    return max((b.before_rms / b.floor for b in figure.bins if b.floor > 0.0), default=0.0)
