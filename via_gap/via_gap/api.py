"""The diagnosis for Python: arrays or files in, report out, and its numbers as pandas frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from via_core.devices import Device, load_device
from via_core.errors import SignalError, ViaError
from via_core.recordings.channels import joint_of
from via_core.recordings.entries import entries_of
from via_core.recordings.guess import UNITS, guess_columns
from via_core.signals import Signals

from via_gap.diagnosis import diagnose as diagnose_logs
from via_gap.logs.log import JointLog, read_log
from via_gap.report.report import GapReport
from via_gap.selection.search import Progress

if TYPE_CHECKING:
    from pandas import DataFrame

Data = Any  # a JointLog, Signals, a pandas frame, a mapping of arrays, or the path of a recording


def diagnose(
    data: Data | Sequence[Data],
    device: Device | str | Path,
    holdout: Sequence[Data] = (),
    progress: Progress | None = None,
) -> GapReport:
    """Location, cause and size of the gap between recordings and a device.

    data      one recording or a list of them: a pandas frame or a mapping of arrays (N,), with `time` [s], `position`
              [rad], `torque` [N m] and, if recorded, `velocity` [rad/s], `command` (goal [rad] of a position drive);
              or with the channels of VIA (`q`, `theta_1`, `tau_1` ...), or the columns that the device file names. A
              unit in a name is converted: `position_deg`, `torque_mNm`, `time_ms`. Also paths of files, Signals, logs
    device    a Device, the name of a shipped one, or the path of its YAML
    holdout   recordings to compare models on; without them, parts of `data` are held out
    progress  called with a stage and its share [0..1]

    Raises ViaError in one line.
    """
    described = device if isinstance(device, Device) else load_device(device)
    many = data if isinstance(data, (list, tuple)) else [data]
    logs = [
        log_of(each, described, f"recording {k}" if len(many) > 1 else "recording") for k, each in enumerate(many, 1)
    ]
    held = [log_of(each, described, f"held out {k}") for k, each in enumerate(holdout, 1)]
    return diagnose_logs(logs, described, held or None, progress)


def log_of(data: Data, device: Device, name: str) -> JointLog:
    """One recording as a log; see `diagnose`. Raises SignalError."""
    import pandas

    if isinstance(data, JointLog):
        return data
    if isinstance(data, (str, Path)):
        return read_log(data, device)
    if isinstance(data, Signals):
        data = {"time": data.time, **{channel: data[channel] for channel in data.channels}}
    try:
        frame = pandas.DataFrame(dict(data) if isinstance(data, Mapping) else data).reset_index(drop=True)
    except (TypeError, ValueError) as error:
        raise SignalError(f"{name}: is no table of equally long arrays: {' '.join(str(error).split())}") from None
    frame.columns = [str(column) for column in frame.columns]
    tables = {"": frame}
    named = device.wire.columns.get("q")
    if "q" not in frame and (named is None or named.column not in frame):
        guesses = [
            each if each.sure or not each.quantity else replace(each, unit=UNITS[each.quantity])
            for each in guess_columns(tables, [device.link_joint])
        ]
        try:
            columns = {
                channel: entry for channel, (entry, _) in entries_of(tables, guesses, device.link_joint).columns.items()
            }
        except ViaError as error:
            raise SignalError(f"{name}: {error}") from None
        if device.drive == "torque":
            columns.pop("equilibrium", None)
        wire = device.wire.model_validate({**device.wire.model_dump(), "columns": columns})
        described = device.model_copy(update={"wire": wire})
    else:
        described = device
    log = JointLog.of(name, described, joint_of(tables, described, name))
    return replace(log, device=device)


def frames(report: GapReport) -> dict[str, DataFrame]:
    """The numbers of a report: `causes`, `where`, `gap`, `device` and `findings`, one frame each."""
    import pandas

    named = {(each.effect, each.site, each.motor) for each in report.effects}
    causes = [
        {"effect": c.effect, "site": c.site, "motor": c.motor, "named": (c.effect, c.site, c.motor) in named,
         "probability": c.probability, "parameter": name, "value": v.value, "sd": v.sd, "unit": v.unit, "left": c.left}
        for c in report.causes
        for name, v in (c.parameters.items() or [])
    ]  # fmt: skip
    where = [{"site": w.site, "motor": w.motor, "equation": w.equation, "share": w.share} for w in report.where]
    gap = report.gap
    signals = [] if gap is None else [{"signal": name, **each.model_dump()} for name, each in gap.signals.items()]
    if gap is not None:
        signals.append({"signal": "all", **gap.model_dump(include={"before", "after", "floor", "bound", "explained"})})
    content = {
        "causes": causes,
        "where": where,
        "gap": signals,
        "device": [each.model_dump() for each in report.nuisance],
        "findings": [each.model_dump() for each in report.data_check],
    }
    return {name: pandas.DataFrame(rows) for name, rows in content.items()}
