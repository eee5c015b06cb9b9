"""A report as one HTML file that needs nothing else: no network, no library, readable without its script.

write_page(report, path)
text = page(report)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined, Template
from markupsafe import Markup
from via_core.devices import device_names
from via_core.errors import ViaError
from via_sim.effects_file import effects_text

from via_gap.rendering import evidence_words, names, words
from via_gap.rendering.joint_picture import joint_picture, sketch_of
from via_gap.rendering.numbers import chance, number, percent, prefixed, raised
from via_gap.rendering.pictures import (
    Drawn,
    Row,
    after_words,
    device_lines,
    error_rows,
    gap_ladder,
    parameter_lines,
    residual_rows,
    spectrum_row,
    trace_rows,
)
from via_gap.rendering.text import ranked
from via_gap.report.report import Cause, GapReport, Noise

NEAREST = 3  # causes that are shown where none is named


def page(report: GapReport) -> str:
    """The whole page; every text that came with the report is escaped."""
    repair, spectrum = report.repaired(), spectrum_row(report)
    return _template().render(
        r=report,
        style=Markup(_shipped("page.css")),
        script=Markup(_shipped("page.js")),
        headline=words.headline(report),
        named=evidence_words.names_causes(report),
        device=report.joint if report.joint in device_names() else f"{report.joint}.yaml",
        cautions=words.cautions(report),
        picture=Markup(joint_picture(sketch_of(report), {(w.site, w.motor): w.share for w in report.where})),
        residuals=_marked(residual_rows(report)),
        spectra=_marked((spectrum,)) if spectrum is not None else [],
        causes=_drawn(report),
        ties=evidence_words.tie_words(report),
        conformal=evidence_words.conformal_words(report),
        rejected=evidence_words.rejected(report),
        screened=evidence_words.screened_words(report),
        gap_words=words.gap_words(report),
        findings=evidence_words.findings(report),
        several=len({*report.logs, *(f.log for f in report.data_check), *(n.log for n in report.noise)}) > 1,
        ladder=_markup(gap_ladder(report.gap, after_words(report))) if report.gap is not None else None,
        traces=_marked(trace_rows(report)),
        errors=_marked(error_rows(report)),
        device_lines=Markup(device_lines(report)) if report.nuisance else "",
        after=after_words(report),
        steps=words.next_steps(report),
        repair=effects_text(repair, report.intervals()) if repair else "",
        repair_words=words.repair_words(report),
        level=names.LEVELS[report.level],
        untried=[names.effect_words(name) for name in report.figures.untried] if report.figures else [],
    )


@cache
def _template() -> Template:
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(
        number=number, percent=_kept(percent), chance=_kept(chance), raised=raised, region=evidence_words.region_words,
        place=names.place_words, where=names.where_words, logs=names.log_words, listed=names.listed,
        capital=names.capital, plain=names.plain, signal=lambda name: names.SIGNALS.get(name, name),
    )  # fmt: skip
    environment.globals.update(
        evidence=evidence_words.evidence, seen_in=evidence_words.seen_in, boxes=words.boxes,
        values=evidence_words.values_words, lines=lambda cause: Markup(parameter_lines(cause)),
        noise_words=noise_words,
    )  # fmt: skip
    return environment.from_string(_shipped("page.html"))


def write_page(report: GapReport, path: Path) -> None:
    """The page into a file. Raises ViaError where it cannot be written."""
    try:
        path.write_text(page(report), encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None


def noise_words(each: Noise) -> tuple[str, str, str]:
    """Declared and estimated standard deviation, and jitter of the time stamps, with units."""
    declared = "not stated" if each.declared is None else prefixed(each.declared, each.unit)
    return declared, prefixed(each.estimated, each.unit), prefixed(each.jitter, "s")


def _drawn(report: GapReport) -> tuple[Cause, ...]:
    """The causes shown in detail; where none is named, only the first few."""
    found = ranked(report)
    return found if evidence_words.names_causes(report) else found[:NEAREST]


def _kept(written: Callable[[float], str]) -> Callable[[float], str]:
    """The same text with non-breaking spaces, so that a number and its unit stay together."""
    return lambda value: written(value).replace(" ", "\u00a0")


def _shipped(name: str) -> str:
    return files("via_gap.rendering").joinpath(name).read_text(encoding="utf-8")


def _marked(rows: tuple[Row, ...]) -> list[Row]:
    return [Row(row.title, tuple(map(_markup, row.charts)), row.leading) for row in rows]


def _markup(drawn: Drawn) -> Drawn:
    return Drawn(drawn.caption, Markup(drawn.svg))
