"""Parameters on number lines: fitted value with its 95 % interval, the neutral value, and the limits of the range."""

from __future__ import annotations

from dataclasses import dataclass

from via_gap.rendering.numbers import number, raised

LEFT, RIGHT = 16.0, 364.0  # ends of a line
ROOM = 0.35  # of the shown span, to either side of what must be seen
WHOLE = 6.0  # times that span: a range up to there is shown from limit to limit
FAR = 30.0  # times the value: a neutral value that is farther off is not drawn to scale


@dataclass(frozen=True)
class Line:
    """One parameter."""

    name: str
    unit: str
    value: float
    neutral: float | None  # without the effect, or as filed; None: not stated
    low: float | None  # limits of the range it was fitted in; None: not stated
    high: float | None
    interval: float = 0.0  # half of the 95 % interval

    @property
    def label(self) -> str:
        unit = "" if self.unit in ("", "-") else f" [{raised(self.unit)}]"
        return f"{self.name}{unit}: {number(self.value)}"

    def __call__(self, value: float) -> float:
        """Position of a value; values beyond the span are at its end."""
        low, high = self.span
        return LEFT + (min(max(value, low), high) - low) / (high - low) * (RIGHT - LEFT)

    @property
    def neutral_at(self) -> float | None:
        """Position of the neutral value; None where the span does not contain it."""
        low, high = self.span
        return self(self.neutral) if self.neutral is not None and low <= self.neutral <= high else None

    @property
    def limits(self) -> list[tuple[float, float, bool]]:
        """(position, limit, whether it is to scale) of the stated limits."""
        ends = zip((LEFT, RIGHT), (self.low, self.high), self.span, strict=True)
        return [(at, limit, limit == end) for at, limit, end in ends if limit is not None]

    @property
    def span(self) -> tuple[float, float]:
        """Contains value, interval and neutral value, with some room, inside the limits."""
        size = max(abs(self.value), 1e-12)
        seen = [self.value]
        if self.neutral is not None and abs(self.neutral - self.value) <= FAR * size:
            seen.append(self.neutral)
        interval = min(self.interval, max(max(seen) - min(seen), size))
        low, high = min(*seen, self.value - interval), max(*seen, self.value + interval)
        room = ROOM * max(high - low, 0.1 * size)
        low, high = low - room, high + room
        if self.low is not None and self.high is not None and self.high - self.low <= WHOLE * (high - low):
            return self.low, self.high
        low = low if self.low is None else max(low, self.low)
        high = high if self.high is None else min(high, self.high)
        return (low, high) if high > low else (low - size, high + size)
