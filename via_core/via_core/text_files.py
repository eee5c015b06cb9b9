"""Text files in UTF-8, with errors that name the file."""

from __future__ import annotations

from pathlib import Path

from via_core.errors import ViaError


def read_text(path: str | Path, error: type[ViaError] = ViaError, shown: str = "") -> str:
    """Content of a text file. Raises `error`, which names the file as `shown`, or by its path."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError) as problem:  # ValueError: not UTF-8, or a path with a null byte
        text = "not UTF-8 text" if isinstance(problem, UnicodeDecodeError) else str(problem)
        name = (shown or str(path)).replace("\0", "\\0")
        raise error(f"{name}: cannot be read: {getattr(problem, 'strerror', None) or text}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file. Raises ViaError."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None
