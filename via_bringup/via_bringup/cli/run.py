"""`via run PACKAGE EXECUTABLE`: does what `ros2 run` does, on machines without the ros2 command."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from via_core.errors import ViaError

from via_bringup.cli.console import answers
from via_bringup.enclaves import enclave_arguments


def run(
    context: typer.Context,
    package: Annotated[str, typer.Argument(help="Package, e.g. via_sim.")],
    executable: Annotated[str, typer.Argument(help="Executable of that package, e.g. simulator.")] = "",
) -> None:
    """Run an installed node; all further arguments are passed to it, e.g. --ros-args -p device:=maccepavd."""
    if package in ("--help", "-h"):
        answers.print("usage: via run PACKAGE EXECUTABLE --ros-args -p name:=value; e.g. via run via_sim simulator")
        raise typer.Exit
    execute_node(package, executable, context.args)


def execute_node(package: str, executable: str, arguments: list[str]) -> NoReturn:
    """Replace this process by the executable, which then receives the signals and returns the exit code."""
    if package.startswith("via_") and "--enclave" not in arguments:
        arguments = [*arguments, "--ros-args", *enclave_arguments(executable)]
    command = node_command(find_executable(package, executable), arguments)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")  # SUBNET opens the node to the network
    os.execv(command[0], command)


# Ctrl-C while a script imports its modules would print a traceback.
START = (
    "import os, runpy, signal, sys; "
    "signal.signal(signal.SIGINT, lambda *_: (os.write(2, b'interrupted while the node started\\n'), os._exit(130))); "
    "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
)


def node_command(path: Path, arguments: list[str]) -> list[str]:
    """Command line of an executable; a Python script runs so that Ctrl-C ends it in one line from the start."""
    with path.open("rb") as file:
        first = file.readline(256)
    if first.startswith(b"#!") and b"python" in first:
        return [*first[2:].decode(errors="surrogateescape").split(), "-c", START, str(path), *arguments]
    return [str(path), *arguments]


def ros_arguments(**parameters: Any) -> list[str]:
    """Command line arguments that set ROS parameters. Values are written as JSON, a subset of YAML."""
    words = ["--ros-args"]
    for name, value in parameters.items():
        # No ASCII escapes: the YAML parser of ROS does not join surrogate pairs.
        words += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
    return words


def find_executable(package: str, executable: str) -> Path:
    """The file `lib/<package>/<executable>` in the sourced workspaces, as `ros2 run` finds it.

    Raises ViaError, which lists the executables that exist.
    """
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    folders = [prefix / "lib" / package for prefix in prefixes]
    for folder in folders:
        path = folder / executable
        if path.is_file() and os.access(path, os.X_OK):
            return path
    existing = sorted(
        {path.name for folder in folders if folder.is_dir() for path in folder.iterdir() if path.is_file()}
    )
    if existing:
        raise ViaError(f"package '{package}' has no executable '{executable}'; it has: {', '.join(existing)}")
    raise ViaError(f"package '{package}' is not in the sourced workspace; source ros2_ws/env.sh after `make setup`")
