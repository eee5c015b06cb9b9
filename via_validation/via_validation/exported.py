"""Repairs of sealed cases exported to MuJoCo: does the exported model have the gap that the report states?

Keys are not opened: the question is the export, not the diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from via_core.devices import load_device
from via_export import check, export
from via_gap.logs.log import read_logs
from via_gap.report.report import read_report

from via_validation.sealed.sealing import DEVICE, logs_in, names_in

ALLOWED = 0.02  # difference of the gap where the format has slots for all effects


@dataclass(frozen=True)
class ExportedCase:
    """The gap after the repair of one case, relative to the standard deviation of the measurement.

    report   as the report states it; None if it compares equations instead of simulating
    via_sim  in the simulator of the diagnosis; `mujoco` in MuJoCo with the exported model
    lost     effects that MJCF has no slot for
    """

    name: str
    effects: tuple[str, ...]
    report: float | None
    via_sim: float
    mujoco: float
    lost: tuple[str, ...]

    @property
    def difference(self) -> float:
        """Gap in MuJoCo minus that of the report, or of the simulator of the diagnosis."""
        return self.mujoco - (self.via_sim if self.report is None else self.report)

    @property
    def kept(self) -> bool:
        """Whether the exported model has the gap of the report, or the list of losses says why not."""
        return bool(self.lost) or abs(self.difference) <= ALLOWED


def exported_cases(cases: Path, results: Path) -> Iterator[ExportedCase]:
    """Every case with a report that states a gap. Raises ViaError if one cannot be exported or simulated."""
    for name in names_in(cases):
        file = results / f"{name}.json"
        if not file.exists():
            continue
        report = read_report(file.read_text(encoding="utf-8"), str(file))
        if report.gap is None:
            continue
        device, effects = load_device(cases / name / DEVICE), report.repaired()
        named = {effect.name for effect in effects}
        logs = report.as_read(read_logs(logs_in(cases / name), device))
        found = check(logs, device, effects, held_out=report.held_out)
        yield ExportedCase(
            name,
            tuple(f"{effect.name} at {effect.site}" for effect in report.repair()),
            None if report.by_equations else report.gap.after,
            found.via_sim[1].overall,
            found.mujoco[1].overall,
            tuple(loss.item for loss in export(device, effects, "mjcf").losses if loss.item in named),
        )
