"""Small charts as SVG text: lines, steps and bands over labelled axes; no library, nothing to load.

Lines differ by dash and marker as well as by colour (Okabe and Ito's palette for colour-blind readers), so that a grey
print is readable. Each panel carries its scales, with which the page's script shows values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import floor, isfinite, log10
from typing import Literal

from via_gap.rendering.numbers import percent, prefix, tick_words, ticks

WIDTH, PANEL, LEFT, RIGHT, TOP, BOTTOM = 380.0, 190.0, 58.0, 10.0, 26.0, 38.0
EXTREME = 8.0  # decades that a logarithmic axis spans at most
Look = Literal["measured", "before", "after", "floor"]


@dataclass(frozen=True)
class Curve:
    """One line, or the band between zero and y (`floor`; both sides of zero where `mirrored`).

    breaks  indices at which the line is interrupted
    """

    name: str
    look: Look
    x: Sequence[float]
    y: Sequence[float]
    breaks: Sequence[int] = ()
    mirrored: bool = False


@dataclass(frozen=True)
class Panel:
    """Curves over one pair of axes; `log`: logarithmic upwards; `zero`: zero is on the axis."""

    y_label: str
    y_unit: str
    curves: Sequence[Curve]
    log: bool = False
    zero: bool = False


def chart(title: str, x_label: str, x_unit: str, panels: Sequence[Panel]) -> str:
    """Panels stacked over one x axis, as an <svg> of class 'chart'."""
    every = [x for panel in panels for curve in panel.curves for x in curve.x]
    low, high = (min(every), max(every)) if every else (0.0, 1.0)
    if high <= low:
        low, high = low - 0.5, high + 0.5
    across = _Scale(low, high, LEFT, WIDTH - RIGHT, x_unit, round_ends=False)
    height = TOP + len(panels) * PANEL + BOTTOM
    parts = [
        f'<svg class="chart" role="img" aria-label="{escape(title)}" viewBox="0 0 {WIDTH:g} {height:g}" '
        f'data-x-name="{escape(x_label)}" data-x-unit="{escape(across.unit)}">',
        _legend([curve for panel in panels[:1] for curve in panel.curves]),
    ]
    for number, panel in enumerate(panels):
        top = TOP + number * PANEL
        last = number == len(panels) - 1
        parts.append(_panel(panel, across, top, top + PANEL - (28.0 if not last else 0.0), last))
    label = f"{x_label} [{across.unit}]"
    base = TOP + len(panels) * PANEL
    parts.append(f'<text class="label" x="{0.5 * (LEFT + WIDTH - RIGHT):g}" y="{base + 32:g}">{escape(label)}</text>')
    return "".join(parts) + "</svg>"


@dataclass(frozen=True)
class Rung:
    """One gap before and after; `tuned` and the interval of `after` where they are known."""

    name: str
    before: float
    after: float
    floor: float
    bound: float
    tuned: float | None = None
    interval: tuple[float, float] | None = None

    @property
    def seen(self) -> list[float]:
        """The values that a logarithmic axis can show."""
        every = (self.before, self.after, self.floor, self.bound, self.tuned or 0.0, *(self.interval or ()))
        return [value for value in every if value > 0.0]


def ladder(title: str, rungs: Sequence[Rung], repaired: str) -> str:
    """Every rung on one logarithmic axis, from before to after, with sensor noise and the achievable bound.

    repaired  name of `after`
    """
    seen = [value for rung in rungs for value in rung.seen]
    largest = max(seen, default=1.0)
    low = max(min(seen, default=0.1), largest * 10.0**-EXTREME)
    axis = _Log(low * 0.8, largest * 1.25, 12.0, WIDTH - 12.0)
    step, top = 46.0, 44.0
    base = top + step * len(rungs)
    parts = [
        f'<svg class="chart ladder" role="img" aria-label="{escape(title)}" viewBox="0 0 {WIDTH:g} {base + 40:g}">',
        _ladder_legend(repaired),
    ]
    for value in axis.ticks:
        x = axis(value)
        parts.append(f'<path class="grid" d="M{x:.1f} {top:g}V{base:g}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{base + 14:g}" text-anchor="middle">{percent(value)}</text>')
    for number, rung in enumerate(rungs):
        y = top + step * number + 30.0
        parts.append(f'<text class="row" x="12" y="{y - 14:g}">{escape(rung.name)}</text>')
        parts.append(f'<path class="grid" d="M12 {y:g}H{WIDTH - 12:g}"/>')
        if rung.floor > 0.0:
            width = max(axis(rung.floor) - 12.0, 1.0)
            parts.append(f'<rect class="floor" x="12" y="{y - 6:g}" width="{width:.1f}" height="12"/>')
        if rung.interval is not None:
            a, b = (axis(v) for v in rung.interval)
            parts.append(f'<path class="interval" d="M{a:.1f} {y - 4:g}v8M{b:.1f} {y - 4:g}v8M{a:.1f} {y:g}H{b:.1f}"/>')
        parts.append(f'<path class="shrink" d="M{axis(rung.before):.1f} {y:g}H{axis(rung.after):.1f}"/>')
        parts.append(f'<path class="bound" d="M{axis(rung.bound):.1f} {y - 9:g}v18"/>')
        parts.append(_marker("before", axis(rung.before), y, f"before: {percent(rung.before)}"))
        if rung.tuned is not None:
            parts.append(_marker("tuned", axis(rung.tuned), y, f"parameters fitted: {percent(rung.tuned)}"))
        parts.append(_marker("after", axis(rung.after), y, f"after: {percent(rung.after)}"))
    label = "gap: error relative to the signal's standard deviation [%]"
    parts.append(f'<text class="label" x="{0.5 * WIDTH:g}" y="{base + 33:g}">{escape(label)}</text>')
    return "".join(parts) + "</svg>"


class _Scale:
    """Linear: value -> position; the unit takes a prefix."""

    log = False

    def __init__(self, low: float, high: float, start: float, end: float, unit: str, round_ends: bool) -> None:
        self.factor, self.unit = prefix(max(abs(low), abs(high)), unit)
        if round_ends:
            reach = 0.06 * (high - low)
            low, high = low - (reach if low < 0.0 else 0.0), high + (reach if high > 0.0 else 0.0)
        self.low, self.high, self.start, self.end = low, high, start, end
        self.ticks = [t / self.factor for t in ticks(low * self.factor, high * self.factor)]
        self.words = tick_words([t * self.factor for t in self.ticks])

    def __call__(self, value: float) -> float:
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    @property
    def back(self) -> str:
        """'offset slope' with which a position becomes a value in `unit`."""
        slope = self.factor * (self.high - self.low) / (self.end - self.start)
        return f"{self.factor * self.low - slope * self.start:.9g} {slope:.9g}"


class _Log:
    """Logarithmic: value -> position; values below the axis are drawn at its end."""

    log = True

    def __init__(self, low: float, high: float, start: float, end: float, unit: str = "") -> None:
        self.factor, self.unit = prefix(high, unit)
        self.low, self.high, self.start, self.end = log10(low), log10(high), start, end
        decades = range(floor(self.low), floor(self.high) + 1)
        each = (1.0,) if self.high - self.low > 2.5 else (1.0, 3.0) if self.high - self.low > 1.2 else (1.0, 2.0, 5.0)
        values = [m * 10.0**k for k in decades for m in each]
        self.ticks = [v for v in values if low <= v <= high]
        self.words = [f"{v * self.factor:.3g}" for v in self.ticks]

    def __call__(self, value: float) -> float:
        power = max(log10(value), self.low) if value > 0.0 else self.low
        return self.start + (power - self.low) / (self.high - self.low) * (self.end - self.start)

    @property
    def back(self) -> str:
        slope = (self.high - self.low) / (self.end - self.start)
        return f"{self.low + log10(self.factor) - slope * self.start:.9g} {slope:.9g}"


def _panel(panel: Panel, across: _Scale, top: float, base: float, last: bool) -> str:
    values = [v for curve in panel.curves for v in curve.y if isfinite(v)]
    up: _Scale | _Log
    if panel.log:
        high = max(values, default=1.0) or 1.0
        low = max(min((v for v in values if v > 0.0), default=0.1 * high), high * 10.0**-EXTREME)
        up = _Log(low / 1.5, high * 1.5, base, top, panel.y_unit)
    else:
        banded = [-v for curve in panel.curves if curve.mirrored for v in curve.y]
        low, high = min([*values, *banded], default=0.0), max(values, default=1.0)
        if panel.zero:
            low, high = min(low, 0.0), max(high, 0.0)
        if high <= low:
            low, high = low - 1e-9, high + 1e-9
        up = _Scale(low, high, base, top, panel.y_unit, round_ends=True)
    parts = [
        f'<g class="panel" data-top="{top:g}" data-base="{base:g}" data-x="{across.back}" data-y="{up.back}" '
        f'data-y-unit="{escape(up.unit)}"{" data-log" if up.log else ""}>'
    ]
    for value, word in zip(up.ticks, up.words, strict=True):
        y = up(value)
        parts.append(f'<path class="grid" d="M{LEFT:g} {y:.1f}H{WIDTH - RIGHT:g}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 5:g}" y="{y + 3.5:.1f}" text-anchor="end">{word}</text>')
    for value, word in zip(across.ticks, across.words, strict=True):
        x = across(value)
        parts.append(f'<path class="grid" d="M{x:.1f} {base:g}v4"/>')
        if last:
            parts.append(f'<text class="tick" x="{x:.1f}" y="{base + 15:g}" text-anchor="middle">{word}</text>')
    parts.append(f'<path class="axis" d="M{LEFT:g} {top:g}V{base:g}H{WIDTH - RIGHT:g}"/>')
    parts.extend(_curve(curve, across, up, base) for curve in panel.curves)
    middle = 0.5 * (top + base)
    label = f"{panel.y_label} [{up.unit}]"
    parts.append(f'<text class="label" transform="translate(13 {middle:g}) rotate(-90)">{escape(label)}</text>')
    return "".join(parts) + "</g>"


def _curve(curve: Curve, across: _Scale, up: _Scale | _Log, base: float) -> str:
    if not curve.x:
        return ""
    points = [(across(x), up(y)) for x, y in zip(curve.x, curve.y, strict=True)]
    if curve.look == "floor":
        if curve.mirrored:
            under = [(x, up(-y)) for (x, _), y in zip(points, curve.y, strict=True)]
        else:
            under = [(x, base) for x, _ in points]
        outline = "L".join(f"{x:.1f} {y:.1f}" for x, y in [*points, *reversed(under)])
        return f'<path class="floor" d="M{outline}Z"/>'
    breaks = {0, *curve.breaks}
    path = "".join(f"{'M' if i in breaks else 'L'}{x:.1f} {y:.1f}" for i, (x, y) in enumerate(points))
    drawn = f'<path class="curve {curve.look}" data-name="{escape(curve.name)}" d="{path}"/>'
    dots = "".join(f'<circle class="dot {curve.look}" cx="{x:.1f}" cy="{y:.1f}" r="2.6"/>' for x, y in points)
    return drawn + (dots if curve.look == "after" and len(points) <= 40 else "")


def _legend(curves: Sequence[Curve]) -> str:
    parts, x = [], LEFT
    for curve in curves:
        if curve.look == "floor":
            parts.append(f'<rect class="floor" x="{x:g}" y="6" width="18" height="9"/>')
        else:
            parts.append(f'<path class="curve {curve.look}" d="M{x:g} 10.5h18"/>')
            if curve.look == "after":
                parts.append(f'<circle class="dot {curve.look}" cx="{x + 9:g}" cy="10.5" r="2.6"/>')
        parts.append(f'<text class="tick" x="{x + 22:g}" y="14">{escape(curve.name)}</text>')
        x += 38.0 + 6.0 * len(curve.name)
    return f'<g class="legend">{"".join(parts)}</g>'


def _marker(look: str, x: float, y: float, said: str) -> str:
    shapes = {
        "before": f"M{x - 5:.1f} {y - 5:g}h10v10h-10Z",
        "tuned": f"M{x:.1f} {y - 7:g}l6 7l-6 7l-6 -7Z",
        "after": f"M{x - 6:.1f} {y:g}a6 6 0 1 0 12 0a6 6 0 1 0 -12 0Z",
    }
    return f'<path class="marker {look}" d="{shapes[look]}"><title>{escape(said)}</title></path>'


def _ladder_legend(repaired: str) -> str:
    parts, x = [], 18.0
    looks = (("before", "as filed"), ("tuned", "fitted"), ("after", repaired))
    for look, name in looks if repaired != "fitted" else looks[::2]:
        parts.append(_marker(look, x, 10.0, name) + f'<text class="tick" x="{x + 10:g}" y="14">{name}</text>')
        x += 28.0 + 6.0 * len(name)
    parts.append(f'<path class="bound" d="M{x:g} 3v14"/><text class="tick" x="{x + 5:g}" y="14">achievable</text>')
    x += 72.0
    parts.append(f'<rect class="floor" x="{x:g}" y="5" width="14" height="10"/>')
    return "".join(parts) + f'<text class="tick" x="{x + 18:g}" y="14">noise</text>'
