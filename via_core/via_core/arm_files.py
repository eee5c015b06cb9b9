"""Files of arms: a YAML file beside the URDF of its rigid bodies."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import pinocchio

from via_core.errors import DeviceError, one_line
from via_core.records import Record, Text, read_record
from via_core.text_files import read_text


class ArmFile(Record):
    """Contents of the YAML file of an arm."""

    remark: str = ""
    urdf: Text  # path relative to this file


File = TypeVar("File", bound=ArmFile)


def read_arm(kind: type[File], folder: str, name_or_path: str | Path) -> tuple[Path, File, pinocchio.Model]:
    """Path, contents and bodies of the shipped arm of that name, or of the arm of a YAML file. Raises DeviceError."""
    path, file = read_record(kind, name_or_path, folder, DeviceError)
    try:
        return path, file, pinocchio.buildModelFromXML(read_text(path.parent / file.urdf, DeviceError, file.urdf))
    except ValueError as error:
        raise DeviceError(f"{path.name}: {one_line(error)}") from None
