"""Message classes by name, and the little of a serialised message that can be read without decoding it."""

from __future__ import annotations

import re
import struct
from importlib import import_module
from typing import Any, NamedTuple

from via_core.errors import BagError

# These begin with `std_msgs/Header header` and `uint64 sequence`.
NUMBERED = frozenset(
    f"via_interfaces/msg/{name}"
    for name in ("StiffnessEstimate", "DampingEstimate", "MotorEstimate", "VsaCommand", "ModalState", "GapStatus")
)
ENCAPSULATION = 4  # [bytes] before the content of a serialised message; offsets within count from its end


class Opening(NamedTuple):
    """How a numbered message begins."""

    stamp: int  # [ns]
    sequence: int


def message_class(type_name: str) -> Any:
    """The class of 'package/msg/Name'; raises BagError where that package is not installed or has no such message."""
    words = re.fullmatch(r"(\w+)/msg/(\w+)", type_name)
    try:
        if words:
            return getattr(import_module(f"{words[1]}.msg"), words[2])
    except (ImportError, AttributeError):
        pass
    raise BagError(f"message type {type_name} is not installed here; source the workspace that has it")


def type_name_of(message_type: Any) -> str:
    """'package/msg/Name' of a message class."""
    return f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"


def stamp_of(data: bytes) -> int:
    """Header stamp [ns] of a serialised message whose first member is a Header."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, ENCAPSULATION)
    return seconds * 1_000_000_000 + nanoseconds


def opening_of(data: bytes) -> Opening:
    """Stamp and sequence of a serialised message of a type in NUMBERED (CDR, little endian)."""
    (length,) = struct.unpack_from("<I", data, ENCAPSULATION + 8)
    after = 12 + length
    (sequence,) = struct.unpack_from("<Q", data, ENCAPSULATION + after + (-after) % 8)
    return Opening(stamp_of(data), sequence)
