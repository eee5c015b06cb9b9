"""Commit of the sources, for results that state what produced them."""

from __future__ import annotations

import subprocess
from pathlib import Path


def commit() -> str:
    """Short hash of the checked-out commit, with a + if a package was changed since; 'unknown' outside a clone."""
    found = git("rev-parse", "--short", "HEAD").strip()
    if not found:
        return "unknown"
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ":(top,glob)via_*/**")
    return found + ("+" if changed.strip() else "")


def git(*words: str) -> str:
    """Output of git in the folder of this file; empty if git fails."""
    try:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).resolve().parent), *words], capture_output=True, text=True, check=False
        )
    except OSError:
        return ""
    return done.stdout if done.returncode == 0 else ""
