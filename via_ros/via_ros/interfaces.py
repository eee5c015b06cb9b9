"""Message classes by name, and stamp and sequence number of serialised messages."""

from __future__ import annotations

import re
import struct
from importlib import import_module
from typing import Any, NamedTuple

from via_core.errors import BagError

# These types begin with `std_msgs/Header header` and `uint64 sequence`.
NUMBERED = frozenset(f"via_interfaces/msg/{name}Estimate" for name in ("Stiffness", "Damping", "Motor")) | frozenset(
    f"via_interfaces/msg/{name}" for name in ("VsaCommand", "GapStatus", "ControlState")
)
ENCAPSULATION = 4  # [bytes] header of a serialised message; alignment is relative to its end


class Opening(NamedTuple):
    """First members of a numbered message."""

    stamp: int  # [ns]
    sequence: int


def message_class(type_name: str) -> Any:
    """Class of 'package/msg/Name'. Raises BagError where it is not installed."""
    words = re.fullmatch(r"(\w+)/msg/(\w+)", type_name)
    try:
        if words and words[2][0].isupper():  # other names in the module are not messages
            return getattr(import_module(f"{words[1]}.msg"), words[2])
    except (ImportError, AttributeError):
        pass
    raise BagError(f"message type {type_name} is not installed here; source its workspace")


def stamp_of(data: bytes) -> int | None:
    """Header stamp [ns] of a serialised message whose first member is a Header; None if it is too short."""
    if len(data) < ENCAPSULATION + 8:
        return None
    seconds, nanoseconds = struct.unpack_from("<iI", data, ENCAPSULATION)
    return int(seconds * 1_000_000_000 + nanoseconds)


def opening_of(data: bytes) -> Opening | None:
    """Stamp and sequence of a serialised message of a NUMBERED type (CDR, little endian); None if it is too short."""
    stamp = stamp_of(data)
    if stamp is None or len(data) < ENCAPSULATION + 12:
        return None
    (length,) = struct.unpack_from("<I", data, ENCAPSULATION + 8)
    after = 12 + length
    at = ENCAPSULATION + after + (-after) % 8
    if at + 8 > len(data):
        return None
    return Opening(stamp, struct.unpack_from("<Q", data, at)[0])
