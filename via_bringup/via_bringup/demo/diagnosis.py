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
from via_gap.rendering.page import write_page
from via_gap.rendering.words import headline
from via_gap.report.report import GapReport

from via_bringup.demo.summary import DiagnosisPart

DEVICE = "maccepavd"
SAMPLE = Path("samples") / DEVICE  # in via_core; small, so that the diagnosis takes seconds
REPEAT = re.compile(r"traj\d+_3\.csv$")  # repeat 3, which the sample contains for every trajectory
PAGE = "diagnosis.html"
Progress = Callable[[float, float, str], None]  # done, total, step


def diagnosis(out: Path, progress: Progress) -> DiagnosisPart:
    """Diagnose the shipped sample of recordings. Writes `diagnosis.html` and `diagnosis.json` in `out`."""
    report = diagnosed_sample(lambda step, share: progress(share, 1.0, step))
    write_page(report, out / PAGE)
    (out / PAGE).with_suffix(".json").write_text(report.to_json() + "\n", encoding="utf-8")
    gap = report.gap
    return DiagnosisPart(
        verdict=report.verdict,
        headline=headline(report),
        named=[each.effect for each in report.effects],
        runs=len(report.logs),
        before=gap.before if gap is not None else None,
        after=gap.after if gap is not None else None,
        page=PAGE,
    )


def diagnosed_sample(progress: Callable[[str, float], None]) -> GapReport:
    """Report on the sample. It holds out time blocks, which takes a tenth of the time of holding out whole runs."""
    device = load_device(DEVICE)
    with as_file(files("via_core") / str(SAMPLE)) as folder, tempfile.TemporaryDirectory() as bags:
        imported = import_recordings(folder, DEVICE, bags).accepted
        logs = [read_log(file.bag, device) for file in imported if file.bag and REPEAT.search(file.source)]
    return diagnose(logs, device, progress=progress)
