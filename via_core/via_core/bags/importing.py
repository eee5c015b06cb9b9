"""Import of recordings into bags, by a mapping file; recordings that cannot be valid are refused with a reason.

One bag per recording: /joint_states, /<device>/command and a std_msgs/Float64 topic for each further scalar, ordered by
stamp, commands before measurements of the same stamp. Values keep every bit. Stamps are rounded to ns and shifted by
one offset, stored in the bag's metadata, so that none is negative.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

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
from via_core.errors import BagError, ImportMapError, ViaError
from via_core.recordings.tables import TEXTS, is_bag, numbers, read_tables
from via_core.recordings.texts import read_csv
from via_core.signals import Array, Mask, Signals
from via_core.text_files import shown
from via_core.wire import JOINT_STATE, SECOND, UNITS, VSA_COMMAND

FLOAT64 = "std_msgs/msg/Float64"
SEVERITIES = ("error", "warning", "note")


@dataclass(frozen=True)
class FileReport:
    """Result of the import of one recording.

    source       path relative to the folder
    bag          the bag written, None when the recording was refused
    findings     results of the checks, errors first; errors are the reasons of a refusal
    samples      number of measurements in the recording
    commands     number of commands
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
        """Reasons of the refusal, one sentence each; empty when accepted."""
        return tuple(each.text for each in self.findings if each.severity == "error")


@dataclass(frozen=True)
class ImportReport:
    """Results of the import of all recordings in a folder."""

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


class _Source(NamedTuple):
    """One recording to import: name of its bag, file, and named groups of the mapping's pattern."""

    bag: str
    path: Path
    groups: dict[str, str]


@dataclass(frozen=True)
class _Run:
    """Contents of one recording: values in SI units by column, stamps [ns] without the offset."""

    stamp: NDArray[np.int64]
    joints: Array  # (N, columns)
    scalars: Array  # (N, columns)
    command_stamp: NDArray[np.int64]
    commands: dict[str, Array]
    findings: tuple[Finding, ...]


class _BadFileError(Exception):
    """A file is damaged as a table; the text is the reason of the refusal."""


def import_recordings(folder: str | Path, mapping: str | Path | Mapping, out: str | Path) -> ImportReport:
    """Write one bag in `out` for each valid recording in `folder`; report the others with reasons.

    mapping  a Mapping, the name of a shipped one, or a file
    Raises ImportMapError when no file matches or no file has the mapped columns, BagError when a bag exists already or
    `out` cannot be written. An interrupted import leaves the finished bags and no part of the current one.
    """
    folder, out = Path(folder), Path(out)
    mapping = mapping if isinstance(mapping, Mapping) else load_mapping(mapping)
    device = None if mapping.device is None else load_device(mapping.device)
    found = _recordings(folder, mapping)
    for source in found:
        if (out / source.bag).exists():
            raise BagError(f"{out / source.bag} exists already; remove it or choose another folder")
    importer = _Importer(folder, out, mapping, device)
    files = [importer.import_one(source) for source in found]
    if all(each.findings and each.findings[0].check == "columns" for each in files):
        raise ImportMapError(files[0].reasons[0])
    return ImportReport(folder, mapping.title, tuple(files))


def _recordings(folder: Path, mapping: Mapping) -> list[_Source]:
    """All files that match the mapping's pattern, in natural order (traj2 before traj10)."""
    if not folder.is_dir():
        raise ImportMapError(f"no folder {folder}")
    found: dict[str, _Source] = {}
    for path in sorted(folder.rglob("*"), key=_natural):  # folders too: bags
        groups = mapping.recordings.match(path.relative_to(folder).as_posix())
        if groups is None:
            continue
        name = mapping.recordings.bag.format(**groups)
        if Path(name).name != name or name in ("", ".."):  # a mapping must not write outside of `out`
            raise ImportMapError(f"recordings.bag makes '{name}' of {path.name}, which is not the name of one folder")
        if name in found:
            raise ImportMapError(f"{found[name].path.name} and {path.name} would both become the bag '{name}'")
        found[name] = _Source(name, path, groups)
    if not found:
        raise ImportMapError(f"no file in {folder} matches {mapping.recordings.pattern}")
    return list(found.values())


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.as_posix())]


