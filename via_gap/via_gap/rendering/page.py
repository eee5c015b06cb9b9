"""A report as one HTML file that needs nothing else: no network, no library, readable without its script.

write_page(report, path)
text = page(report)
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from via_core.devices import device_names
from via_core.text_files import write_text
from via_sim.effects.files import effects_text

from via_gap.rendering import evidence_words, joint_picture, names, pictures, words
from via_gap.rendering.numbers import chance, number, percent, prefixed, raised
from via_gap.rendering.text import ranked
from via_gap.report.report import GapReport


def page(report: GapReport) -> str:
    """The whole page; every text that came with the report is escaped."""
    return environment().get_template("page.html").render(r=report)


@cache
def environment() -> Environment:
    """The templates of this folder, with the functions that they call; floats are written by %g."""
    made = Environment(
        loader=PackageLoader("via_gap", "rendering"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, finalize=lambda value: f"{value:g}" if isinstance(value, float) else value,
    )  # fmt: skip
    picture = joint_picture
    made.filters.update(
        number=number, raised=raised, prefixed=prefixed, px=lambda value: f"{value:.1f}",
        # Non-breaking spaces keep a number and its unit together.
        percent=lambda value: percent(value).replace(" ", "\u00a0"),
        chance=lambda value: chance(value).replace(" ", "\u00a0"),
        place=names.place_words, where=names.where_words, logs=names.log_words, listed=names.listed,
        capital=names.capital, plain=names.plain, effect=names.effect_words,
        quantity=lambda by: names.QUANTITIES.get(by, by), signal=lambda name: names.SIGNALS.get(name, name),
        fill=picture.fill, ink=picture.ink, said=picture.said, stroke=picture.stroke,
    )  # fmt: skip
    made.globals.update(
        words=words, evidence=evidence_words, pictures=pictures, levels=names.LEVELS, ranked=ranked,
        effects_text=effects_text, device_names=device_names, picture_of=picture.picture_of, spring=picture.spring,
        style=_shipped("page.css"), script=_shipped("page.js"),
    )  # fmt: skip
    return made


def write_page(report: GapReport, path: Path) -> None:
    """The page into a file. Raises ViaError where it cannot be written."""
    write_text(path, page(report))


def _shipped(name: str) -> Markup:
    return Markup(files("via_gap.rendering").joinpath(name).read_text(encoding="utf-8"))
