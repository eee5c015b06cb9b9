"""Output files: paths are checked before the work begins, so that no result is computed that cannot be written."""

from __future__ import annotations

import os
from math import isfinite
from pathlib import Path
from typing import Any

from via_core.errors import ViaError
from via_core.text_files import write_text

from via_bringup.cli.console import answers


def check_files(*paths: Path | None) -> None:
    """Raise ViaError unless each of these files can be written; None is none."""
    for path in filter(None, paths):
        if path.is_dir():
            raise ViaError(f"cannot write {path}: it is a folder")
        if not path.parent.is_dir():
            raise ViaError(f"cannot write {path}: there is no folder {path.parent}")
        _check_access(path if path.exists() else path.parent, path)


def check_new(path: Path) -> None:
    """Raise ViaError if this file exists."""
    if path.exists():
        raise ViaError(f"{path} exists already; remove it, or choose another file with --out")


def check_folder(folder: Path) -> None:
    """Raise ViaError unless files can be written into this folder, which may have to be made."""
    existing = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not existing.is_dir():
        raise ViaError(f"cannot write into {folder}: {existing} is a file")
    _check_access(existing, folder)


def save(path: Path | None, text: str) -> None:
    """Write a text file and print its name; None: no file is wanted."""
    if path is not None:
        write_text(path, text)
        answers.print(f"wrote {path}", soft_wrap=True)


def save_or_print(path: Path | None, text: str) -> None:
    """Write a text file and print its name, or print the text."""
    if path is None:
        answers.print(text, soft_wrap=True, end="")
    save(path, text)


def finite(value: Any) -> Any:
    """Plain data for JSON, in which what is not finite is null."""
    if isinstance(value, dict):
        return {name: finite(each) for name, each in value.items()}
    return None if isinstance(value, float) and not isfinite(value) else value


def _check_access(existing: Path, path: Path) -> None:
    if not os.access(existing, os.W_OK):
        raise ViaError(f"cannot write {path}: no permission for {existing}")
