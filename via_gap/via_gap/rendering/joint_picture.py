"""Picture of the joint: each part (command, motors, transmissions, link, sensors, ...) with its share of the gap.

A share is written out, and shown by the depth of one hue and the width of the outline: colour is not its only carrier.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from via_sim.effects import spots

from via_gap.report.figures import Figures, JointSketch
from via_gap.report.report import GapReport

# Light to dark, one hue; from WHITE_FROM on, white text is more legible.
DEPTHS = ("#ffffff", "#deebf7", "#b3d1ea", "#6aaed6", "#2f7dbb", "#0b4a8f")
STEPS = (0.0, 0.02, 0.15, 0.35, 0.6, 0.85)
WHITE_FROM = 4


def figures_of(report: GapReport) -> Figures:
    """The figures; of a report without any, a joint with as many motors as it mentions."""
    if report.figures is not None:
        return report.figures
    places = [(w.site, w.motor) for w in report.where] + [(c.site, c.motor) for c in report.causes]
    motors = max((number for place in places for _, number in spots(*place)), default=0)
    seen = (report.level in ("full", "no torque"),) * max(motors, 1)
    return Figures(
        joint=JointSketch(
            arrangement="antagonistic" if motors > 1 else "flexible", drive="torque", motors_seen=seen,
            torque_seen=report.level == "full",
        )
    )  # fmt: skip


@dataclass(frozen=True)
class JointPicture:
    """What page.svg draws.

    shares  (site, motor) -> share of the gap; sites without a number at 0, and both motors alike
    """

    sketch: JointSketch
    shares: Mapping[tuple[str, int], float]

    @property
    def heights(self) -> tuple[float, ...]:
        """Vertical positions of the motors, or of the drive."""
        return (80.0, 190.0) if len(self.sketch.motors_seen) == 2 else (130.0,)

    def share(self, site: str, number: int) -> float:
        """The share of one motor or transmission, and that of both alike."""
        return self.shares.get((site, number), 0.0) + (self.shares.get((site, 0), 0.0) if number else 0.0)

    def total(self, site: str) -> float:
        """The share of everything at a site."""
        return min(sum(value for (where, _), value in self.shares.items() if where == site), 1.0)


def picture_of(report: GapReport) -> JointPicture:
    """The joint of a report with the shares that it found."""
    return JointPicture(figures_of(report).joint, {(w.site, w.motor): w.share for w in report.where})


def depth(share: float) -> int:
    return sum(share >= step for step in STEPS[1:])


def fill(share: float) -> str:
    """Colour of a part."""
    return DEPTHS[depth(share)]


def ink(share: float) -> str:
    """Class of text on that colour."""
    return "light" if depth(share) >= WHITE_FROM else "dark"


def stroke(share: float) -> str:
    """Colour of a spring."""
    return DEPTHS[max(depth(share), 3)] if share > 0.0 else "#7a858f"


def said(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "-"


def spring(x0: float, y0: float, x1: float, y1: float) -> str:
    """SVG path of a spring from one point to another."""
    start, end = complex(x0, y0), complex(x1, y1)
    along, tenth = (end - start) / abs(end - start), 0.1 * abs(end - start)
    turns = (0.0, 9.0, -9.0, 9.0, -9.0, 9.0, -9.0, 9.0, 0.0)
    points = [start, *(start + along * complex(tenth * k, turn) for k, turn in enumerate(turns, 1)), end]
    return f"M{'L'.join(f'{p.real:.1f} {p.imag:.1f}' for p in points)}"
