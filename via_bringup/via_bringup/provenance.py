"""Provenance of results: commit, command and versions. No dates, so that a repeated run changes nothing."""

from __future__ import annotations

import platform
import subprocess
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path


@dataclass(frozen=True)
class Provenance:
    """What is needed to reproduce results."""

    commit: str  # as in `commit`
    command: str
    python: str
    numpy: str
    numba: str

    def __str__(self) -> str:
        return f"commit {self.commit}, Python {self.python}, numpy {self.numpy}, numba {self.numba}: {self.command}"


def provenance(command: str) -> Provenance:
    """Provenance of the results of `command`, run now with the current sources."""
    return Provenance(commit(), command, platform.python_version(), version("numpy"), version("numba"))


def commit() -> str:
    """Short hash of the checked-out commit, with a + if a package was changed since; 'unknown' outside a clone."""
    found = _git("rev-parse", "--short", "HEAD").strip()
    if not found:
        return "unknown"
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":(top,glob)via_*/**")
    return found + ("+" if changed.strip() else "")


def _git(*words: str) -> str:
    """Output of git in the folder of this file; empty if git fails."""
    try:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).resolve().parent), *words], capture_output=True, text=True, check=False
        )
    except OSError:
        return ""
    return done.stdout if done.returncode == 0 else ""
