"""Small charts: lines, steps and bands over labelled axes; page.svg draws them, no library, nothing to load.

Lines differ by dash and marker as well as by colour (Okabe and Ito's palette for colour-blind readers), so that a grey
print is readable. Each panel carries its scales, with which the page's script shows values. Positions are units of the
drawing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import floor, isfinite, log10
from typing import Literal

from via_gap.rendering.numbers import prefix, tick_words, ticks

LEFT, RIGHT = 58.0, 370.0  # ends of the x axis
EXTREME = 8.0  # decades that a logarithmic axis spans at most
Writer = Callable[[float], str]
Look = Literal["measured", "before", "after", "floor"]


@dataclass(frozen=True)
class Scale:
    """Positions of values, which are linear in the value or, where `log`, in its decimal logarithm."""

    low: float  # value or its logarithm at the position `start`
    high: float
    start: float
    end: float
    unit: str = ""
    factor: float = 1.0  # of a value, for a number in that unit
    ticks: Sequence[tuple[float, str]] = ()  # position, number
    log: bool = False

    def __call__(self, value: float) -> float:
        """The position; values that a logarithmic axis cannot show are at its end."""
        if self.log:
            value = max(log10(value), self.low) if value > 0.0 else self.low
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    @property
    def back(self) -> str:
        """'offset slope' with which a position becomes a value in `unit`, or its logarithm."""
        slope = (self.high - self.low) / (self.end - self.start)
        offset = self.low - slope * self.start
        if self.log:
            return f"{offset + log10(self.factor):.9g} {slope:.9g}"
        return f"{self.factor * offset:.9g} {self.factor * slope:.9g}"


def linear(low: float, high: float, ends: tuple[float, float], unit: str, room: float = 0.0) -> Scale:
    """A linear scale between two positions; `room`: what it shows beyond a low or high that is not zero."""
    factor, unit = prefix(max(abs(low), abs(high)), unit)
    reach = room * (high - low)
    low, high = low - (reach if low < 0.0 else 0.0), high + (reach if high > 0.0 else 0.0)
    bare = Scale(low, high, *ends, unit, factor)
    values = ticks(low * factor, high * factor)
    return replace(bare, ticks=[(bare(v / factor), word) for v, word in zip(values, tick_words(values), strict=True)])


def logarithmic(
    values: Iterable[float], margin: float, ends: tuple[float, float], unit: str = "", word: Writer = "{:.3g}".format
) -> Scale:
    """A logarithmic scale of the positive values, over at most EXTREME decades and a factor `margin` to either side."""
    seen = [value for value in values if value > 0.0]
    high = max(seen, default=1.0)
    low = max(min(seen, default=0.1 * high), high * 10.0**-EXTREME) / margin
    high *= margin
    factor, unit = prefix(high, unit)
    bare = Scale(log10(low), log10(high), *ends, unit, factor, log=True)
    span = bare.high - bare.low
    each = (1.0,) if span > 2.5 else (1.0, 3.0) if span > 1.2 else (1.0, 2.0, 5.0)
    marks = [m * 10.0**k for k in range(floor(bare.low), floor(bare.high) + 1) for m in each]
    return replace(bare, ticks=[(bare(v), word(v * factor)) for v in marks if low <= v <= high])


@dataclass(frozen=True)
class Curve:
    """One line, or the band between zero and y (`floor`; both sides of zero where `mirrored`)."""

    name: str
    look: Look
    x: Sequence[float]
    y: Sequence[float]
    breaks: Sequence[int] = ()  # indices at which the line is interrupted
    mirrored: bool = False

    def points(self, across: Scale, up: Scale) -> list[tuple[float, float]]:
        return [(across(x), up(y)) for x, y in zip(self.x, self.y, strict=True)]

    def path(self, across: Scale, up: Scale) -> str:
        """SVG path of the line, or of the outline of the band."""
        points = self.points(across, up)
        if self.look == "floor":
            under = [(x, up(-y) if self.mirrored else up.start) for (x, _), y in zip(points, self.y, strict=True)]
            return f"M{'L'.join(f'{x:.1f} {y:.1f}' for x, y in [*points, *reversed(under)])}Z"
        return "".join(f"{'M' if i in {0, *self.breaks} else 'L'}{x:.1f} {y:.1f}" for i, (x, y) in enumerate(points))


@dataclass(frozen=True)
class Panel:
    """Curves over one pair of axes; `log`: logarithmic upwards; `zero`: zero is on the axis."""

    y_label: str
    y_unit: str
    curves: Sequence[Curve]
    log: bool = False
    zero: bool = False

    def up(self, base: float, top: float) -> Scale:
        """The y axis from `base` to `top`."""
        values = [v for curve in self.curves for v in curve.y if isfinite(v)]
        if self.log:
            return logarithmic(values, 1.5, (base, top), self.y_unit)
        zero = [0.0] if self.zero else []
        mirrored = [-v for curve in self.curves if curve.mirrored for v in curve.y]
        low, high = min([*values, *mirrored, *zero], default=0.0), max([*values, *zero], default=1.0)
        if high <= low:
            low, high = low - 1e-9, high + 1e-9
        return linear(low, high, (base, top), self.y_unit, room=0.06)


@dataclass(frozen=True)
class Chart:
    """Panels stacked over one x axis."""

    caption: str
    title: str  # what a reader without eyes gets
    x_label: str
    x_unit: str
    panels: Sequence[Panel]

    @property
    def across(self) -> Scale:
        """The x axis of all panels."""
        every = [x for panel in self.panels for curve in panel.curves for x in curve.x]
        low, high = min(every, default=0.0), max(every, default=1.0)
        low, high = (low, high) if high > low else (low - 0.5, high + 0.5)
        return linear(low, high, (LEFT, RIGHT), self.x_unit)
