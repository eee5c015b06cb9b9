"""Byte offsets of the numbers in a serialised message, so that many messages of one layout are read as columns.

CDR (DDS-XTypes 1.3, section 7.4, encoding version 1): a header of four bytes, then every member aligned to its own
size, counted from the end of the header. Sequences have a u32 length, strings a u32 length that includes a final zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

_NUMBERS = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip


_SLACK = 8  # [bytes] Fast DDS sizes its buffer for the worst alignment: so many extra bytes per sequence or text


class NoFixedLayoutError(Exception):
    """The message cannot be read by fixed offsets: unsupported member type, byte order or length."""


@dataclass(frozen=True)
class Number:
    """A numeric member: numpy format, byte offset in the message, number of values (None: a scalar)."""

    form: str
    offset: int
    count: int | None


@dataclass
class Layout:
    """The layout of one message.

    size     [bytes] of the message with padding
    numbers  member name ('header.stamp.sec') -> its values
    texts    member name -> text or tuple of texts; part of the layout, as their lengths shift the following members
    fixed    [begin, end) byte ranges that are equal in every message of this layout
    """

    size: int
    numbers: dict[str, Number] = field(default_factory=dict)
    texts: dict[str, str | tuple[str, ...]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)


def layout_of(store: Typestore, type_name: str, message: bytes) -> Layout:
    """Layout of one serialised `message`. Raises NoFixedLayoutError where fixed offsets cannot express it."""
    if len(message) < 4 or message[0] != 0 or message[1] != 1:
        raise NoFixedLayoutError("not plain little-endian CDR")
    walk = _Walk(store, message, Layout(len(message)))
    walk.layout.fixed.append((0, 2))
    walk.members(type_name, "")
    if len(message) - walk.at > _SLACK * (1 + walk.lengths):
        raise NoFixedLayoutError(f"{len(message) - walk.at} bytes left over")
    return walk.layout


@dataclass
class _Walk:
    store: Typestore
    message: bytes
    layout: Layout
    at: int = 4
    lengths: int = 0  # sequences and texts seen

    def members(self, type_name: str, prefix: str) -> None:
        members = self.store.fielddefs[type_name][1]
        if not members:
            self.take(1)  # an empty message is one byte
        for name, (kind, inner) in members:
            full = prefix + name
            if kind == Nodetype.NAME:
                self.members(inner, full + ".")
            elif kind == Nodetype.BASE:
                self.single(full, inner[0])
            else:
                (element, element_type), count = inner
                if element != Nodetype.BASE:
                    raise NoFixedLayoutError(f"{full} is an array of messages")
                self.several(full, element_type[0], self.length() if kind == Nodetype.SEQUENCE else count)

    def single(self, name: str, base: str) -> None:
        if base == "string":
            self.layout.texts[name] = self.text()
        else:
            self.layout.numbers[name] = Number(*self.place(base, 1), None)

    def several(self, name: str, base: str, count: int) -> None:
        if base == "string":
            if count > len(self.message):
                raise NoFixedLayoutError(f"{name} cannot hold {count} texts")
            self.layout.texts[name] = tuple(self.text() for _ in range(count))
        else:
            self.layout.numbers[name] = Number(*self.place(base, count), count)

    def place(self, base: str, count: int) -> tuple[str, int]:
        """Format and offset of `count` numbers; no alignment for zero numbers, as in Fast CDR."""
        form = _NUMBERS.get(base)
        if form is None:
            raise NoFixedLayoutError(f"members of type {base}")
        width = np.dtype(form).itemsize
        if count:
            self.at += -(self.at - 4) % width
        return f"<{form}" if width > 1 else form, self.take(width * count)

    def length(self) -> int:
        _, offset = self.place("uint32", 1)
        self.lengths += 1
        self.layout.fixed.append((offset, offset + 4))
        return int.from_bytes(self.message[offset : offset + 4], "little")

    def text(self) -> str:
        count = self.length()
        offset = self.take(count)
        self.layout.fixed.append((offset, offset + count))
        try:
            return self.message[offset : offset + max(count - 1, 0)].decode()
        except UnicodeDecodeError:
            raise NoFixedLayoutError("a text that is not UTF-8") from None

    def take(self, count: int) -> int:
        if count > len(self.message) - self.at:
            raise NoFixedLayoutError("the message ends early")
        self.at += count
        return self.at - count


def decoded(store: Typestore, type_name: str, message: bytes) -> Any:
    """One decoded message. Raises any exception of the generated decoder on invalid bytes.

    Typestore.deserialize_cdr would refuse the unused bytes that Fast DDS leaves at the end.
    """
    if len(message) < 4 or message[0] != 0 or message[1] > 1:
        raise ValueError("not plain CDR")
    definition = store.get_msgdef(type_name)
    decode = definition.deserialize_cdr_le if message[1] else definition.deserialize_cdr_be
    value, _ = decode(message[4:], 0, definition.cls, store)
    return value


def scalar_formats(store: Typestore, type_name: str, prefix: str = "") -> dict[str, str]:
    """Numpy formats of the scalar members; names of nested ones are dotted."""
    formats: dict[str, str] = {}
    for name, (kind, inner) in store.fielddefs[type_name][1]:
        if kind == Nodetype.NAME:
            formats |= scalar_formats(store, inner, f"{prefix}{name}.")
        elif kind == Nodetype.BASE and inner[0] in _NUMBERS:
            formats[prefix + name] = _NUMBERS[inner[0]]
    return formats


def shares_layout(layout: Layout, rows: NDArray[np.uint8]) -> bool:
    """Whether all messages `rows` (n, size) have the `layout` of the first."""
    spans = np.array([span for span in layout.fixed if span[0] < span[1]], dtype=np.int64).reshape(-1, 2)
    return bool(_all_equal(rows, spans))


@njit(cache=True)
def _all_equal(rows: NDArray[np.uint8], spans: NDArray[np.int64]) -> bool:
    first = rows[0]
    for k in range(1, len(rows)):
        row = rows[k]
        different = np.uint8(0)
        for s in range(len(spans)):
            for i in range(spans[s, 0], spans[s, 1]):
                different |= first[i] ^ row[i]
        if different != 0:
            return False
    return True


def column(number: Number, rows: NDArray[np.uint8]) -> NDArray[np.generic]:
    """Values (n,) or (n, count) of one member in all messages `rows` (n, size)."""
    width = np.dtype(number.form).itemsize
    count = 1 if number.count is None else number.count
    packed = np.ascontiguousarray(rows[:, number.offset : number.offset + width * count])
    shape = (len(rows),) if number.count is None else (len(rows), count)
    if packed.size == 0:
        return np.empty(shape, dtype=number.form)
    if number.form == "?":
        return (packed != 0).reshape(shape)
    return packed.view(number.form).reshape(shape)


def filled(
    store: Typestore, type_name: str, template: Any, count: int, columns: Mapping[str, NDArray[Any]]
) -> list[bytes]:
    """`count` serialised copies of the message `template` with the members in `columns` replaced.

    columns  member name -> (count,) or (count, k), k the length of the member in the template
    """
    message = bytes(store.serialize_cdr(template, type_name))
    layout = layout_of(store, type_name, message)
    rows = np.tile(np.frombuffer(message, dtype=np.uint8), (count, 1))
    for name, values in columns.items():
        number = layout.numbers[name]
        packed = np.ascontiguousarray(values, dtype=number.form).view(np.uint8).reshape(count, -1)
        rows[:, number.offset : number.offset + packed.shape[1]] = packed
    return [row.tobytes() for row in rows]
