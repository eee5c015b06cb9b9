"""Charts of a report's figures: which curves, over what, in which order."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

from via_gap.candidates.localisation import Quantity
from via_gap.rendering.chart import Chart, Curve, Panel, Scale, logarithmic
from via_gap.rendering.joint_picture import figures_of
from via_gap.rendering.names import SIGNALS, capital
from via_gap.rendering.number_lines import Line
from via_gap.rendering.numbers import number, percent
from via_gap.report.figures import ErrorBin, ErrorFigure, OrderSpectrum, ResidualBin, ResidualFigure, TraceFigure
from via_gap.report.report import DEVIATIONS, Cause, GapReport
from via_gap.selection.gap import Gap, SignalGap

Figure = TypeVar("Figure")
Key = TypeVar("Key", bound=Hashable)
PEAKS = 6  # of a spectrum, named in its caption
AXES = {
    "q": "the link", "theta_1": "motor 1", "theta_2": "motor 2", "tau": "the joint", "tau_link": "the link",
    "tau_1": "motor 1", "tau_2": "motor 2",
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """Charts that belong together; `leading` ones are shown, the others unfold."""

    title: str
    charts: tuple[Chart, ...]
    leading: bool


@dataclass(frozen=True)
class Ladder:
    """How far the gap shrinks, over all and per signal, on one logarithmic axis; `after` names the model repaired."""

    gap: Gap
    after: str

    @property
    def rungs(self) -> dict[str, Gap | SignalGap]:
        signals = self.gap.signals if len(self.gap.signals) > 1 else {}
        return {"all signals": self.gap, **{SIGNALS.get(name, name): each for name, each in signals.items()}}

    @property
    def tuned(self) -> bool:
        """Whether the device with fitted parameters is another model than the one after the repair."""
        return self.after == "repaired"

    @property
    def looks(self) -> list[tuple[str, str]]:
        """(marker, model) of the legend."""
        return [("before", "as filed"), *([("tuned", "fitted")] if self.tuned else []), ("after", self.after)]

    @property
    def axis(self) -> Scale:
        shown = [v for each in self.rungs.values() for v in (each.before, each.after, each.floor, each.bound)]
        shown += [*self.gap.interval, *([self.gap.tuned] if self.tuned else [])]
        return logarithmic(shown, 1.25, (12.0, 368.0), word=percent)


def residual_rows(report: GapReport) -> tuple[Row, ...]:
    """One row per equation; those in which the gap was found lead, else the one with the largest residual."""
    each = _grouped(figures_of(report).residuals, lambda figure: figure.equation)
    named = report.where[0].equation.split(" and ") if report.where else []
    leading = each.keys() & set(named) or {max(each, key=lambda name: max(map(_excess, each[name])), default="")}
    rows = [
        Row(f"Equation of {_axis_of(name)}", tuple(_residual(figure, report) for figure in group), name in leading)
        for name, group in each.items()
    ]
    return tuple(sorted(rows, key=lambda row: not row.leading))


def after_words(report: GapReport) -> str:
    """Name of the simulator that is compared with the device as filed."""
    return "repaired" if report.effects else "fitted"


def spectrum_rows(report: GapReport) -> tuple[Row, ...]:
    """Order spectra of the missing torque; none where no periodic effect was compared or no angle turned far enough."""
    charts = tuple(_spectrum(each, after_words(report)) for each in figures_of(report).spectra)
    return (Row("Order spectrum of the missing torque", charts, True),) if charts else ()


def parameter_lines(cause: Cause) -> list[Line]:
    """The parameters of a cause beside their neutral values and limits."""
    each = cause.parameters.items()
    return [Line(name, v.unit, v.value, v.neutral, v.low, v.high, DEVIATIONS * v.sd) for name, v in each]


def device_lines(report: GapReport) -> list[Line]:
    """The fitted parameters of the device beside their filed values and tolerances."""
    return [Line(n.name, n.unit, n.fitted, n.filed, n.low, n.high) for n in report.nuisance]


def error_rows(report: GapReport) -> tuple[Row, ...]:
    """One row per simulated signal, the link first and shown."""
    return tuple(
        Row(
            capital(SIGNALS.get(signal, signal)),
            tuple(_error(figure, report) for figure in group),
            signal in ("q", "tau", "tau_link"),
        )
        for signal, group in _grouped(figures_of(report).errors, lambda figure: figure.signal).items()
    )


def trace_rows(report: GapReport) -> tuple[Row, ...]:
    """One row per interval, or one of them all where an interval is a single signal: measured, as filed, repaired."""
    traces = figures_of(report).traces
    each = _grouped(traces, lambda figure: (figure.log, figure.worst, figure.time[0] if figure.time else 0.0))
    after = after_words(report)
    titles = {"before": "largest error as filed", "after": f"largest error {after}"}
    rows: list[Row] = []
    seen = set()
    for (log, worst, begin), group in each.items():
        title = f"{log}, from {begin:.2f} s: {'second ' if worst in seen else ''}{titles[worst]}"
        seen.add(worst)
        rows.append(Row(title, tuple(_trace(figure, after) for figure in group), not rows))
    if rows and all(len(row.charts) == 1 for row in rows):
        return (Row("", tuple(replace(row.charts[0], caption=row.title) for row in rows), True),)
    return tuple(rows)


def _grouped(figures: Iterable[Figure], key: Callable[[Figure], Key]) -> dict[Key, list[Figure]]:
    """Figures by key, in the order in which the keys first appear."""
    found: dict[Key, list[Figure]] = {}
    for figure in figures:
        found.setdefault(key(figure), []).append(figure)
    return found


def _axis_of(equation: str) -> str:
    return "the link" if equation == "link" else equation


def _over(by: Quantity, axis: str, report: GapReport) -> str:
    """The quantity of a figure in words."""
    number = "" if figures_of(report).joint.arrangement != "antagonistic" else " 2" if axis == "motor 2" else " 1"
    known = {
        "speed": f"speed |v| of {axis}",
        "deflection": f"deflection of transmission{number}",
        "angle": "link angle q",
        "motor angle": f"angle of {axis}",
    }
    return known.get(by, by)


def _filed_and_repaired(
    x: Sequence[float], before: Sequence[float], after: Sequence[float], repaired: str, breaks: Sequence[int] = ()
) -> list[Curve]:
    return [Curve("as filed", "before", x, before, breaks), Curve(repaired, "after", x, after, breaks)]


def _binned(figure: ResidualFigure | ErrorFigure, after: str, suffix: str = "", mirrored: bool = False) -> list[Curve]:
    """Sensor noise, before and after at the centres of bins; no line is drawn where there are no data."""
    bins: Sequence[ResidualBin | ErrorBin] = figure.bins
    x, noise = [each.centre for each in bins], [each.floor for each in bins]
    columns = [[getattr(each, name + suffix) for each in bins] for name in ("before", "after")]
    breaks = [i + 1 for i, (a, b) in enumerate(pairwise(bins)) if b.low > a.high + 1e-6 * (b.high - a.low)]
    return [
        Curve("sensor noise", "floor", x, noise, mirrored=mirrored),
        *_filed_and_repaired(x, columns[0], columns[1], after, breaks),
    ]


def _residual(figure: ResidualFigure, report: GapReport) -> Chart:
    over, speed = _over(figure.by, _axis_of(figure.equation), report), figure.by == "speed"
    mean = _binned(figure, after_words(report), mirrored=True)
    rms = _binned(figure, after_words(report), "_rms")
    panels = [Panel("mean along v" if speed else "mean", "N m", mean, zero=True), Panel("rms", "N m", rms, zero=True)]
    caption = f"against {over}" + (" (negative: it brakes)" if speed else "")
    return Chart(caption, f"Missing torque {caption}", over, figure.unit, panels)


def _spectrum(figure: OrderSpectrum, repaired: str) -> Chart:
    noise = Curve("sensor noise", "floor", figure.orders, [figure.level] * len(figure.orders))
    curves = [noise, *_filed_and_repaired(figure.orders, figure.before, figure.after, repaired)]
    peaks = ", ".join(number(each) for each in _peaks(figure))
    turns = f"the log holds {number(figure.turns)} turns"
    caption = f"equation of {_axis_of(figure.equation)}: largest at orders {peaks}; {turns}"
    panel = Panel("amplitude", "N m", curves, zero=True)
    return Chart(caption, f"Order spectrum, {caption}", "periods per turn", "1/rev", [panel])


def _peaks(figure: OrderSpectrum) -> list[float]:
    """The orders of the largest local maxima as filed, in ascending order."""
    padded = (0.0, *figure.before, 0.0)
    tops = [k for k, (a, b, c) in enumerate(zip(padded, padded[1:], padded[2:], strict=False)) if a < b >= c]
    largest = sorted(tops, key=lambda k: -figure.before[k])[:PEAKS]
    return sorted(figure.orders[k] for k in largest)


def _error(figure: ErrorFigure, report: GapReport) -> Chart:
    axis = AXES.get(figure.signal, figure.signal)
    over = _over(figure.by, axis, report)
    panel = Panel("rms error", _unit(figure.signal), _binned(figure, after_words(report)), log=True)
    return Chart(f"against {over}", f"Error of {axis} against {over}", over, figure.unit, [panel])


def _trace(figure: TraceFigure, repaired: str) -> Chart:
    errors = [[s - m for s, m in zip(each, figure.measured, strict=True)] for each in (figure.before, figure.after)]
    name, unit = SIGNALS.get(figure.signal, figure.signal), _unit(figure.signal)
    curves, gaps = (
        _filed_and_repaired(figure.time, before, after, repaired, figure.restarts)
        for before, after in ((figure.before, figure.after), errors)
    )
    measured = Curve("measured", "measured", figure.time, figure.measured)
    panels = [Panel(name, unit, [measured, *curves]), Panel("error", unit, gaps)]
    return Chart(capital(name), f"{name} measured and simulated", "time", "s", panels)


def _unit(signal: str) -> str:
    return "N m" if signal.startswith("tau") else "rad"


def _excess(figure: ResidualFigure) -> float:
    return max((b.before_rms / b.floor for b in figure.bins if b.floor > 0.0), default=0.0)
