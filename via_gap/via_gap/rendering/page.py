"""A report as one HTML file that needs nothing else: no network, no library, readable without its script.

write_page(report, path)
text = page(report)
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Literal

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from via_core.devices import device_names
from via_core.errors import ViaError
from via_sim.effects import spots
from via_sim.effects_file import effects_text

from via_gap.candidates.localisation import Region
from via_gap.rendering import words
from via_gap.rendering.joint_picture import joint_picture
from via_gap.rendering.numbers import chance, number, percent, raised, with_sd
from via_gap.rendering.pictures import Drawn, Row, after_words, error_rows, gap_ladder, residual_rows, trace_rows
from via_gap.report.figures import JointSketch
from via_gap.report.report import Cause, GapReport

NEAREST = 3  # causes that are drawn where none is the answer
LIKELY = 0.01  # probability from which a cause is drawn as one; the others are in the table of what was ruled out


def page(report: GapReport) -> str:
    """The whole page; every text that came with the report is escaped."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(
        number=number, percent=_kept(percent), chance=_kept(chance), raised=raised, region=_region,
        place=words.place_words, where=words.where_words, logs=words.log_words, listed=words.listed,
        capital=words.capital,
    )  # fmt: skip
    environment.globals.update(with_sd=with_sd, evidence=words.evidence, seen_in=words.seen_in, boxes=words.boxes)
    repair, trials = report.repaired(), words.ruled_out(report)
    return environment.from_string(_shipped("page.html")).render(
        r=report,
        style=Markup(_shipped("page.css")),
        script=Markup(_shipped("page.js")),
        headline=words.headline(report),
        named=report.verdict in ("effect", "two_effects"),
        device=report.joint if report.joint in device_names() else f"{report.joint}.yaml",
        cautions=words.cautions(report),
        picture=Markup(joint_picture(_sketch(report), {(w.site, w.motor): w.share for w in report.where})),
        residuals=_marked(residual_rows(report)),
        causes=_drawn(report),
        apart=words.equivalence_words(report),
        out=[each for each in trials if each.decided],
        doubtful=[each for each in trials if not each.decided],
        screened=words.screened_words(report),
        gap_words=words.gap_words(report),
        findings=words.findings(report),
        ladder=_markup(gap_ladder(report.gap, after_words(report))) if report.gap is not None else None,
        traces=_marked(trace_rows(report)),
        errors=_marked(error_rows(report)),
        steps=words.next_steps(report),
        repair=effects_text(repair, report.intervals()) if repair else "",
        level=words.LEVELS[report.level],
        untried=[words.effect_words(name) for name in report.figures.untried] if report.figures else [],
    )


def write_page(report: GapReport, path: Path) -> None:
    """The page into a file. Raises ViaError where it cannot be written."""
    try:
        path.write_text(page(report), encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None


def _drawn(report: GapReport) -> list[Cause]:
    """The causes that are drawn one by one; of those that explain nothing only the nearest few."""
    likely = [cause for i, cause in enumerate(report.causes) if i == 0 or cause.probability >= LIKELY]
    return likely[:NEAREST] if report.verdict == "unknown" else likely


def _kept(written: Callable[[float], str]) -> Callable[[float], str]:
    """A number whose unit stays on its line."""
    return lambda value: written(value).replace(" ", "\u00a0")


def _shipped(name: str) -> str:
    return files("via_gap.rendering").joinpath(name).read_text(encoding="utf-8")


def _marked(rows: tuple[Row, ...]) -> list[Row]:
    return [Row(row.title, tuple(map(_markup, row.charts)), row.leading) for row in rows]


def _markup(drawn: Drawn) -> Drawn:
    return Drawn(drawn.caption, Markup(drawn.svg))


def _sketch(report: GapReport) -> JointSketch:
    """The joint, or what a report without figures lets one guess of it."""
    if report.figures is not None:
        return report.figures.joint
    places = {*((each.site, each.motor) for each in report.where), *((each.site, each.motor) for each in report.causes)}
    named = [spot for place in places for spot in spots(*place)]
    motors = max((number for _, number in named), default=0)
    seen = (report.level in ("full", "no torque"),) * max(motors, 1)
    arrangement: Literal["antagonistic", "flexible"] = "antagonistic" if motors > 1 else "flexible"
    return JointSketch(arrangement=arrangement, drive="torque", motors_seen=seen, torque_seen=report.level == "full")


def _region(region: Region) -> str:
    """speed 0 to 0.46 rad/s: 37 % of the gap in 20 % of the data."""
    return (
        f"{region.by} {number(region.low)} to {number(region.high)} {region.unit}: "
        f"{percent(region.share)} of it in {percent(region.data)} of the data"
    )
