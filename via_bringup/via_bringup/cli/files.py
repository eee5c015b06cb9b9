"""Text files of the commands, with errors that name the file."""

from __future__ import annotations

from pathlib import Path

from via_core.errors import ViaError


def read_text(path: Path) -> str:
    """Content of a UTF-8 text file. Raises ViaError."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ViaError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or 'not UTF-8 text'}") from None


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file. Raises ViaError."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None
