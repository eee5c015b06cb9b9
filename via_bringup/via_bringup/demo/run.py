"""The demo from end to end: robot, live joint and diagnosis, then summary.json and the page."""

from __future__ import annotations

import platform
import shutil
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from via_core.errors import ViaError

from via_bringup.demo.diagnosis import diagnosis
from via_bringup.demo.live import live
from via_bringup.demo.page import write_page
from via_bringup.demo.robot import real_robot
from via_bringup.demo.summary import Summary
from via_bringup.provenance import commit
from via_bringup.recordings import recordings as recordings_of

MARK = ".via-demo"  # a folder with this file was made by the demo and may be made anew
Progress = Callable[[str, float, float, str], None]  # part, done, of how much, what


def run_demo(out: Path, recordings: Path | None, duration: float, progress: Progress) -> Summary:
    """Everything the demo does; `out` is replaced once all is done, and stays as it was if anything fails before.

    recordings  folder of real MACCEPA-VD runs; None: the whole set where it lies beside the repo, else the sample
    duration    [s] of the live run

    Raises ViaError where `out` holds something the demo did not make or cannot be written.
    """
    unfinished = _begin(out)
    began = time.monotonic()
    seconds: dict[str, float] = {}

    def taken(part: str, since: float) -> float:
        now = time.monotonic()
        seconds[part] = round(now - since, 1)
        return now

    with recordings_of(recordings) as (folder, source):
        robot = real_robot(folder, source, unfinished, lambda done, of, what: progress("real robot", done, of, what))
    at = taken("robot", began)
    joint = live(unfinished, duration, lambda done, of, what: progress("simulated joint", done, of, what))
    at = taken("live", at)
    why = diagnosis(unfinished, lambda done, of, what: progress("diagnosis", done, of, what))
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


def _begin(out: Path) -> Path:
    """An empty folder beside `out` to work in."""
    unfinished = out.parent / f"{out.name}.unfinished"
    for folder in (out, unfinished):
        if folder.exists() and not (folder.is_dir() and (not any(folder.iterdir()) or (folder / MARK).exists())):
            raise ViaError(f"{folder} is not the demo's; choose another folder with --out")
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        (unfinished / MARK).touch()
    except OSError as error:
        raise ViaError(f"{unfinished} cannot be made: {error.strerror}; choose another folder with --out") from None
    return unfinished
