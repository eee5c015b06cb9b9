"""Text files in UTF-8 and untrusted texts, with errors that name the file. Limits: `via_core.limits`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import yaml

from via_core.errors import ViaError
from via_core.limits import LIMITS, require_regular

# Control characters become their pictures or, like marks that reverse the direction of text, the replacement character.
_PICTURES = {
    **{code: 0x2400 + code for code in range(32) if chr(code) not in "\n\t"},
    0x7F: 0x2421,
    **dict.fromkeys([*range(0x80, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A)], 0xFFFD),
}


def shown(text: str) -> str:
    """The text without characters that control a terminal; its length is the same."""
    return text.translate(_PICTURES)


def read_text(path: str | Path, error: type[ViaError] = ViaError, name: str = "") -> str:
    """Content of a text file. Raises `error`, which names the file as `name`, or by its path."""
    try:
        require_regular(path)
        with Path(path).open(encoding="utf-8") as file:
            text = file.read(LIMITS.text + 1)
        if len(text) > LIMITS.text:
            raise ValueError(f"more than {LIMITS.text} characters")
        return text
    except (OSError, ValueError) as problem:  # ValueError: not UTF-8, or a path with a null byte
        reason = "not UTF-8 text" if isinstance(problem, UnicodeDecodeError) else str(problem)
        where = (name or str(path)).replace("\0", "\\0")
        raise error(f"{where}: cannot be read: {getattr(problem, 'strerror', None) or reason}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file. Raises ViaError."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None


def replace_text(path: Path, text: str, error: type[ViaError] = ViaError) -> None:
    """Write a text file completely or not at all, even if this process is killed. Raises `error`."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    except OSError as problem:
        raise error(f"{path}: cannot be written: {problem.strerror}") from None
    finally:
        draft.unlink(missing_ok=True)


def read_yaml(text: str, name: str, error: type[ViaError] = ViaError, loader: Any = yaml.SafeLoader) -> Any:
    """Content of a YAML text. Raises `error` in one line, with `name` and line, for bad YAML and beyond the limits.

    loader  a SafeLoader
    """
    try:
        _require_small(text, loader)
        return yaml.load(text, loader)
    except Exception as problem:  # constructors raise any exception for odd values of odd tags
        mark = getattr(problem, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark is not None else ""
        what = getattr(problem, "problem", None) or getattr(problem, "reason", None) or str(problem)
        what = ("" if line else "not YAML: ") + (" ".join(str(what).split())[:200] or type(problem).__name__)
        raise error(f"{name}:{line} {shown(what)}") from None


def _require_small(text: str, loader: Any) -> None:
    """Raise YAMLError beyond the limits of depth and of values, those that aliases repeat included."""
    sizes: dict[str, int] = {}  # of anchored values
    open_: list[tuple[str | None, int]] = []  # anchor and size of each open collection
    total = 0
    if len(text) > LIMITS.yaml:
        raise yaml.YAMLError(f"more than {LIMITS.yaml} characters")
    for event in yaml.parse(text, loader):  # one event at a time, not recursive
        anchor = getattr(event, "anchor", None)
        size = 0
        if isinstance(event, yaml.CollectionStartEvent):
            open_.append((anchor, total))
            total += 1
            if len(open_) > LIMITS.depth:
                raise yaml.YAMLError(f"nested more than {LIMITS.depth} deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            name, before = open_.pop()
            if name is not None:
                sizes[name] = total - before
        elif isinstance(event, yaml.AliasEvent):
            size = sizes.get(str(event.anchor), LIMITS.values)  # of a value that contains itself: without end
        elif isinstance(event, yaml.ScalarEvent):
            size = 1
            if anchor is not None:
                sizes[anchor] = 1
        total += size
        if total > LIMITS.values:
            raise yaml.YAMLError(f"more than {LIMITS.values} values")
