"""Files of arms: a YAML file beside the URDF of its rigid bodies."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TypeVar

import pinocchio
from pydantic import ValidationError

from via_core.device_parts import Record, Text
from via_core.errors import DeviceError
from via_core.problems import problems
from via_core.text_files import read_text, read_yaml


class ArmFile(Record):
    """Contents of the YAML file of an arm."""

    remark: str = ""
    urdf: Text  # path relative to this file


File = TypeVar("File", bound=ArmFile)


def arm_names(folder: str) -> tuple[str, ...]:
    """Names of the arms in a folder of this package, sorted."""
    return tuple(sorted(file.stem for file in _shipped(folder).glob("*.yaml")))


def read_arm(kind: type[File], folder: str, name_or_path: str | Path) -> tuple[Path, File, pinocchio.Model]:
    """Path, contents and bodies of the shipped arm of that name, or of the arm of a YAML file. Raises DeviceError."""
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = _shipped(folder) / f"{name_or_path}.yaml"
    if not path.is_file():
        raise DeviceError(f"no arm '{name_or_path}'; there are: {', '.join(arm_names(folder))}")
    try:
        file = kind.model_validate(read_yaml(read_text(path, DeviceError, path.name), path.name, DeviceError))
        return path, file, pinocchio.buildModelFromXML(read_text(path.parent / file.urdf, DeviceError, file.urdf))
    except ValidationError as error:
        raise DeviceError(f"{path.name}: {problems(error)}") from None
    except ValueError as error:
        raise DeviceError(f"{path.name}: {' '.join(str(error).split())[:120]}") from None


def _shipped(folder: str) -> Path:
    return Path(str(resources.files("via_core").joinpath(folder)))
