"""`make test` leaves out exactly the tests marked slow; `make test-all` and continuous integration leave out none."""

from __future__ import annotations

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
    assert calls.read_text().splitlines() == ["check", "test-all"]
