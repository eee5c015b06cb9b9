"""Foreign recordings (CSV) into bags, by a mapping file, refusing with a reason what cannot be true.

One bag per recording: /joint_states, /<device>/command and a std_msgs/Float64 topic for every further scalar, ordered
by stamp, commands before measurements of the same stamp. Values keep every bit; stamps are rounded to ns and shifted by
one whole offset, kept in the bag's metadata, so that none is negative.
"""

from __future__ import annotations

import csv
import re
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from via_core.bags.definitions import typestore_of
from via_core.bags.findings import Finding
from via_core.bags.layout import filled
from via_core.bags.mapping import Mapping, Table, load_mapping
from via_core.bags.messages import Stream, command_messages, in_order, joint_messages
from via_core.bags.recording_checks import check_recording, check_samples, usable_stamps
from via_core.bags.writer import BagWriter
from via_core.devices import Device, load_device
from via_core.errors import BagError, ImportMapError
from via_core.signals import Array, Signals
from via_core.wire import JOINT_STATE, VSA_COMMAND

FLOAT64 = "std_msgs/msg/Float64"
_QUANTITIES = ("position", "velocity", "effort")


@dataclass(frozen=True)
class FileReport:
    """What became of one recording.

    source       path below the folder
    bag          the bag made of it, None when it was refused
    findings     everything the checks have to say, errors first; errors are the reasons of a refusal
    samples      measurements in the bag (or that would have been)
    commands     commands likewise
    time_offset  [ns] added to every stamp
    """

    source: str
    bag: Path | None
    findings: tuple[Finding, ...]
    samples: int
    commands: int
    time_offset: int

    @property
    def accepted(self) -> bool:
        return self.bag is not None

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it was refused, one sentence each; empty when it was accepted."""
        return tuple(each.text for each in self.findings if each.severity == "error")


@dataclass(frozen=True)
class ImportReport:
    """What became of every recording of a folder."""

    folder: Path
    mapping: str  # its title
    files: tuple[FileReport, ...]

    @property
    def accepted(self) -> tuple[FileReport, ...]:
        return tuple(each for each in self.files if each.accepted)

    @property
    def refused(self) -> tuple[FileReport, ...]:
        return tuple(each for each in self.files if not each.accepted)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; bags by name."""
        return {
            "mapping": self.mapping,
            "accepted": len(self.accepted),
            "refused": len(self.refused),
            "files": [
                {**asdict(each), "bag": each.bag.name if each.bag else None, "reasons": list(each.reasons)}
                for each in self.files
            ],
        }


@dataclass(frozen=True)
class _Run:
    """One recording, read: SI values by column index of its table, stamps [ns] not yet shifted."""

    stamp: NDArray[np.int64]
    joints: Array  # (N, columns)
    scalars: Array  # (N, columns)
    command_stamp: NDArray[np.int64]
    commands: dict[str, Array]
    findings: tuple[Finding, ...]


class _BadFileError(Exception):
    """A file that is damaged as a table; its text is the reason of the refusal."""


def import_recordings(folder: str | Path, mapping: str | Path | Mapping, out: str | Path) -> ImportReport:
    """Make a bag in `out` of every recording in `folder` that can be what it claims; report all others with reasons.

    mapping  a Mapping, the name of a shipped one, or a file
    Raises ImportMapError when no file matches or the columns of none fit, BagError when a bag exists already or `out`
    cannot be written. An interrupted import leaves the bags finished so far and nothing of the one begun.
    """
    folder, out = Path(folder), Path(out)
    mapping = mapping if isinstance(mapping, Mapping) else load_mapping(mapping)
    device = None if mapping.device is None else load_device(mapping.device)
    found = _recordings(folder, mapping)
    for name, _, _ in found:
        if (out / name).exists():
            raise BagError(f"{out / name} exists already; remove it or choose another folder")
    files = [_import_one(folder, path, groups, name, mapping, device, out) for name, path, groups in found]
    if all(each.findings and each.findings[0].check == "columns" for each in files):
        raise ImportMapError(files[0].reasons[0])
    return ImportReport(folder, mapping.title, tuple(files))


def _recordings(folder: Path, mapping: Mapping) -> list[tuple[str, Path, dict[str, str]]]:
    """Bag name, path and named groups of every file that matches, in natural order (traj2 before traj10)."""
    if not folder.is_dir():
        raise ImportMapError(f"no folder {folder}")
    found: dict[str, tuple[str, Path, dict[str, str]]] = {}
    for path in sorted((path for path in folder.rglob("*") if path.is_file()), key=_natural):
        match = re.fullmatch(mapping.recordings.pattern, path.relative_to(folder).as_posix())
        if match is None:
            continue
        name = mapping.recordings.bag.format(**match.groupdict(""))
        if Path(name).name != name or name in ("", ".."):  # a mapping from elsewhere shall not write elsewhere
            raise ImportMapError(f"recordings.bag makes '{name}' of {path.name}, which is not the name of one folder")
        if name in found:
            raise ImportMapError(f"{found[name][1].name} and {path.name} would both become the bag '{name}'")
        found[name] = (name, path, match.groupdict(""))
    if not found:
        raise ImportMapError(f"no file in {folder} matches {mapping.recordings.pattern}")
    return list(found.values())


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.as_posix())]


