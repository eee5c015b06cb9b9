"""Diagnosis of the difference between the robot's published model and its recordings, written to its own page."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

from via_core.bags.importing import import_recordings
from via_core.devices import load_device
from via_gap.diagnosis import diagnose
from via_gap.logs.log import read_log
from via_gap.rendering.names import place_words
from via_gap.rendering.page import write_page
from via_gap.rendering.words import cautions, headline, next_steps
from via_gap.report.report import GapReport

from via_bringup.demo.pictures import shares
from via_bringup.demo.summary import DiagnosisPart, Progress

DEVICE = "maccepavd"
SAMPLE = Path("samples") / DEVICE  # in via_core; small, so that the diagnosis takes seconds
REPEAT = re.compile(r"traj\d+_3\.csv$")  # repeat 3, which the sample contains for every trajectory
PAGE = "diagnosis.html"
MOST = 5  # causes in the picture


def diagnosis(out: Path, progress: Progress) -> DiagnosisPart:
    """Diagnose the shipped sample of recordings. Writes `diagnosis.html`, `diagnosis.json` and two pictures."""
    report = diagnosed_sample(lambda step, share: progress(share, 1.0, step))
    write_page(report, out / PAGE)
    (out / PAGE).with_suffix(".json").write_text(report.to_json() + "\n", encoding="utf-8")
    gap = report.gap
    _draw(report, out / "pictures")
    return DiagnosisPart(
        verdict=report.verdict,
        headline=headline(report),
        cautions=" ".join(cautions(report)),
        next=next_steps(report)[0] if next_steps(report) else "",
        named=[each.effect for each in report.effects],
        runs=len(report.logs),
        before=gap.before if gap is not None else None,
        tuned=gap.tuned if gap is not None else None,
        after=gap.after if gap is not None else None,
        page=PAGE,
    )


def _draw(report: GapReport, pictures: Path) -> None:
    """The causes with their probabilities, and the error of each model."""
    if report.causes:
        named = [place_words(each) for each in report.effects]
        found = {place_words(each.place): each.probability for each in report.causes[:MOST]}
        shares(found, named, "probability that this effect acts [%]", pictures / "causes.png")
    if report.gap is not None:
        gap = report.gap
        errors = {"published model": gap.before, "numbers of the model fitted": gap.tuned}
        if report.effects:
            errors["with the named effects"] = gap.after
        label = "error of the simulated angle [% of its standard deviation]"
        shares({**errors, "sensor noise alone": gap.floor}, ["with the named effects"], label, pictures / "repair.png")


def diagnosed_sample(progress: Callable[[str, float], None]) -> GapReport:
    """Report on the sample. It holds out time blocks, which takes a tenth of the time of holding out whole runs."""
    device = load_device(DEVICE)
    with as_file(files("via_core") / str(SAMPLE)) as folder, tempfile.TemporaryDirectory() as bags:
        imported = import_recordings(folder, DEVICE, bags).accepted
        logs = [read_log(file.bag, device) for file in imported if file.bag and REPEAT.search(file.source)]
    return diagnose(logs, device, progress=progress)
