"""Mapping files: the joint and quantity of each column of a recording.

Every column is either mapped or listed under `ignore` with a reason. Any other column, or a missing mapped one, is an
error, so that a renamed column cannot silently count as not measured. Of a bag, other topics and members are ignored.
"""

from __future__ import annotations

import re
from pathlib import Path
from string import Formatter
from typing import Annotated, Literal

import numpy as np
import regex
from pydantic import Field, field_validator, model_validator

from via_core.device_parts import UnitColumn
from via_core.errors import ImportMapError, ParameterError
from via_core.limits import LIMITS
from via_core.recordings.units import is_unit, kind
from via_core.records import Record, Text, is_path, read_record, shipped_names
from via_core.signals import Array
from via_core.text_files import shown


class _Column(UnitColumn):
    """One column, whose unit must be stated."""

    unit: str

    @field_validator("unit")
    @classmethod
    def _is_unit(cls, unit: str) -> str:
        if not is_unit(unit):
            raise ValueError(f"'{unit}' is no unit; write e.g. deg, N m, mA, counts, or - for none")
        return unit

    @model_validator(mode="after")
    def _has_factor(self) -> _Column:
        try:
            _ = self.factor
        except ParameterError as error:
            raise ValueError(f"column '{self.column}': {error}") from None
        return self


class TimeColumn(_Column):
    """Time since the common origin of recording and commands."""

    @field_validator("unit")
    @classmethod
    def _is_time(cls, unit: str) -> str:
        if kind(unit) != "time":
            raise ValueError(f"must be a unit of time such as s, ms, us, ns, got '{unit}'")
        return unit


class JointColumn(_Column):
    """A quantity of one joint in sensor_msgs/JointState.

    joint     'link' or 'motor_<i>' of the mapping's device, 'motor_1' for the drive of a rigid one, or a joint's name
    interval  of an effort: 'ends' where it acted until the stamp, as messages state it; 'begins' where it acts from the
              stamp on, as in the row of a controller that reads, computes and logs. The bag then has it one row later
    """

    joint: Text
    quantity: Literal["position", "velocity", "effort"]
    interval: Literal["ends", "begins"] = "ends"

    @model_validator(mode="after")
    def _interval_of_an_effort(self) -> JointColumn:
        if self.interval == "begins" and self.quantity != "effort":
            raise ValueError(f"column '{self.column}': interval belongs to an effort, got quantity {self.quantity}")
        return self

    def at_stamps(self, values: Array) -> Array:
        """Values (N,) as messages with the stamps of the rows state them."""
        if self.interval == "ends":
            return values
        return np.concatenate([[np.nan], values[:-1]])[: len(values)]


class CommandColumn(_Column):
    """A command, a member of via_interfaces/VsaCommand; `torque` is that of the drive of a rigid joint."""

    quantity: Literal["equilibrium", "preset", "damping", "torque"]


class ScalarColumn(_Column):
    """Any other quantity: a std_msgs/Float64 topic in SI units."""

    topic: Annotated[str, Field(pattern=r"^(/[A-Za-z_][A-Za-z0-9_]*)+$")]


class Table(Record):
    """The columns of one kind of file."""

    time: TimeColumn
    joints: tuple[JointColumn, ...] = ()
    commands: tuple[CommandColumn, ...] = ()
    scalars: tuple[ScalarColumn, ...] = ()
    ignore: dict[str, Text] = Field(default_factory=dict)
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","

    @property
    def mapped(self) -> tuple[_Column, ...]:
        return (self.time, *self.joints, *self.commands, *self.scalars)

    @model_validator(mode="after")
    def _each_once(self) -> Table:
        names = [each.column for each in self.mapped] + list(self.ignore)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"mapped twice: {', '.join(map(repr, twice))}")
        goals = [(each.joint, each.quantity) for each in self.joints] + [each.quantity for each in self.commands]
        if len(set(goals)) < len(goals):
            raise ValueError("two columns give the same quantity")
        return self

    def check_header(self, header: list[str], file: str) -> None:
        """Raise ImportMapError for unknown, missing or repeated columns; an ignored column may be missing."""
        wanted = {each.column for each in self.mapped}
        unknown = [shown(name)[:40] for name in header if name not in wanted | self.ignore.keys()]
        missing = sorted(wanted - set(header))
        twice = sorted({name for name in header if header.count(name) > 1})
        problems = [
            f"{what}: {', '.join(map(repr, names))}"
            for what, names in (("unknown columns", unknown), ("missing columns", missing), ("columns twice", twice))
            if names
        ]
        if unknown and not missing:
            problems.append(f"list them under ignore: {{{unknown[0]!r}: why}}, or map them")
        if missing:
            problems.append(
                f"the file has: {', '.join(map(repr, header[:20]))}; `via bag map {file}` writes a mapping for it"
            )
        if problems:
            raise ImportMapError(f"{file} does not fit its mapping: {'; '.join(problems)}")


class Recordings(Table):
    """The measurements: one bag per file whose relative path matches `pattern`.

    pattern  regular expression for the whole path; `bag` and `file` of the commands may use its named groups
    bag      name of the bag
    """

    pattern: Annotated[str, Field(min_length=1, max_length=1000)]
    bag: Text

    def match(self, file: str) -> dict[str, str] | None:
        """Groups of a relative path that matches. Raises ImportMapError when matching takes too long."""
        try:
            found = regex.fullmatch(self.pattern, file, timeout=LIMITS.matching)
        except TimeoutError:
            raise ImportMapError(f"recordings.pattern takes more than {LIMITS.matching:g} s for {file}") from None
        return None if found is None else found.groupdict("")


class CommandFile(Table):
    """A file of commands for each recording, zero-order hold."""

    file: Text


class Mapping(Record):
    """One mapping file."""

    title: Text
    source: Annotated[tuple[Text, ...], Field(min_length=1)]
    remark: str = ""
    device: str | None = None
    recordings: Recordings
    commands: CommandFile | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> Mapping:
        try:
            groups = regex.compile(self.recordings.pattern).groupindex
        except regex.error as error:
            raise ValueError(f"recordings.pattern is not a regular expression: {error}") from None
        templates = [self.recordings.bag] + ([self.commands.file] if self.commands else [])
        for template in templates:
            for _, name, form, conversion in Formatter().parse(template):
                if name is not None and (name not in groups or form or conversion):
                    text = f"{{{name}{f':{form}' if form else ''}}} of '{template}'"
                    raise ValueError(f"{text[:80]} is no plain name of a group of recordings.pattern")
        if self.device is None:
            roles = [each.joint for each in self.recordings.joints if re.fullmatch(r"link|motor_\d+", each.joint)]
            if roles:
                raise ValueError(f"joint '{roles[0]}' needs a device")
            if self.commands is not None or self.recordings.commands:
                raise ValueError("commands need a device")
        if self.commands is not None and self.commands.joints:
            raise ValueError("a file of commands cannot hold measurements of joints")
        return self


def mapping_names() -> tuple[str, ...]:
    """Names of the shipped mappings, sorted."""
    return shipped_names("mappings")


def load_mapping(name_or_path: str | Path) -> Mapping:
    """The shipped mapping of that name, or the mapping of a YAML file. Raises ImportMapError with file and key."""
    path, mapping = read_record(Mapping, name_or_path, "mappings", ImportMapError)
    if mapping.device is not None and is_path(mapping.device):
        return mapping.model_copy(update={"device": str(path.parent / mapping.device)})  # relative to the mapping
    return mapping
