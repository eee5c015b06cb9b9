"""Checks of output paths before the work begins, so that no result is computed that cannot be written."""

from __future__ import annotations

import os
from pathlib import Path

from via_core.errors import ViaError


def check_files(*paths: Path | None) -> None:
    """Raise ViaError unless each of these files can be written; None is none."""
    for path in filter(None, paths):
        if path.is_dir():
            raise ViaError(f"cannot write {path}: it is a folder")
        if not path.parent.is_dir():
            raise ViaError(f"cannot write {path}: there is no folder {path.parent}")
        _check_access(path if path.exists() else path.parent, path)


def check_folder(folder: Path) -> None:
    """Raise ViaError unless files can be written into this folder, which may have to be made."""
    existing = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not existing.is_dir():
        raise ViaError(f"cannot write into {folder}: {existing} is a file")
    _check_access(existing, folder)


def _check_access(existing: Path, path: Path) -> None:
    if not os.access(existing, os.W_OK):
        raise ViaError(f"cannot write {path}: no permission for {existing}")
