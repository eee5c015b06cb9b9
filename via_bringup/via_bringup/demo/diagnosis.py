"""The demo's diagnosis: why the robot's published model differs from its recordings, as a page of its own."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

from via_core.bags import import_recordings
from via_core.devices import load_device
from via_gap.diagnose import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.rendering.page import write_page
from via_gap.rendering.words import headline
from via_gap.report.report import GapReport

from via_bringup.demo.summary import DiagnosisPart

DEVICE = "maccepavd"
SAMPLE = Path("samples") / DEVICE  # within via_core: small enough that the diagnosis takes seconds
REPEAT = "3"  # the sample has this repeat of every trajectory
JUDGED = ("2",)  # trajectories to judge on; the others are fitted
PAGE = "diagnosis.html"
Progress = Callable[[float, float, str], None]  # done, of how much, what


def diagnosis(out: Path, progress: Progress) -> DiagnosisPart:
    """Diagnose the shipped sample of the robot's recordings; writes `diagnosis.html` and `diagnosis.json` in `out`."""
    report, fitted, judged = diagnosed_sample(lambda what, share: progress(share, 1.0, what))
    write_page(report, out / PAGE)
    (out / PAGE).with_suffix(".json").write_text(report.to_json() + "\n", encoding="utf-8")
    return DiagnosisPart(
        verdict=report.verdict,
        headline=headline(report),
        named=[place.effect for place in report.effects],
        fitted=fitted,
        judged=judged,
        before=report.gap.before if report.gap is not None else None,
        after=report.gap.after if report.gap is not None else None,
        page=PAGE,
    )


def diagnosed_sample(progress: Callable[[str, float], None]) -> tuple[GapReport, int, int]:
    """The report on the sample, and how many runs were fitted and judged."""
    device = load_device(DEVICE)
    fitted: list[JointLog] = []
    judged: list[JointLog] = []
    trajectories: dict[str, str] = {}
    with as_file(files("via_core") / str(SAMPLE)) as folder, tempfile.TemporaryDirectory() as bags:
        for file in import_recordings(folder, DEVICE, bags).files:
            found = re.search(rf"traj(\d+)_{REPEAT}\.csv$", file.source)
            if found is None or file.bag is None:
                continue
            log = read_log(file.bag, device)
            trajectories[log.name] = found[1]
            (judged if found[1] in JUDGED else fitted).append(log)
    return diagnose(fitted, device, judged, progress, groups=trajectories), len(fitted), len(judged)
