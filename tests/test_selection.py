"""`make test` leaves out exactly the tests marked slow; `make test-all` and continuous integration leave out none."""

from __future__ import annotations

import ast
import os
import subprocess
from pathlib import Path

import pytest

SAMPLE = """
import pytest

def test_quick():
    pass

@pytest.mark.slow
def test_slow():
    pass
"""
ROOT = Path(__file__).resolve().parents[1]
SLOW = [line for line in (ROOT / "tests" / "slow.txt").read_text("utf-8").splitlines() if not line.startswith("#")]
PACKAGES = sorted(path.parent for path in ROOT.glob("via_*/test"))
# These run once for every node and every command.
EVERY = (
    "tests/test_executables.py::test_starts_publishes_and_ends_cleanly",
    "tests/test_via_commands.py::test_the_help_line_of_a_command_is_the_first_paragraph_of_its_docstring",
    "tests/test_interfaces.py",  # via_interfaces has no tests of its own
)
RECORDER = """#!/bin/sh
echo "$@" >> "$CALLS"
"""


@pytest.mark.parametrize(("target", "passed"), [("test", ["test_quick"]), ("test-all", ["test_quick", "test_slow"])])
def test_the_target_runs(target: str, passed: list[str], root: Path, tmp_path: Path) -> None:
    (tmp_path / "test_sample.py").write_text(SAMPLE)
    chosen = f"--config-file=pyproject.toml -p no:cacheprovider -rp {tmp_path}"
    shown = subprocess.run(
        ["make", "--no-print-directory", "-n", target, "WORKERS=0", f"TESTS={chosen}"],
        cwd=root,
        env={key: value for key, value in os.environ.items() if not key.startswith("MAKE")},
        capture_output=True,
        text=True,
        check=True,
    )
    command = shown.stdout[shown.stdout.index("python -m pytest") :]  # without the set-up
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    done = subprocess.run(["bash", "-c", command], cwd=root, env=own, capture_output=True, text=True)
    found = [line.rpartition("::")[2] for line in done.stdout.splitlines() if line.startswith("PASSED")]
    assert (found, done.returncode) == (passed, 0), done.stdout + done.stderr


def functions_of(file: Path) -> set[str]:
    """Names of the test functions of a file."""
    return {
        node.name
        for node in ast.parse(file.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }


def is_slow(file: Path, test: str) -> bool:
    path = str(file.relative_to(ROOT))
    return path in SLOW or f"{path}::{test}" in SLOW


@pytest.mark.parametrize("entry", SLOW)
def test_an_entry_of_the_list_names_a_test_or_a_module(entry: str) -> None:
    path, _, test = entry.partition("::")
    assert (ROOT / path).is_file() and (not test or test in functions_of(ROOT / path))


def test_the_list_is_sorted_and_names_nothing_twice() -> None:
    assert sorted(set(SLOW)) == SLOW
    assert not [entry for entry in SLOW if "::" in entry and entry.partition("::")[0] in SLOW]


def test_listed_tests_are_marked(request: pytest.FixtureRequest) -> None:
    """Of those that this session has collected; `make test` has deselected them by their mark."""
    for item in request.session.items:
        path, _, test = item.nodeid.partition("[")[0].partition("::")
        if is_slow(ROOT / path, test):
            assert item.get_closest_marker("slow")


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_every_package_keeps_half_of_its_test_modules(package: Path) -> None:
    files = sorted((package / "test").glob("test_*.py"))
    quick = [file for file in files if any(not is_slow(file, test) for test in functions_of(file))]
    assert len(quick) >= 0.5 * len(files) > 0


@pytest.mark.parametrize("entry", EVERY)
def test_what_touches_every_node_and_every_command_is_quick(entry: str) -> None:
    path, _, test = entry.partition("::")
    assert (ROOT / path).is_file() and not is_slow(ROOT / path, test)
    assert not test or test in functions_of(ROOT / path)


def test_no_setting_leaves_tests_out(pytestconfig: pytest.Config) -> None:
    options = pytestconfig.getini("addopts")
    assert not [each for each in options if each.startswith(("-m", "-k", "--deselect", "--ignore"))]


def test_continuous_integration_runs_the_checks_and_every_test(root: Path, tmp_path: Path) -> None:
    for name in ("make", "chromium"):
        (tmp_path / name).write_text(RECORDER)
        (tmp_path / name).chmod(0o755)
    calls = tmp_path / "calls"
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    subprocess.run([root / ".ci" / "run"], env=os.environ | {"PATH": path, "CALLS": str(calls)}, check=True)
    assert calls.read_text().splitlines() == ["--jobs=2 check setup", "view", "test-all"]
