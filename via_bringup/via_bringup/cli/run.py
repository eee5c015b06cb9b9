"""`via run PACKAGE EXECUTABLE`: what `ros2 run` does, for machines that have no ros2 command."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from via_core.errors import ViaError


def run(
    context: typer.Context,
    package: Annotated[str, typer.Argument(help="Package, e.g. via_sim.")],
    executable: Annotated[str, typer.Argument(help="Executable of that package, e.g. simulator.")] = "",
) -> None:
    """Run an installed node; all further arguments go to the node, e.g. --ros-args -p device:=maccepavd."""
    if package in ("--help", "-h"):
        raise ViaError("usage: via run PACKAGE EXECUTABLE --ros-args -p name:=value; e.g. via run via_sim simulator")
    become(package, executable, context.args)


def become(package: str, executable: str, arguments: list[str]) -> NoReturn:
    """Replace this process by an executable, so that signals and exit code are its own."""
    path = find_executable(package, executable)
    os.execv(path, [str(path), *arguments])


def parameters(**values: Any) -> list[str]:
    """Command line arguments that set ROS parameters, as JSON: the part of YAML that ROS reads the same way."""
    words = ["--ros-args"]  # of \u escapes ROS reads no pairs: texts go as they are
    for name, value in values.items():
        words += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
    return words


def find_executable(package: str, executable: str) -> Path:
    """The file `lib/<package>/<executable>` under the sourced prefixes, where `ros2 run` looks.

    Raises ViaError naming what the package has instead.
    """
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    folders = [prefix / "lib" / package for prefix in prefixes]
    for folder in folders:
        path = folder / executable
        if path.is_file() and os.access(path, os.X_OK):
            return path
    there = sorted({path.name for folder in folders if folder.is_dir() for path in folder.iterdir() if path.is_file()})
    if there:
        raise ViaError(f"package '{package}' has no executable '{executable}'; it has: {', '.join(there)}")
    raise ViaError(f"package '{package}' is not in the sourced workspace; source ros2_ws/env.sh after `make setup`")
