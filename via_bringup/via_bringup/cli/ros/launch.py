"""`via launch FILE`: starts the nodes of a launch file, shows what they print, and ends them together.

Where ROS's own `ros2 launch` is installed, that one runs. Otherwise `launch_files` reads the file.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Annotated

import typer
from via_core.errors import ViaError

from via_bringup.cli.console import answers, errors

GRACE = 5.0  # [s] for a node to end after SIGINT, and again after SIGTERM


def launch(
    context: typer.Context,
    file: Annotated[str, typer.Argument(help="Launch file, or name of one that VIA ships, e.g. joint.")],
) -> None:
    """Start the nodes of a launch file and end them together; --show-args lists its arguments.

    Arguments follow as NAME:=VALUE, as for `ros2 launch`: via launch joint device:=cubic_demo
    """
    if file in ("--help", "-h"):
        names = ", ".join(sorted(_shipped()))
        answers.print(f"usage: via launch FILE [NAME:=VALUE ...] [--show-args]; FILE is a path or one of: {names}")
        raise typer.Exit
    words = list(context.args)
    if file == "via_bringup" and words:  # ros2 launch PACKAGE FILE
        file = words.pop(0)
    path = _shipped().get(file.removesuffix(".launch.py"), Path(file))
    if not path.is_file():
        raise ViaError(f"no launch file {file}; shipped are: {', '.join(sorted(_shipped()))}")
    if native := shutil.which("ros2"):
        os.execv(native, [native, "launch", str(path), *words])
    show = "--show-args" in words or "-s" in words
    _run(path, [each for each in words if each not in ("--show-args", "-s")], show)


def _shipped() -> dict[str, Path]:
    from ament_index_python.packages import get_package_share_directory

    folder = Path(get_package_share_directory("via_bringup")) / "launch"
    return {each.name.removesuffix(".launch.py"): each for each in folder.glob("*.launch.py")}


def _run(path: Path, words: list[str], show: bool) -> None:
    from via_bringup.cli.ros.launch_files import (
        arguments,
        configured,
        described,
        environment,
        expanded,
        messages,
        nodes,
        text,
    )

    entities = described(path)
    if show:
        for each in arguments(entities):
            default = "required" if each.default_value is None else f"default: {text(each.default_value, _Names())!r}"
            answers.print(f"{each.name}: {each.description} ({default})")
        return
    wrong = [each for each in words if ":=" not in each]
    if wrong:
        raise ViaError(f"launch arguments have the form NAME:=VALUE, got {wrong[0]!r}")
    context = configured(entities, dict(each.split(":=", 1) for each in words))
    entities = tuple(expanded(entities, context))
    for message in messages(entities, context):
        errors.print(message, soft_wrap=True)
    commands = [(each.name or each.executable, each.command(context)) for each in nodes(entities, context)]
    raise typer.Exit(_together(commands, environment(entities, context)))


class _Names(dict[str, str]):
    """Context that shows an argument by its name."""

    def __contains__(self, name: object) -> bool:
        return True

    def __missing__(self, name: str) -> str:
        return name.upper()


def _together(commands: list[tuple[str, list[str]]], variables: dict[str, str]) -> int:
    """Run the commands with the environment `variables` until all have ended; on a signal end them.

    Returns 1 if one failed by itself.
    """
    signal.set_wakeup_fd(-1)  # here nodes may take longer to end
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    environment = {**os.environ, **variables, "PYTHONUNBUFFERED": "1"}
    running: list[tuple[str, subprocess.Popen[str]]] = []
    failed = False
    try:
        for name, command in commands:
            process = subprocess.Popen(
                command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True, errors="backslashreplace", start_new_session=True,
            )  # fmt: skip
            running.append((name, process))
            threading.Thread(target=_show, args=(name, process), daemon=True).start()
        while running:
            time.sleep(0.05)
            for each in [pair for pair in running if pair[1].poll() is not None]:
                running.remove(each)
                code = each[1].returncode
                failed = failed or code != 0
                errors.print(f"[{each[0]}] ended" + (f" with exit code {code}" if code else ""))
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        raise
    finally:
        _end([process for _, process in running])
    return int(failed)


def _show(name: str, process: subprocess.Popen[str]) -> None:
    """Print what a node prints, with its name."""
    assert process.stdout is not None
    for line in process.stdout:
        sys.stdout.write(f"[{name}] {line}")
        sys.stdout.flush()


def _end(processes: list[subprocess.Popen[str]]) -> None:
    """End processes with SIGINT; those that do not end with SIGTERM, then with SIGKILL."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for each in processes:
            if each.poll() is None:
                each.send_signal(number)
        until = time.monotonic() + GRACE
        while time.monotonic() < until and any(each.poll() is None for each in processes):
            time.sleep(0.02)
