"""A report of the diagnosis to damage, and the functions that read it."""

from __future__ import annotations

from pathlib import Path

from via_core.text_files import read_text
from via_gap.rendering.page import write_page
from via_gap.rendering.text import text
from via_gap.report.report import Cause, EffectLocation, GapReport, NuisanceValue, Value, Where, read_report
from via_gap.selection.gap import Gap, SignalGap
from via_sim.effects.files import effects_text


def read_whole_report(path: Path) -> None:
    """Read a report and show it as `via gap render` does."""
    report = read_report(read_text(path), path.name)
    effects_text(report.repaired(), report.intervals())
    text(report)
    write_page(report, path.with_suffix(".html"))


def sample_report() -> bytes:
    """A report with one cause and one fitted number of the device."""
    place = EffectLocation(effect="backlash", site="transmission", joint="elbow", motor=1)
    cause = Cause(
        **place.model_dump(), probability=0.9, share=0.9, left=0.01, score=0.7,
        parameters={"gap": Value(value=0.02, sd=1e-4, unit="rad")},
    )  # fmt: skip
    gap = Gap(
        by="segments", before=0.2, tuned=0.1, after=0.02, interval=(0.01, 0.03), floor=0.01, bound=0.02, explained=1.0,
        signals={"q": SignalGap(before=0.2, after=0.02, floor=0.01, bound=0.02, explained=1.0)},
    )  # fmt: skip
    inertia = NuisanceValue(name="link inertia", unit="kg m^2", filed=1.0, fitted=1.1, offset=1.0, at_bound=False)
    report = GapReport(
        joint="elbow", level="full", logs=("a",), holdout=("b",), verdict="effect", causes=(cause,), gap=gap,
        where=(Where(joint="elbow", site="transmission", motor=1, equation="link and motor 1", share=1.0),),
        equivalence_set=(place,), effects=(place,), nuisance=(inertia,), data_check=(), not_evaluated=(),
    )  # fmt: skip
    return report.to_json().encode()
