"""One reader of recordings: bags, CSV, Parquet, NumPy, MATLAB and JSON files become pandas frames.

    tables = read_tables("run.mat")       # name of the table -> frame; a bag has one table per topic

Numbers stay in the file's units. Lists in cells become columns `q[0]`, `q[1]`; members of structures get dotted names.
In a bag, column `time` is the stamp [ns], and values of named joints are called `elbow.position`, `elbow.effort`,
`elbow.reference.positions`. Arrays of different lengths in one file become different tables.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from via_core.errors import BagError, SignalError, ViaError, one_line
from via_core.limits import require_regular
from via_core.recordings.texts import MISSING, read_csv
from via_core.signals import Array

if TYPE_CHECKING:
    from pandas import DataFrame

    from via_core.bags.reader import Columns

Tables = dict[str, "DataFrame"]
WIDEST = 64  # numbers of a list in a cell, or columns of a matrix, that become columns
NANOSECONDS = ("nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs")
BAGS = (".mcap", ".db3", ".active")
TEXTS = (".csv", ".tsv", ".txt")
JOINT_NAMES = ("name", "joint_names")  # members of messages that name the joints of the others
_LIST = re.compile(r"\s*[\[(].*[\])]\s*")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a folder, or a file of rosbag2."""
    return path.is_dir() or path.suffix.lower() in BAGS


def is_table(path: Path) -> bool:
    """Whether a path is a file of another format that `read_tables` reads."""
    return path.is_file() and path.suffix.lower() in _READERS


def read_tables(path: str | Path) -> Tables:
    """All tables of a recording by name; '' is the name of the only one. Raises ViaError in one line."""
    path = Path(path)
    if not path.exists():
        raise SignalError(f"{path}: cannot be read: no such file or folder")
    if is_bag(path):
        return _bag(path)
    reader = _READERS.get(path.suffix.lower())
    if path.suffix.lower() == ".bag":
        new = path.with_suffix("")
        raise SignalError(f"{path}: is a bag of ROS 1; convert it: rosbags-convert --src {path} --dst {new}")
    if reader is None:
        raise SignalError(f"{path}: unknown format '{path.suffix}'; there are: bag folders, {', '.join(FORMATS)}")
    try:
        require_regular(path)
        return reader(path)
    except ViaError:
        raise
    except OSError as error:
        raise SignalError(f"{path}: cannot be read: {error.strerror or one_line(error)}") from None
    except (ValueError, TypeError, KeyError, EOFError, RecursionError, MemoryError, zipfile.BadZipFile) as error:
        raise SignalError(f"{path}: cannot be read: {one_line(error)}") from None


def numbers(frame: DataFrame, column: str) -> Array:
    """A column (N,) as numbers; empty cells are NaN. Raises SignalError that names the first cell that is no number."""
    import pandas

    values = frame[column]
    if values.dtype.kind not in "OTUS":
        return np.asarray(values, dtype=np.float64)
    cells = values.astype(str).str.strip().str.lower()
    texts = values.where(~cells.isin([each.lower() for each in MISSING]))
    made = pandas.to_numeric(texts, errors="coerce")
    wrong = np.flatnonzero(made.isna() & texts.notna())
    if len(wrong):
        row = int(wrong[0])
        raise SignalError(f"line {row + 2}, column '{column}': {values.iloc[row]!r} is not a number")
    return np.asarray(made, dtype=np.float64)


# ---- rows


def _csv(path: Path) -> Tables:
    return {"": expanded(read_csv(path))}


def _parquet(path: Path) -> Tables:
    import pandas

    frame = pandas.read_parquet(path)
    return {"": expanded(frame if isinstance(frame.index, pandas.RangeIndex) else frame.reset_index())}


def _json(path: Path) -> Tables:
    import pandas

    text = path.read_text(encoding="utf-8-sig")
    if path.suffix.lower() == ".json":
        content = json.loads(text)
    else:
        content = [json.loads(line) for line in text.splitlines() if line.strip()]
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        return {"": expanded(pandas.json_normalize(content))}
    if isinstance(content, dict):
        inner = [each for each in content.values() if isinstance(each, list) and each and isinstance(each[0], dict)]
        if len(inner) == 1:
            return {"": expanded(pandas.json_normalize(inner[0]))}
        return _by_length(_leaves(content), path)
    raise SignalError(f"{path}: is neither a list of records nor an object of arrays")


