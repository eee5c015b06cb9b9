"""The gap of a withheld log before and after the repair of a report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from via_core.devices import load_device
from via_gap.logs.log import read_log
from via_gap.report.report import GapReport
from via_gap.report.withheld import before_and_after


def gap_of_repair(log: Path, device: str, report: GapReport) -> dict[str, float]:
    """`before` and `after` the repair, and the `floor` of sensor noise, all over the measured standard deviation.

    device  name of the nominal device, or path of its file

    Raises ViaError where a file cannot be read or nothing can be simulated.
    """
    nominal = load_device(device)
    logs = report.as_read([read_log(log, nominal)])
    before, after = before_and_after(logs, nominal, report.repaired(), (), report.by_equations)
    return {"before": before.overall, "after": after.overall, "floor": float(np.sqrt(np.mean(after.floors**2)))}
