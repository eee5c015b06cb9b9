"""Run the whole demo: robot, live joint and diagnosis, then write summary.json and the page."""

from __future__ import annotations

import platform
import shutil
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from via_core.errors import ViaError

from via_bringup.commit import commit
from via_bringup.demo.diagnosis import diagnosis
from via_bringup.demo.live import live
from via_bringup.demo.recordings import recordings as recordings_of
from via_bringup.demo.robot import real_robot
from via_bringup.demo.summary import Summary

MARK = ".via-demo"  # marks a folder made by the demo, which may be replaced
Progress = Callable[[str, float, float, str], None]  # part, done, total, step


def run_demo(out: Path, recordings: Path | None, duration: float, progress: Progress) -> Summary:
    """Run the demo and return its summary. `out` is replaced only after everything succeeded.

    recordings  folder with MACCEPA-VD recordings; None: the full data set if present, else the shipped sample
    duration    [s] of the live run

    Raises ViaError if `out` has other content or cannot be written.
    """
    unfinished = _begin(out)
    began = time.monotonic()
    seconds: dict[str, float] = {}

    def taken(part: str, since: float) -> float:
        now = time.monotonic()
        seconds[part] = round(now - since, 1)
        return now

    with recordings_of(recordings) as (folder, source):
        robot = real_robot(folder, source, unfinished, lambda *step: progress("real robot", *step))
    at = taken("robot", began)
    joint = live(unfinished, duration, lambda *step: progress("simulated joint", *step))
    at = taken("live", at)
    why = diagnosis(unfinished, lambda *step: progress("diagnosis", *step))
    taken("diagnosis", at)
    taken("total", began)
    summary = Summary(
        version=version("via_bringup"),
        commit=commit(),
        python=platform.python_version(),
        seconds=seconds,
        robot=robot,
        live=joint,
        diagnosis=why,
    )
    (unfinished / "summary.json").write_text(summary.model_dump_json(indent=2) + "\n", encoding="utf-8")
    write_page(summary, unfinished / "index.html")
    shutil.rmtree(out, ignore_errors=True)
    unfinished.rename(out)
    return summary


def write_page(summary: Summary, path: Path) -> None:
    """Write the HTML page, which shows the pictures beside it."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(files("via_bringup.demo").joinpath("page.html").read_text("utf-8"))
    path.write_text(template.render(s=summary), encoding="utf-8")


def _begin(out: Path) -> Path:
    """Create an empty working folder next to `out`. Raises ViaError."""
    unfinished = out.parent / f"{out.name}.unfinished"
    for folder in (out, unfinished):
        if folder.exists() and not (folder.is_dir() and (not any(folder.iterdir()) or (folder / MARK).exists())):
            raise ViaError(f"{folder} was not made by the demo; choose another folder with --out")
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        (unfinished / MARK).touch()
    except OSError as error:
        raise ViaError(f"cannot create {unfinished}: {error.strerror}; choose another folder with --out") from None
    return unfinished