@dataclass(frozen=True)
class _Importer:
    folder: Path
    out: Path
    mapping: Mapping
    device: Device | None

    def import_one(self, source: _Source) -> FileReport:
        file = source.path.relative_to(self.folder).as_posix()
        try:
            run = self._read(source)
        except (_BadFileError, ImportMapError) as error:
            check = "file" if isinstance(error, _BadFileError) else "columns"
            return FileReport(file, None, (Finding("error", check, file, str(error), 0.0),), 0, 0, 0)
        findings = tuple(sorted(run.findings, key=lambda each: SEVERITIES.index(each.severity)))
        first = min(int(stamps[0]) for stamps in (run.stamp, run.command_stamp) if len(stamps)) if len(run.stamp) else 0
        offset = max(0, -first)
        refused = any(each.severity == "error" for each in findings)
        bag = None if refused else self.out / source.bag
        if bag is not None:
            notes = {
                "title": self.mapping.title,
                "source": "; ".join(self.mapping.source),
                "file": file,
                "device": self.mapping.device or "",
                "time_offset_ns": str(offset),
                "findings": "; ".join(map(str, findings)),
            }
            _write(bag, self._streams(run, offset), notes)
        return FileReport(file, bag, findings, len(run.stamp), len(run.command_stamp), offset)

    def _read(self, source: _Source) -> _Run:
        table = self.mapping.recordings
        recording = _read_table(source.path, table)
        time = table.time.in_si(recording[table.time.column])
        usable = usable_stamps(time)
        values = {each.column: each.in_si(recording[each.column]) for each in (*table.joints, *table.scalars)}
        findings = list(check_samples(time, values))
        given: Table = table if self.mapping.commands is None else self.mapping.commands
        command_table = recording
        if self.mapping.commands is not None:
            file = self.mapping.commands.file.format(**source.groups)
            if not (self.folder / file).resolve().is_relative_to(self.folder.resolve()):
                raise ImportMapError(f"commands.file makes '{shown(file)}', which lies outside {self.folder}")
            if not (self.folder / file).is_file():
                raise _BadFileError(f"its commands {file} are missing")
            command_table = _read_table(self.folder / file, given)
        command_time = given.time.in_si(command_table[given.time.column])
        in_order = usable_stamps(command_time)
        commands: dict[str, Array] = {
            str(each.quantity): each.in_si(command_table[each.column])[in_order] for each in given.commands
        }
        if self.mapping.commands is not None:
            findings += _command_findings(command_time, in_order, commands)
        joints = _columns([each.at_stamps(values[each.column]) for each in table.joints], usable)
        if self.device is not None and usable.any():
            measured = self._measured(time[usable], joints, self.device)
            units = {**UNITS, "torque": "N m"}
            commanded = Signals(command_time[in_order], commands, units, frozenset(commands)) if commands else None
            findings += check_recording(measured, commanded, self.device)
        return _Run(
            stamp=_nanoseconds(time[usable]),
            joints=joints,
            scalars=_columns([values[each.column] for each in table.scalars], usable),
            command_stamp=_nanoseconds(command_time[in_order]) if commands else np.empty(0, np.int64),
            commands=commands,
            findings=tuple(findings),
        )

    def _measured(self, time: Array, joints: Array, device: Device) -> Signals:
        channels: dict[str, Array] = {}
        theta = np.full((len(time), device.n_motors), np.nan)
        for column, values in zip(self.mapping.recordings.joints, joints.T):
            name = self._joint_name(column.joint)
            if column.quantity == "position" and name == device.link_joint:
                channels["q"] = values
            elif column.quantity == "position" and name in device.motor_joints:
                theta[:, device.motor_joints.index(name)] = values
        if np.isfinite(theta).any():
            channels["theta"] = theta
        return Signals(time, channels, UNITS)

    def _streams(self, run: _Run, offset: int) -> list[Stream]:
        """Commands first, then joint states, then scalars: the order in which equal stamps are written."""
        streams = []
        stamp = run.stamp + offset
        if run.commands and self.device is not None:
            at = run.command_stamp + offset
            messages = _command_messages(run.commands, at, self.device)
            streams.append(Stream(self.device.command_topic, VSA_COMMAND, at, messages))
        if self.mapping.recordings.joints:
            streams.append(Stream("/joint_states", JOINT_STATE, stamp, self._joint_messages(run, stamp)))
        store = typestore_of(FLOAT64)
        template = store.types[FLOAT64](0.0)
        for column, values in zip(self.mapping.recordings.scalars, run.scalars.T):
            messages = filled(store, FLOAT64, template, len(values), {"data": values})
            streams.append(Stream(column.topic, FLOAT64, stamp, messages))
        return streams

    def _joint_messages(self, run: _Run, stamp: NDArray[np.int64]) -> list[bytes]:
        device, columns = self.device, self.mapping.recordings.joints
        of_device = [] if device is None else [device.link_joint, *device.motor_joints]
        names = list(dict.fromkeys([*of_device, *(self._joint_name(each.joint) for each in columns)]))
        values: dict[str, Array] = {}
        for column, measured in zip(columns, run.joints.T):
            array = values.setdefault(column.quantity, np.full((len(stamp), len(names)), np.nan))
            array[:, names.index(self._joint_name(column.joint))] = measured
        return joint_messages("" if device is None else device.name, names, stamp, values)

    def _joint_name(self, joint: str) -> str:
        """Name in a JointState of 'link', 'motor_<i>' or another joint of the mapping."""
        device = self.device
        if device is None or not re.fullmatch(r"link|motor_\d+", joint):
            return joint
        if joint == "link":
            return device.link_joint
        number = int(joint.removeprefix("motor_"))
        if not 1 <= number <= device.n_drives:
            last = f"motor_{device.n_drives}"
            raise ImportMapError(
                f"{joint}: the {device.arrangement} joint '{device.name}' has {device.n_drives} drive"
                f"{'s, write motor_1 to ' + last if device.n_drives > 1 else ', write motor_1 for its torque'}"
            )
        return device.drive_joints[number - 1]