def _import_one(
    folder: Path, path: Path, groups: dict[str, str], name: str, mapping: Mapping, device: Device | None, out: Path
) -> FileReport:
    source = path.relative_to(folder).as_posix()
    try:
        run = _read_run(folder, path, groups, mapping, device)
    except _BadFileError as error:
        return FileReport(source, None, (Finding("error", "file", source, str(error), 0.0),), 0, 0, 0)
    except ImportMapError as error:
        return FileReport(source, None, (Finding("error", "columns", source, str(error), 0.0),), 0, 0, 0)
    findings = tuple(sorted(run.findings, key=lambda each: ("error", "warning", "note").index(each.severity)))
    first = min(int(stamps[0]) for stamps in (run.stamp, run.command_stamp) if len(stamps)) if len(run.stamp) else 0
    offset = max(0, -first)
    refused = any(each.severity == "error" for each in findings)
    bag = None if refused else out / name
    if bag is not None:
        notes = {
            "title": mapping.title,
            "source": "; ".join(mapping.source),
            "file": source,
            "device": mapping.device or "",
            "time_offset_ns": str(offset),
            "findings": "; ".join(map(str, findings)),
        }
        _write(bag, run, offset, mapping, device, notes)
    return FileReport(source, bag, findings, len(run.stamp), len(run.command_stamp), offset)


def _read_run(folder: Path, path: Path, groups: dict[str, str], mapping: Mapping, device: Device | None) -> _Run:
    table = mapping.recordings
    recording = _read_table(path, table)
    time = table.time.in_si(recording[table.time.column])
    usable = usable_stamps(time)
    values = {each.column: each.in_si(recording[each.column]) for each in (*table.joints, *table.scalars)}
    findings = list(check_samples(time, values))
    given: Table = table if mapping.commands is None else mapping.commands
    command_table = recording
    if mapping.commands is not None:
        file = mapping.commands.file.format(**groups)
        if not (folder / file).is_file():
            raise _BadFileError(f"its commands {file} are missing")
        command_table = _read_table(folder / file, given)
    command_time = given.time.in_si(command_table[given.time.column])
    in_order = usable_stamps(command_time)
    commands: dict[str, Array] = {
        str(each.quantity): each.in_si(command_table[each.column])[in_order] for each in given.commands
    }
    if mapping.commands is not None:
        findings += _command_findings(command_time, in_order, commands)
    joints = _columns([values[each.column] for each in table.joints], usable)
    if device is not None and usable.any():
        measured = _measured(time[usable], joints, mapping, device)
        findings += check_recording(measured, _commanded(command_time[in_order], commands), device)
    return _Run(
        stamp=_nanoseconds(time[usable]),
        joints=joints,
        scalars=_columns([values[each.column] for each in table.scalars], usable),
        command_stamp=_nanoseconds(command_time[in_order]) if commands else np.empty(0, np.int64),
        commands=commands,
        findings=tuple(findings),
    )


def _command_findings(time: Array, in_order: NDArray[np.bool_], commands: dict[str, Array]) -> list[Finding]:
    findings = []
    if not in_order.all():
        text = f"{int((~in_order).sum())} of {len(time)} command stamps are no times, repeated or run backwards"
        findings.append(Finding("error", "stamps", "commands", text, float((~in_order).mean()), 0.0))
    for name, values in commands.items():
        bad = int(np.count_nonzero(~np.isfinite(values)))
        if bad:
            text = f"{bad} of {len(values)} commands are not finite"
            findings.append(Finding("error", "infinite", name, text, bad / len(values), 0.0))
    if len(time) == 0:
        findings.append(Finding("error", "length", "commands", "there are no commands", 0.0))
    return findings


