"""The demo's diagnosis: why the robot's published model differs from its recordings, as a page of its own."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

from via_core.bags.importing import import_recordings
from via_core.devices import load_device
from via_gap.diagnose import diagnose
from via_gap.logs.log import read_log
from via_gap.rendering.page import write_page
from via_gap.rendering.words import headline
from via_gap.report.report import GapReport

from via_bringup.demo.summary import DiagnosisPart

DEVICE = "maccepavd"
SAMPLE = Path("samples") / DEVICE  # within via_core: small enough that the diagnosis takes seconds
REPEAT = re.compile(r"traj\d+_3\.csv$")  # the sample has this repeat of every trajectory
PAGE = "diagnosis.html"
Progress = Callable[[float, float, str], None]  # done, of how much, what


def diagnosis(out: Path, progress: Progress) -> DiagnosisPart:
    """Diagnose the shipped sample of the robot's recordings; writes `diagnosis.html` and `diagnosis.json` in `out`."""
    report = diagnosed_sample(lambda what, share: progress(share, 1.0, what))
    write_page(report, out / PAGE)
    (out / PAGE).with_suffix(".json").write_text(report.to_json() + "\n", encoding="utf-8")
    gap = report.gap
    return DiagnosisPart(
        verdict=report.verdict,
        headline=headline(report),
        named=[place.effect for place in report.effects],
        runs=len(report.logs),
        before=gap.before if gap is not None else None,
        after=gap.after if gap is not None else None,
        page=PAGE,
    )


def diagnosed_sample(progress: Callable[[str, float], None]) -> GapReport:
    """The report on the sample; stretches of its runs are held out, which takes a tenth of the time of whole runs."""
    device = load_device(DEVICE)
    with as_file(files("via_core") / str(SAMPLE)) as folder, tempfile.TemporaryDirectory() as bags:
        imported = import_recordings(folder, DEVICE, bags).accepted
        logs = [read_log(file.bag, device) for file in imported if file.bag and REPEAT.search(file.source)]
    return diagnose(logs, device, progress=progress)
