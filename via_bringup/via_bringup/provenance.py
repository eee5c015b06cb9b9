"""Where results come from: the commit, the command and the versions that made them. No dates: a rerun is no change."""

from __future__ import annotations

import platform
import subprocess
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path


@dataclass(frozen=True)
class Provenance:
    """What is needed to make the same results again."""

    commit: str  # short hash, with a + where sources differ from it; 'unknown' outside a clone
    command: str
    python: str
    numpy: str
    numba: str

    def __str__(self) -> str:
        return f"commit {self.commit}, Python {self.python}, numpy {self.numpy}, numba {self.numba}: {self.command}"


def provenance(command: str) -> Provenance:
    """Of what `command` makes here and now."""
    return Provenance(commit(), command, platform.python_version(), version("numpy"), version("numba"))


def commit() -> str:
    """Short hash of the commit checked out, with a + where packages differ from it; 'unknown' outside a clone."""
    found = _git("rev-parse", "--short", "HEAD").strip()
    if not found:
        return "unknown"
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":(top,glob)via_*/**")
    return found + ("+" if changed.strip() else "")


def _git(*words: str) -> str:
    """What git answers where this file stands, nothing where it cannot."""
    try:
        asked = subprocess.run(
            ["git", "-C", str(Path(__file__).resolve().parent), *words], capture_output=True, text=True, check=False
        )
    except OSError:
        return ""
    return asked.stdout if asked.returncode == 0 else ""