def _read_table(path: Path, table: Table) -> dict[str, Array]:
    """Column name -> (N,) numbers as written in the file; an empty cell is NaN. ImportMapError, _BadFileError."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = list(csv.reader(file, delimiter=table.delimiter))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise _BadFileError(f"{path.name} cannot be read: {error}") from None
    if not lines:
        raise _BadFileError(f"{path.name} is empty")
    header = [name.strip() for name in lines[0]]
    table.check_header(header, path.name)
    used = [header.index(each.column) for each in table.mapped]
    columns = np.empty((len(lines) - 1, len(used)))
    for k, cells in enumerate(lines[1:]):
        if len(cells) != len(header):
            raise _BadFileError(f"{path.name} line {k + 2} has {len(cells)} columns, its header {len(header)}")
        for i, column in enumerate(used):
            try:
                columns[k, i] = float(cells[column]) if cells[column].strip() else np.nan
            except ValueError:
                text = f"{path.name} line {k + 2}, column '{header[column]}': {cells[column]!r} is no number"
                raise _BadFileError(text) from None
    return {each.column: columns[:, i] for i, each in enumerate(table.mapped)}


def _columns(columns: list[Array], rows: NDArray[np.bool_]) -> Array:
    return np.stack(columns, axis=1)[rows] if columns else np.empty((int(rows.sum()), 0))


def _nanoseconds(time: Array) -> NDArray[np.int64]:
    """Seconds as whole nanoseconds, rounded; whole seconds apart, so that epoch times keep their precision."""
    whole = np.floor(time)
    return whole.astype(np.int64) * 1_000_000_000 + np.rint((time - whole) * 1e9).astype(np.int64)


def _joint_name(joint: str, device: Device | None) -> str:
    if device is None or not re.fullmatch(r"link|motor_\d+", joint):
        return joint
    if joint == "link":
        return device.link_joint
    number = int(joint.removeprefix("motor_"))
    if not 1 <= number <= device.n_motors:
        raise ImportMapError(f"{joint}: device '{device.name}' has {device.n_motors} motors")
    return device.motor_joints[number - 1]


def _measured(time: Array, joints: Array, mapping: Mapping, device: Device) -> Signals:
    channels: dict[str, Array] = {}
    theta = np.full((len(time), device.n_motors), np.nan)
    for column, values in zip(mapping.recordings.joints, joints.T):
        name = _joint_name(column.joint, device)
        if column.quantity == "position" and name == device.link_joint:
            channels["q"] = values
        elif column.quantity == "position" and name in device.motor_joints:
            theta[:, device.motor_joints.index(name)] = values
    if np.isfinite(theta).any():
        channels["theta"] = theta
    return Signals(time, channels, {"q": "rad", "theta": "rad"})


def _commanded(time: Array, commands: dict[str, Array]) -> Signals | None:
    if not commands:
        return None
    units = {"equilibrium": "rad", "preset": "rad", "damping": "-"}
    return Signals(time, commands, units, held=frozenset(commands))


def _write(bag: Path, run: _Run, offset: int, mapping: Mapping, device: Device | None, notes: dict[str, str]) -> None:
    """The bag grows in a folder whose name says so, and moves to its place when it is whole."""
    growing = bag.parent / ".importing" / bag.name
    shutil.rmtree(growing, ignore_errors=True)  # of an import that was killed
    writer = BagWriter(growing, notes)
    try:
        streams = _streams(run, offset, mapping, device)
        for stream in streams:
            writer.add_topic(stream.topic, stream.type_name)
        for topic, message, stamp in in_order(streams):
            writer.write(topic, message, stamp)
        writer.close()
        growing.rename(bag)
    except BaseException:
        writer.discard()
        raise
    finally:
        if not any(growing.parent.iterdir()):
            growing.parent.rmdir()


def _streams(run: _Run, offset: int, mapping: Mapping, device: Device | None) -> list[Stream]:
    """Commands first, then joint states, then scalars: the order in which equal stamps are written."""
    streams = []
    stamp = run.stamp + offset
    if run.commands and device is not None:
        at = run.command_stamp + offset
        streams.append(Stream(device.command_topic, VSA_COMMAND, at, _command_messages(run.commands, at, device)))
    if mapping.recordings.joints:
        streams.append(Stream("/joint_states", JOINT_STATE, stamp, _joint_messages(run, stamp, mapping, device)))
    store = typestore_of(FLOAT64)
    template = store.types[FLOAT64](0.0)
    for column, values in zip(mapping.recordings.scalars, run.scalars.T):
        messages = filled(store, FLOAT64, template, len(values), {"data": values})
        streams.append(Stream(column.topic, FLOAT64, stamp, messages))
    return streams


def _joint_messages(run: _Run, stamp: NDArray[np.int64], mapping: Mapping, device: Device | None) -> list[bytes]:
    names = [] if device is None else [device.link_joint, *device.motor_joints]
    columns = mapping.recordings.joints
    names = list(dict.fromkeys([*names, *(_joint_name(each.joint, device) for each in columns)]))
    values: dict[str, Array] = {}
    for column, measured in zip(columns, run.joints.T):
        whole = values.setdefault(column.quantity, np.full((len(stamp), len(names)), np.nan))
        whole[:, names.index(_joint_name(column.joint, device))] = measured
    return joint_messages("" if device is None else device.name, names, stamp, values)


def _command_messages(commands: dict[str, Array], stamp: NDArray[np.int64], device: Device) -> list[bytes]:
    """A reference that was not logged is NaN, one that the device cannot follow is 0."""
    unknown = {
        "preset": np.nan if device.n_motors > 1 else 0.0,
        "damping": np.nan if device.damper is not None else 0.0,
    }
    return command_messages(device.name, stamp, commands, unknown)
