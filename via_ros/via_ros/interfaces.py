"""Message classes by name, and the little of a serialised message that can be read without decoding it."""

from __future__ import annotations

import re
import struct
from importlib import import_module
from typing import Any, NamedTuple

from via_core.errors import BagError

# These begin with `std_msgs/Header header` and `uint64 sequence`.
NUMBERED = frozenset(f"via_interfaces/msg/{name}Estimate" for name in ("Stiffness", "Damping", "Motor")) | frozenset(
    f"via_interfaces/msg/{name}" for name in ("VsaCommand", "GapStatus", "ControlState")
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
        if words and words[2][0].isupper():  # the rest of what stands in that module are no messages
            return getattr(import_module(f"{words[1]}.msg"), words[2])
    except (ImportError, AttributeError):
        pass
    raise BagError(f"message type {type_name} is not installed here; source the workspace that has it")


def type_name_of(message_type: Any) -> str:
    """'package/msg/Name' of a message class."""
    return f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"


def stamp_of(data: bytes) -> int | None:
    """Header stamp [ns] of a serialised message whose first member is a Header; None where it ends before that."""
    if len(data) < ENCAPSULATION + 8:
        return None
    seconds, nanoseconds = struct.unpack_from("<iI", data, ENCAPSULATION)
    return int(seconds * 1_000_000_000 + nanoseconds)


def opening_of(data: bytes) -> Opening | None:
    """Stamp and sequence of a serialised message of a type in NUMBERED (CDR, little endian); None where it ends before.

    Whoever publishes bytes (a player of a damaged bag) may publish any.
    """
    stamp = stamp_of(data)
    if stamp is None or len(data) < ENCAPSULATION + 12:
        return None
    (length,) = struct.unpack_from("<I", data, ENCAPSULATION + 8)
    after = 12 + length
    at = ENCAPSULATION + after + (-after) % 8
    if at + 8 > len(data):
        return None
    return Opening(stamp, struct.unpack_from("<Q", data, at)[0])