# ---- arrays


def _numpy(path: Path) -> Tables:
    try:
        found = np.load(path, allow_pickle=False)
    except ValueError as error:
        if "pickle" in str(error):
            raise SignalError(
                f"{path}: holds Python objects; save plain arrays with numpy.savez(path, time=..., q=...)"
            ) from None
        raise
    if isinstance(found, np.ndarray):
        return _by_length(_leaves({"column": found}), path)
    with found:
        return _by_length(_leaves({name: found[name] for name in found.files}), path)


def _matlab(path: Path) -> Tables:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise SignalError(f"{path}: is MATLAB 7.3 (HDF5); write it with save(..., '-v7')") from None
    except MatReadError as error:
        raise SignalError(f"{path}: cannot be read: {one_line(error)}") from None
    return _by_length(_leaves({name: each for name, each in content.items() if not name.startswith("__")}), path)


def _leaves(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Dotted names and numeric arrays in nested mappings and structured arrays."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
            continue
        if isinstance(value, (list, np.ndarray)) and len(value) and all(isinstance(each, Mapping) for each in value):
            called = [str(each.get("label") or k) for k, each in enumerate(value)]  # of signals in a Simulink structure
            yield from _leaves(dict(zip(called, value, strict=True)), f"{prefix}{name}.")
            continue
        try:
            array = np.asarray(value)
        except ValueError:  # ragged
            continue
        if array.dtype.names:
            yield from _leaves(
                {field: array[field] for field in array.dtype.names}, prefix if name == "column" else f"{prefix}{name}."
            )
        elif array.dtype.kind in "biuf" and 1 <= array.ndim <= 2:
            yield prefix + name, array


def _by_length(leaves: Iterator[tuple[str, NDArray[Any]]], path: Path) -> Tables:
    """One table per number of rows, longest first; matrices may have their samples in rows or in columns."""
    import pandas

    arrays = {name: array.ravel() if 1 in array.shape and array.ndim == 2 else array for name, array in leaves}
    rows = {len(array) for array in arrays.values() if array.ndim == 1 and len(array) > 1}
    tables: dict[int, dict[str, NDArray[Any]]] = {}
    for name, array in arrays.items():
        if array.ndim == 2:
            upright = array.shape[0] in rows or (array.shape[1] not in rows and array.shape[0] >= array.shape[1])
            matrix = array if upright else array.T
            if matrix.shape[1] <= WIDEST:
                own = tables.setdefault(len(matrix), {})
                own |= {f"{name}[{k}]": column for k, column in enumerate(matrix.T)}
        elif len(array) > 1:
            tables.setdefault(len(array), {})[name] = array
    if not tables:
        raise SignalError(f"{path}: holds no arrays of numbers")
    longest = sorted(tables, reverse=True)
    return {"" if k == 0 else f"{n} rows": pandas.DataFrame(_with_stamps(tables[n])) for k, n in enumerate(longest)}


def expanded(frame: DataFrame) -> DataFrame:
    """The frame with lists in cells as columns of their own: `q` becomes `q[0]`, `q[1]`."""
    import pandas

    made = {}
    for at, name in enumerate(frame.columns):
        values = frame.iloc[:, at]
        first = next((each for each in values if each is not None and each is not np.nan), None)
        if values.dtype.kind == "M":  # dates, of any zone: [ns]
            values = pandas.to_datetime(values, utc=True).dt.tz_localize(None).astype("datetime64[ns]").astype("int64")
        lists = _cells(values) if _is_list(first) else None
        if lists is None:
            made[str(name) if str(name) not in made else f"{name}#{at}"] = values
        else:
            made |= {f"{name}[{k}]": column for k, column in enumerate(lists.T)}
    return pandas.DataFrame(_with_stamps(made))


def _with_stamps(columns: Mapping[str, Any]) -> dict[str, Any]:
    """The columns; whole seconds and the nanoseconds beyond them, as in ROS stamps, become one: `stamp_ns`."""
    made = dict(columns)
    for name in columns:
        match = re.fullmatch(r"(.*?)(?:sec|secs|seconds)", name)
        rest = next((match[1] + each for each in NANOSECONDS if match[1] + each in columns), "") if match else ""
        if match is None or not rest or not _whole(columns[name], 2.0**33) or not _whole(columns[rest], 1e9):
            continue
        seconds, beyond = (np.asarray(made.pop(each)).astype(np.int64) for each in (name, rest))
        made = {f"{match[1].rstrip('._') or 'stamp'}_ns": 10**9 * seconds + beyond, **made}
    return made


def _whole(values: Any, end: float) -> bool:
    """Whether values are whole numbers from 0 to below `end`."""
    array = np.asarray(values)
    return array.dtype.kind in "iuf" and bool(np.all((array >= 0) & (array < end) & (array == np.rint(array))))


def _is_list(cell: object) -> bool:
    return isinstance(cell, (list, tuple, np.ndarray)) or (isinstance(cell, str) and _LIST.fullmatch(cell) is not None)


def _cells(values: Any) -> Array | None:
    """(N, k) numbers of lists or texts of lists of one length, NaN for empty cells; None where they are none."""
    rows: list[list[float]] = []
    try:
        for cell in values:
            parts = re.split(r"[,;\s]+", cell.strip("[]() \t")) if isinstance(cell, str) else cell
            rows.append([float(each) for each in parts] if _is_list(cell) else [])
    except (TypeError, ValueError):
        return None
    width = max(map(len, rows), default=0)
    if not 0 < width <= WIDEST:
        return None
    return np.array([row if len(row) == width else [np.nan] * width for row in rows])


# ---- bags


def _bag(path: Path) -> Tables:
    from via_core.bags.reader import read_bag

    bag = read_bag(path)
    made = {name: _topic(bag[name]) for name in bag.topics if len(bag.topic(name))}
    if not made:
        raise BagError(f"{path} holds no messages")
    return made


def _topic(columns: Columns) -> DataFrame:
    """All numbers of a topic; rows in file order, stamps [ns] in column `time`."""
    import pandas

    fields = columns.fields
    named = next((fields[each] for each in JOINT_NAMES if each in fields and fields[each].dtype == object), None)
    made: dict[str, NDArray[Any]] = {"time": columns.stamp}
    for field, values in fields.items():
        if field.startswith("header.") or (named is not None and field in JOINT_NAMES):
            continue
        if values.dtype != object and values.ndim == 1:
            made[field] = values
        elif field == "interface_values":  # of control_msgs/DynamicJointState
            made |= _interfaces(named, values)
        else:
            made |= _of_joints(field, values, named)
    return pandas.DataFrame(made)


def _of_joints(field: str, values: NDArray[Any], named: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
    """Columns of a member with one number per joint, or per index where the message names no joints."""
    width = values.shape[1] if values.ndim == 2 else max((np.size(each) for each in values), default=0)
    if values.dtype == object and not all(isinstance(each, np.ndarray) for each in values):
        return {}
    made: dict[str, NDArray[Any]] = {}
    if named is None:
        rows: dict[tuple[str, ...], Any] = {tuple(f"[{k}]" for k in range(min(width, WIDEST))): slice(None)}
    else:
        rows = {}
        for k, names in enumerate(named):
            rows.setdefault(names, []).append(k)
    for names, where in rows.items():
        part = values[where]
        for k, joint in enumerate(names):
            column = (
                [each[k] if k < len(each) else np.nan for each in part] if part.dtype == object or k < width else None
            )
            if column is not None:
                label = f"{field}{joint}" if named is None else f"{joint}.{field}"
                made.setdefault(label, np.full(len(values), np.nan))[where] = column
    return {label: column for label, column in made.items() if np.isfinite(column).any()}


def _interfaces(named: NDArray[Any] | None, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    made: dict[str, NDArray[Any]] = {}
    for row, (names, joints) in enumerate(zip(named if named is not None else (), values, strict=False)):
        for joint, each in zip(names, joints, strict=False):
            for interface, value in zip(each.interface_names, each.values, strict=False):
                made.setdefault(f"{joint}.{interface}", np.full(len(values), np.nan))[row] = value
    return made


_READERS: dict[str, Callable[[Path], Tables]] = {
    ".csv": _csv, ".tsv": _csv, ".txt": _csv, ".parquet": _parquet, ".npy": _numpy, ".npz": _numpy, ".mat": _matlab,
    ".json": _json, ".jsonl": _json, ".ndjson": _json,
}  # fmt: skip
FORMATS = (*BAGS[:2], *_READERS)
