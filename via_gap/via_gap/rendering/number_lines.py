"""Parameters on number lines: fitted value with its 95 % interval, the neutral value, and the limits of the range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from via_gap.rendering.chart import WIDTH
from via_gap.rendering.numbers import number, raised

ROW, TOP, SIDE = 50.0, 26.0, 16.0
ROOM = 0.35  # of the shown span, to either side of what must be seen
WHOLE = 6.0  # times that span: a range up to there is shown from limit to limit
FAR = 30.0  # times the value: a neutral value that is farther off is not drawn to scale


@dataclass(frozen=True)
class Line:
    """One parameter.

    neutral   without the effect, or as filed; None: not stated
    low, high   limits of the range it was fitted in; None: not stated
    interval  half of the 95 % interval
    """

    name: str
    unit: str
    value: float
    neutral: float | None
    low: float | None
    high: float | None
    interval: float = 0.0

    @property
    def label(self) -> str:
        unit = "" if self.unit in ("", "-") else f" [{raised(self.unit)}]"
        return f"{self.name}{unit}: {number(self.value)}"


def number_lines(title: str, lines: Sequence[Line], neutral: str) -> str:
    """An <svg> of class 'lines'; `neutral` names the hollow diamond."""
    height = TOP + ROW * len(lines) + 4.0
    parts = [f'<svg class="lines" role="img" aria-label="{escape(title)}" viewBox="0 0 {WIDTH:g} {height:g}">']
    parts.append(_legend(neutral, any(line.interval > 0.0 for line in lines)))
    for k, line in enumerate(lines):
        parts.append(_line(line, TOP + ROW * k))
    return "".join(parts) + "</svg>"


def _line(line: Line, top: float) -> str:
    low, high = _shown(line)
    left, right = SIDE, WIDTH - SIDE

    def across(value: float) -> float:
        return left + (min(max(value, low), high) - low) / (high - low) * (right - left)

    y = top + 27.0
    parts = [
        f'<text class="row" x="{left:g}" y="{top + 13:g}">{escape(line.label)}</text>',
        f'<path class="axis" d="M{left:g} {y:g}H{right:g}"/>',
    ]
    for end, x, anchor, limit in ((line.low, left, "start", low), (line.high, right, "end", high)):
        if end is None:
            continue
        if limit == end:
            parts.append(f'<path class="limit" d="M{x:g} {y - 8:g}v16"/>')
            parts.append(f'<text class="tick" x="{x:g}" y="{y + 19:g}" text-anchor="{anchor}">{number(end)}</text>')
        else:
            arrow = f"M{x + 6:g} {y - 4:g}l-8 4l8 4" if anchor == "start" else f"M{x - 6:g} {y - 4:g}l8 4l-8 4"
            parts.append(f'<path class="axis" d="{arrow}"/>')
            said = f"limit {number(end)}"
            parts.append(f'<text class="tick" x="{x:g}" y="{y + 19:g}" text-anchor="{anchor}">{said}</text>')
    if line.neutral is not None and low <= line.neutral <= high:
        x = across(line.neutral)
        parts.append(f'<path class="neutral" d="M{x:.1f} {y - 7:g}l6 7l-6 7l-6 -7Z"/>')
        if abs(x - left) > 40.0 and abs(x - right) > 40.0:
            parts.append(
                f'<text class="tick" x="{x:.1f}" y="{y + 19:g}" text-anchor="middle">{number(line.neutral)}</text>'
            )
    if line.interval > 0.0:
        a, b = across(line.value - line.interval), across(line.value + line.interval)
        parts.append(f'<path class="interval" d="M{a:.1f} {y - 4:g}v8M{b:.1f} {y - 4:g}v8M{a:.1f} {y:g}H{b:.1f}"/>')
    x = across(line.value)
    parts.append(f'<circle class="value" cx="{x:.1f}" cy="{y:g}" r="4.5"><title>{escape(line.label)}</title></circle>')
    return "".join(parts)


def _shown(line: Line) -> tuple[float, float]:
    """The span that holds value, interval and neutral value, with some room, inside the limits."""
    size = max(abs(line.value), 1e-12)
    seen = [line.value]
    if line.neutral is not None and abs(line.neutral - line.value) <= FAR * size:
        seen.append(line.neutral)
    reach = max(seen) - min(seen)
    interval = min(line.interval, max(reach, size))
    low, high = min(*seen, line.value - interval), max(*seen, line.value + interval)
    room = ROOM * max(high - low, 0.1 * size)
    low, high = low - room, high + room
    if line.low is not None and line.high is not None and line.high - line.low <= WHOLE * (high - low):
        return line.low, line.high
    if line.low is not None:
        low = max(low, line.low)
    if line.high is not None:
        high = min(high, line.high)
    return (low, high) if high > low else (low - size, high + size)


def _legend(neutral: str, interval: bool) -> str:
    x = SIDE + 6.0
    parts = [f'<path class="neutral" d="M{x:g} 3l6 7l-6 7l-6 -7Z"/>']
    parts.append(f'<text class="tick" x="{x + 10:g}" y="14">{escape(neutral)}</text>')
    x += 30.0 + 6.2 * len(neutral)
    said = "fitted, 95 % interval" if interval else "fitted"
    parts.append(f'<circle class="value" cx="{x:g}" cy="10" r="4.5"/>')
    parts.append(f'<text class="tick" x="{x + 9:g}" y="14">{said}</text>')
    x += 28.0 + 6.2 * len(said)
    parts.append(f'<path class="limit" d="M{x:g} 3v14"/><text class="tick" x="{x + 6:g}" y="14">limit</text>')
    return f'<g class="legend">{"".join(parts)}</g>'