def _command_findings(time: Array, in_order: Mask, commands: dict[str, Array]) -> list[Finding]:
    findings = []
    if not in_order.all():
        text = f"{int((~in_order).sum())} of {len(time)} command stamps are invalid, repeated or out of order"
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
    """Column name -> (N,) numbers of the file; an empty cell is NaN. Raises ImportMapError and _BadFileError."""
    try:
        if path.suffix.lower() in TEXTS:
            frames = {"": read_csv(path, table.delimiter)}
        else:
            frames = read_tables(path)
    except ViaError as error:
        raise _BadFileError(str(error)) from None
    named = [name for name, frame in frames.items() if {each.column for each in table.mapped} <= set(frame.columns)]
    frame = frames[named[0] if named else next(iter(frames))]
    if not (named and is_bag(path)):
        table.check_header([str(name) for name in frame.columns], path.name)
    try:
        return {each.column: numbers(frame, each.column) for each in table.mapped}
    except ViaError as error:
        raise _BadFileError(f"{path.name} {error}") from None


def _columns(columns: list[Array], rows: Mask) -> Array:
    return np.stack(columns, axis=1)[rows] if columns else np.empty((int(rows.sum()), 0))


def _nanoseconds(time: Array) -> NDArray[np.int64]:
    """`time` [s] rounded to [ns]; whole seconds are converted apart, so that epoch times keep their precision."""
    whole = np.floor(time)
    return whole.astype(np.int64) * SECOND + np.rint((time - whole) * 1e9).astype(np.int64)


def _write(bag: Path, streams: list[Stream], notes: dict[str, str]) -> None:
    """Write the bag in the folder `.importing` and move it to its place when it is complete."""
    growing = bag.parent / ".importing" / bag.name
    shutil.rmtree(growing, ignore_errors=True)  # of an import that was killed
    writer = BagWriter(growing, notes)
    try:
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


def _command_messages(commands: dict[str, Array], stamp: NDArray[np.int64], device: Device) -> list[bytes]:
    """References that were not logged are NaN; those that the device cannot follow are 0."""
    if "torque" in commands:
        return command_messages(device.name, stamp, {"motor": commands["torque"][:, None]})
    unknown = {
        "preset": np.nan if device.n_motors > 1 else 0.0,
        "damping": np.nan if device.damper is not None else 0.0,
    }
    return command_messages(device.name, stamp, commands, unknown)
