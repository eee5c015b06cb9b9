"""The table of `via` commands: every entry loads, help lines are the commands' own, help pages load no libraries."""

import os
import subprocess
import sys

import pytest
from typer.testing import CliRunner
from via_bringup.cli import COMMANDS, app
from via_validation.commands import COMMANDS as VALIDATION

EVERY = {**COMMANDS, **VALIDATION}
HEAVY = ("numba", "scipy", "matplotlib", "rclpy", "mujoco", "dask")


@pytest.mark.parametrize("path", EVERY)
def test_the_help_line_of_a_command_is_the_first_of_its_own_help(path):
    command = EVERY[path].load(path.split()[-1])
    assert command.help is not None
    assert " ".join(command.help.split("\n\n")[0].split()) == EVERY[path].help


@pytest.mark.parametrize("words", [["--help"], ["gap", "--help"], ["bag", "--help"], ["--version"]])
def test_help_pages_of_groups_load_no_large_library(words):
    code = f"import sys; from via_bringup.cli import app; app({words}, standalone_mode=False); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert not set(HEAVY) & set(done.stdout.split())


def test_a_command_that_is_not_there_is_refused_with_the_nearest_name():
    done = CliRunner().invoke(app, ["gap", "diagnos"])
    assert done.exit_code == 2 and "Did you mean 'diagnose'?" in done.output


@pytest.mark.parametrize(
    ("line", "expected"), [("via ga", "gap"), ("via gap di", "diagnose"), ("via gap blind ca", "calibrate")]
)
def test_the_shell_completes_commands_of_every_level(line, expected):
    words = {"_VIA_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    code = "from via_bringup.cli import app; app(prog_name='via')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, env={**os.environ, **words}
    )
    assert done.stdout.split() == [expected]
