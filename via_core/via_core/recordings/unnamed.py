"""Recordings without names of their columns: a matrix, or a table of text whose first row is a sample."""

from __future__ import annotations

import re
from pathlib import Path

from via_core.errors import SignalError
from via_core.recordings.guess import WORDS, split_name
from via_core.recordings.tables import TEXTS, Tables
from via_core.recordings.texts import delimiter_of

_NUMBERED = re.compile(r"(.*)\[\d+\]")  # columns of a matrix


def require_names(file: str | Path, tables: Tables) -> None:
    """Raise SignalError with the remedy where a recording states no names of its columns. Repeated ones end with #k."""
    names = [str(name) for frame in tables.values() for name in frame.columns]
    if not _of_one_matrix(names) and sum(_is_number(name.partition("#")[0]) for name in names) <= len(names) / 2:
        return
    path = Path(file)
    if path.suffix.lower() in TEXTS:
        header = delimiter_of(path).join(f"NAME{k}" for k in range(1, len(names) + 1))
        how = f"write a line of names above its numbers, e.g. sed -i '1i {header}' {path}"
    elif path.suffix.lower() == ".mat":
        how = "save them as variables, e.g. save('run.mat', 'time', 'position', 'torque')"
    else:
        how = "save them as named arrays, e.g. numpy.savez('run.npz', time=..., position=..., torque=...)"
    raise SignalError(f"{path}: its {len(names)} columns have no names such as time, position, torque; {how}")


def _of_one_matrix(names: list[str]) -> bool:
    """Whether all columns are those of one matrix whose name is no signal, as `data[0]`, `data[1]`."""
    found = [_NUMBERED.fullmatch(name) for name in names]
    matrices = {match[1] if match else "" for match in found}
    known = set().union(*WORDS.values())
    return len(matrices) == 1 and all(found) and not known & set(split_name(matrices.pop())[0])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
