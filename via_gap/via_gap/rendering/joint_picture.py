"""Picture of the joint: each part (command, motors, transmissions, link, sensors, ...) with its share of the gap.

A share is written out, and shown by the depth of one hue and the width of the outline: colour is not its only carrier.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Literal

from via_sim.effects import spots

from via_gap.report.figures import JointSketch
from via_gap.report.report import GapReport

# Light to dark, one hue; from WHITE_FROM on, white text is more legible.
DEPTHS = ("#ffffff", "#deebf7", "#b3d1ea", "#6aaed6", "#2f7dbb", "#0b4a8f")
STEPS = (0.0, 0.02, 0.15, 0.35, 0.6, 0.85)
WHITE_FROM = 4

Shares = Mapping[tuple[str, int], float]  # (site, motor) -> share; sites without a number at 0, and both motors alike


def sketch_of(report: GapReport) -> JointSketch:
    """The joint; of a report without figures, a joint with as many motors as it mentions."""
    if report.figures is not None:
        return report.figures.joint
    places = {*((each.site, each.motor) for each in report.where), *((each.site, each.motor) for each in report.causes)}
    named = [spot for place in places for spot in spots(*place)]
    motors = max((number for _, number in named), default=0)
    seen = (report.level in ("full", "no torque"),) * max(motors, 1)
    arrangement: Literal["antagonistic", "flexible"] = "antagonistic" if motors > 1 else "flexible"
    return JointSketch(arrangement=arrangement, drive="torque", motors_seen=seen, torque_seen=report.level == "full")


def joint_picture(sketch: JointSketch, shares: Shares) -> str:
    """An <svg> of class 'joint'."""
    motors = len(sketch.motors_seen)
    heights = {0: (130.0,), 1: (130.0,), 2: (80.0, 190.0)}[motors]
    link_x, link_y = 300.0, 130.0
    parts = [
        '<svg class="joint" role="img" aria-label="Joint with the share of the gap at each place" '
        'viewBox="0 0 400 322">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8Z"/></marker></defs>',
    ]
    for y in heights:
        parts.append(f'<path class="wire" marker-end="url(#tip)" d="M92 {130 + 0.25 * (y - 130):g}L126 {y:g}"/>')
    parts.append(_chain(sketch, shares, heights, link_x, link_y))
    for i, y in enumerate(heights):
        seen = bool(motors) and sketch.motors_seen[i]
        name = f"motor {i + 1}" if motors else "drive"
        share = _share(shares, "motor", i + 1)
        parts.append(_round(name, 155.0, y, share, seen or not motors))
        if seen:
            parts.append(f'<path class="sense" d="M155 {y + 30:g}V{252 if y == max(heights) else y + 34:g}"/>')
    parts.append(f'<path class="arm" d="M{link_x:g} {link_y:g}L374 42"/>')
    parts.append(_round("link", link_x, link_y, shares.get(("link", 0), 0.0), True))
    parts.append(f'<path class="sense" d="M{link_x - 12:g} {link_y + 28:g}L215 256"/>')
    parts.append(f'<path class="wire" marker-end="url(#tip)" d="M338 258L312 {link_y + 33:g}"/>')
    parts.append(_box("command", 6, 104, shares, "command"))
    parts.append(_box("timing", 6, 256, shares, "timing"))
    parts.append(_box("sensors", 136, 256, shares, "sensor"))
    parts.append(_box("environment", 290, 256, shares, "environment", 104))
    parts.append('<path class="sense" d="M94 282H134"/>')
    return "".join(parts) + "</svg>"


def _share(shares: Shares, site: str, number: int) -> float:
    """The share of one motor or transmission, and that of both alike."""
    return shares.get((site, number), 0.0) + shares.get((site, 0), 0.0)


def _chain(sketch: JointSketch, shares: Shares, heights: tuple[float, ...], x: float, y: float) -> str:
    """The transmissions between motors and link."""
    if sketch.arrangement == "rigid":
        return f'<path class="arm" d="M185 {heights[0]:g}H{x:g}"/>'
    if sketch.arrangement == "serial":
        pushes = f'<path class="wire" marker-end="url(#tip)" d="M178 {heights[1] - 20:g}L220 {y - 4:g}"/>'
        return pushes + _spring(185.0, heights[0], x - 30, y - 4, _share(shares, "transmission", 1), 1)
    return "".join(
        _spring(185.0, each, x - 28, y + 8 * (1 if each > y else -1 if each < y else 0),
                _share(shares, "transmission", i + 1), i + 1)
        for i, each in enumerate(heights)
    )  # fmt: skip


def _spring(x0: float, y0: float, x1: float, y1: float, share: float, number: int) -> str:
    length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
    along, aside = ((x1 - x0) / length, (y1 - y0) / length), (-(y1 - y0) / length, (x1 - x0) / length)
    points = [(x0, y0)]
    for k in range(9):
        at, out = (0.1 + 0.1 * k) * length, (0.0 if k in (0, 8) else 9.0 if k % 2 else -9.0)
        points.append((x0 + along[0] * at + aside[0] * out, y0 + along[1] * at + aside[1] * out))
    points.append((x1, y1))
    path = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
    side = -1.0 if y0 <= y1 + 0.1 else 1.0  # of the spring on which there is space
    label = (middle[0] + 4, middle[1] + side * 34.0)
    width = 1.6 + 2.5 * share
    colour = DEPTHS[max(_depth(share), 3)] if share > 0.0 else "#7a858f"
    pill = _pill(label[0], label[1], side, share, f"transmission {number}")
    return f'<path class="spring" stroke="{colour}" stroke-width="{width:.1f}" d="M{path}"/>{pill}'


def _pill(x: float, y: float, side: float, share: float, name: str) -> str:
    depth = _depth(share)
    ink = "light" if depth >= WHITE_FROM else "dark"
    return (
        f'<rect x="{x - 29:.1f}" y="{y - 10:.1f}" width="58" height="20" rx="10" fill="{DEPTHS[depth]}" '
        f'class="site" stroke-width="{1 + 2 * share:.1f}"/>'
        f'<text class="share {ink}" x="{x:.1f}" y="{y + 4.5:.1f}">{_said(share)}</text>'
        f'<text class="name" x="{x:.1f}" y="{y + (24 if side > 0 else -14):.1f}">{escape(name)}</text>'
    )


def _round(name: str, x: float, y: float, share: float, seen: bool) -> str:
    depth = _depth(share)
    ink = "light" if depth >= WHITE_FROM else "dark"
    dashed = "" if seen else ' stroke-dasharray="4 3"'
    note = "" if seen else f'<text class="name" x="{x:g}" y="{y + 43:g}">not seen</text>'
    return (
        f'<circle cx="{x:g}" cy="{y:g}" r="29" fill="{DEPTHS[depth]}" class="site" '
        f'stroke-width="{1.2 + 2.5 * share:.1f}"{dashed}/>'
        f'<text class="share {ink}" x="{x:g}" y="{y + 5:g}">{_said(share)}</text>'
        f'<text class="name" x="{x:g}" y="{y - 35:g}">{escape(name)}</text>{note}'
    )


def _box(name: str, x: float, y: float, shares: Shares, site: str, width: float = 86) -> str:
    share = min(sum(value for (where, _), value in shares.items() if where == site), 1.0)
    depth = _depth(share)
    ink = "light" if depth >= WHITE_FROM else "dark"
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="54" rx="6" fill="{DEPTHS[depth]}" class="site" '
        f'stroke-width="{1.2 + 2.5 * share:.1f}"/>'
        f'<text class="name {ink}" x="{x + width / 2:g}" y="{y + 20:g}">{escape(name)}</text>'
        f'<text class="share {ink}" x="{x + width / 2:g}" y="{y + 42:g}">{_said(share)}</text>'
    )


def _depth(share: float) -> int:
    return sum(share >= step for step in STEPS[1:])


def _said(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "-"
