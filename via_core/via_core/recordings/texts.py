"""Tables of text: CSV and the like, with comments, units below the names, quoted names and missing cells."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from via_core.errors import SignalError, one_line
from via_core.limits import require_regular
from via_core.recordings.units import is_unit

if TYPE_CHECKING:
    from pandas import DataFrame

MISSING = (
    "",
    "nan",
    "NaN",
    "NAN",
    "N/A",
    "n/a",
    "NA",
    "NULL",
    "null",
    "None",
    "-",
)  # cells without a value
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?|nan|NaN|")


class _Head(NamedTuple):
    """Beginning of a table of text: its column names, the lines before its rows, and its delimiter."""

    names: list[str]
    skipped: int  # comments, the header and a line of units
    delimiter: str


def _head(path: Path, delimiter: str | None) -> _Head:
    """The header: the first line that is no comment, or a comment above a line of numbers, as numpy.savetxt writes.

    Units in a line below the header become part of the names: `position [deg]`.
    """
    try:
        require_regular(path)
        with path.open(encoding="utf-8-sig", newline="") as file:
            line, comment, skipped = file.readline(), "", 0
            while line.lstrip().startswith("#"):
                line, comment, skipped = file.readline(), line.strip().lstrip("# "), skipped + 1
            below = file.readline()
    except OSError as error:
        raise SignalError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        remedy = f"iconv -f latin1 -t utf-8 {path} > {path.with_stem(path.stem + '_utf8')}"
        raise SignalError(f"{path}: cannot be read: not UTF-8 text; from a western Windows program: {remedy}") from None
    if not line.strip():
        raise SignalError(f"{path.name} is empty")
    found = delimiter or max(",;\t", key=line.count)
    if delimiter is None and found not in line and " " in line.strip():
        found = " "
    cells = _split(line, found, path)
    if not all(_NUMBER.fullmatch(cell) for cell in cells):
        units = [cell.strip("[]()") for cell in _split(below, found, path)]
        if len(units) == len(cells) and any(units) and all(not unit or is_unit(unit) for unit in units):
            named = [f"{name} [{unit}]" if unit else name for name, unit in zip(cells, units, strict=True)]
            return _Head(named, skipped + 2, found)
        return _Head(cells, skipped + 1, found)
    names = re.split(r"[,;\t ]+", comment) if comment else []
    if len(names) != len(cells):
        names = [f"column[{k}]" for k in range(len(cells))]
    return _Head(names, skipped, found)


def _split(line: str, delimiter: str, path: Path) -> list[str]:
    """The cells of a line; quoted ones may contain the delimiter."""
    text = line.strip("\r\n")
    try:
        cells = text.split() if delimiter == " " else next(csv.reader([text], delimiter=delimiter), [""])
    except csv.Error as error:
        raise SignalError(f"{path.name}: the header cannot be read: {error}") from None
    return [cell.strip() for cell in cells]


def delimiter_of(path: Path) -> str:
    """The delimiter of a table of text."""
    return _head(path, None).delimiter


def read_csv(path: Path, delimiter: str | None = None) -> DataFrame:
    """A table of text: comments (#) before the header are skipped, the delimiter is that of the header line.

    Raises SignalError for a damaged file.
    """
    import pyarrow
    from pyarrow import csv as arrow

    head = _head(path, delimiter)
    if head.delimiter == " ":
        return _by_spaces(path, head)
    wrong: list[arrow.InvalidRow] = []

    def bad_row(row: arrow.InvalidRow) -> str:
        if row.text.lstrip().startswith("#"):
            return "skip"
        wrong.append(row)
        return "error"

    parse = arrow.ParseOptions(delimiter=head.delimiter, invalid_row_handler=bad_row)
    convert = arrow.ConvertOptions(
        null_values=MISSING, strings_can_be_null=True, auto_dict_encode=False,
        decimal_point="," if head.delimiter == ";" and _decimal_comma(path, head.skipped) else ".",
    )  # fmt: skip
    # One block: types are inferred from the first block alone. One thread: rows are numbered.
    size = min(path.stat().st_size + 4096, 1 << 30)
    numbered = [str(k) for k in range(len(head.names))]
    options = arrow.ReadOptions(skip_rows=head.skipped, column_names=numbered, block_size=size, use_threads=False)
    try:
        frame = arrow.read_csv(path, options, parse, convert).to_pandas()
    except pyarrow.ArrowInvalid as error:
        if "Empty CSV" in str(error):
            return _empty(head.names)
        if not wrong:
            raise SignalError(f"{path.name} cannot be read: {one_line(error)}") from None
        row = wrong[0]
        raise SignalError(
            f"{path.name} line {row.number} has {row.actual_columns} columns, its header {row.expected_columns}"
        ) from None
    frame.columns = head.names
    return frame


def _empty(names: list[str]) -> DataFrame:
    import pandas

    return pandas.DataFrame(np.empty((0, len(names))), columns=names)


def _decimal_comma(path: Path, skipped: int) -> bool:
    with path.open(encoding="utf-8-sig") as file:
        row = [line for _, line in zip(range(skipped + 1), file)][-1]
    return re.search(r"\d,\d", row) is not None


def _by_spaces(path: Path, head: _Head) -> DataFrame:
    import pandas

    return pandas.read_csv(path, sep=r"\s+", skiprows=head.skipped, names=head.names, index_col=False)
