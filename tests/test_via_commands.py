"""The tables of `via` commands: help lines and units, imports of the help pages, shell completion."""

import os
import subprocess
import sys

import pytest
from rich.text import Text
from typer.testing import CliRunner
from via_bringup.cli import COMMANDS, app
from via_validation.commands import COMMANDS as VALIDATION

EVERY = {**COMMANDS, **VALIDATION}
HEAVY = ("casadi", "numba", "scipy", "matplotlib", "rclpy", "mujoco", "dask")


@pytest.mark.parametrize("path", EVERY)
def test_the_help_line_of_a_command_is_the_first_paragraph_of_its_docstring(path):
    command = EVERY[path].load(path.split()[-1])
    assert command.help is not None
    assert " ".join(command.help.split("\n\n")[0].split()) == EVERY[path].help


def test_help_pages_show_the_units_in_square_brackets():
    """Square brackets are markup unless they are escaped: [s] would vanish."""

    def texts(command):
        yield command.help or ""
        yield from (getattr(each, "help", None) or "" for each in command.params)
        for each in getattr(command, "commands", {}).values():
            yield from texts(each)

    every = [text for path, entry in EVERY.items() for text in texts(entry.load(path.split()[-1])) if text]
    assert sum("[s]" in each for each in every) >= 4
    assert [each for each in every if Text.from_markup(each).plain != each.replace("\\[", "[")] == []


@pytest.mark.parametrize("words", [["--help"], ["gap", "--help"], ["bag", "--help"], ["--version"]])
def test_help_pages_of_groups_import_no_large_library(words):
    code = f"import sys; from via_bringup.cli import app; app({words}, standalone_mode=False); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert not set(HEAVY) & set(done.stdout.split())


def test_for_an_unknown_command_the_nearest_name_is_suggested():
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
