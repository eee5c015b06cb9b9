"""Message classes by name, and stamp and sequence number of serialised messages."""

from __future__ import annotations

import re
import struct
from importlib import import_module
from typing import Any

import via_interfaces.msg
from via_core.errors import BagError
from via_core.wire import SECOND

# These types begin with `std_msgs/Header header` and `uint64 sequence`.
NUMBERING = [("header", "std_msgs/Header"), ("sequence", "uint64")]
NUMBERED = frozenset(
    f"via_interfaces/msg/{name}"
    for name, kind in vars(via_interfaces.msg).items()
    if list(getattr(kind, "get_fields_and_field_types", dict)().items())[:2] == NUMBERING
)
ENCAPSULATION = 4  # [bytes] header of a serialised message; alignment is relative to its end
STAMP, SEQUENCE = struct.Struct("<iI"), struct.Struct("<Q")
HEADER = struct.Struct("<iII")  # stamp, length of frame_id


def message_class(type_name: str) -> Any:
    """Class of 'package/msg/Name'. Raises BagError where it is not installed."""
    return interface_class(type_name, "msg", "message")


def interface_class(type_name: str, kind: str, called: str) -> Any:
    """Class of 'package/<kind>/Name', kind 'msg', 'srv' or 'action'. Raises BagError with `called` if not installed."""
    words = re.fullmatch(rf"(\w+)/{kind}/(\w+)", type_name)
    try:
        if words and words[2][0].isupper():  # other names in the module are not interfaces
            return getattr(import_module(f"{words[1]}.{kind}"), words[2])
    except (ImportError, AttributeError):
        pass
    raise BagError(f"{called} type {type_name} is not installed here; source its workspace")


def type_name(message: Any) -> str:
    """'package/msg/Name' of a message."""
    kind = type(message)
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def stamp_of(data: bytes) -> int | None:
    """Header stamp [ns] of a serialised message whose first member is a Header; None if it is too short."""
    if len(data) < ENCAPSULATION + STAMP.size:
        return None
    seconds, nanoseconds = STAMP.unpack_from(data, ENCAPSULATION)
    return int(seconds * SECOND + nanoseconds)


def stamp_bytes(time: int) -> bytes:
    """The serialised stamp of `time` [ns]; seconds are rounded down, so that nanosec is not negative."""
    return STAMP.pack(*divmod(time, SECOND))


def opening_of(data: bytes) -> tuple[int, int] | None:
    """Stamp [ns] and sequence of a serialised message of a NUMBERED type (CDR, little endian); None: too short."""
    try:
        seconds, nanoseconds, length = HEADER.unpack_from(data, ENCAPSULATION)
        (sequence,) = SEQUENCE.unpack_from(data, ENCAPSULATION + aligned(HEADER.size + length, 8))
    except struct.error:
        return None
    return seconds * SECOND + nanoseconds, sequence


def aligned(offset: int, size: int) -> int:
    """The offset from which a number of `size` bytes is stored, at `offset` or behind its padding."""
    return offset + -offset % size
