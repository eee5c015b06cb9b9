"""Ctrl-C ends nodes and commands with one line, also while they import or compile, and with their worker processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

INTERRUPTED = 130
UNTIL = 30.0  # [s] that a loaded machine may take to end a process; far less than what it would have run


def interrupted(command, begun, **options) -> tuple[int, str, float]:
    """Start a command, send SIGINT once begun(process); its exit code, what it printed, and how long it took to end."""
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )  # fmt: skip
    deadline = time.monotonic() + 300.0
    while not begun(process):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    printed, _ = process.communicate(timeout=UNTIL)
    return process.returncode, printed, time.monotonic() - sent


def exists(path):
    return lambda _: path.exists()


COMMAND = """
import sys, time, pathlib
from via_bringup import cli
from via_bringup.cli.deferred import Entry
sys.modules["busy"] = sys.modules["__main__"]
def work() -> None:
    pathlib.Path({mark!r}).touch()
    {work}
cli.COMMANDS["work"] = Entry("busy:work")
sys.argv = ["via", "work"]
cli.main()
"""


@pytest.mark.parametrize(
    "work",
    [
        "time.sleep(600)",
        # As in a compilation: Python code runs no handler for minutes, but other threads run.
        "import ctypes; [ctypes.CDLL(None).sleep(600) for _ in range(9)]",
        "import multiprocessing; multiprocessing.Process(target=time.sleep, args=(600,)).start(); time.sleep(600)",
    ],
    ids=["python", "library", "worker"],
)
def test_a_command_ends_with_one_line_and_its_workers(tmp_path, work):
    mark = tmp_path / "mark"
    workers: list[psutil.Process] = []

    def begun(process):
        workers[:] = psutil.Process(process.pid).children()
        return mark.exists() and (bool(workers) or "Process(" not in work)

    code, printed, _ = interrupted([sys.executable, "-c", COMMAND.format(mark=str(mark), work=work)], begun)
    assert (code, printed) == (INTERRUPTED, "interrupted\n")
    _, alive = psutil.wait_procs(workers, timeout=UNTIL)
    assert not alive


NODE = """
import pathlib, time
from rclpy.node import Node
from via_ros.spin import run
class Compiling(Node):
    def __init__(self):
        super().__init__("compiling")
        pathlib.Path({mark!r}).touch()
        import ctypes
        [ctypes.CDLL(None).sleep(600) for _ in range(9)]
raise SystemExit(run(Compiling))
"""


def test_a_node_that_compiles_ends_with_one_line(domain, tmp_path):
    mark = tmp_path / "mark"
    code, printed, _ = interrupted([sys.executable, "-c", NODE.format(mark=str(mark))], exists(mark))
    assert (code, printed) == (0, "interrupted while the node started\n")


def test_a_node_that_imports_ends_with_one_line(tmp_path, monkeypatch):
    """An executable that is still importing when the signal arrives."""
    script = tmp_path / "lib" / "slow" / "node"
    script.parent.mkdir(parents=True)
    script.write_text(f"#!{sys.executable}\nimport pathlib, time\npathlib.Path('mark').touch()\ntime.sleep(600)\n")
    script.chmod(0o755)
    environment = {**os.environ, "AMENT_PREFIX_PATH": f"{tmp_path}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}"}
    code, printed, _ = interrupted(
        ["via", "run", "slow", "node"], exists(tmp_path / "mark"), env=environment, cwd=tmp_path
    )
    assert (code, printed) == (INTERRUPTED, "interrupted while the node started\n")
