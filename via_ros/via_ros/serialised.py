"""Serialised messages read and written without making objects of them: at 16 joints and 1 kHz objects cost most of it.

JointStateDecoder  bytes of a JointState -> Joints
decoded_command    bytes of a VsaCommand -> its stamp and a Command
CommandBytes       a Command -> bytes to publish
Template           a message whose strings and lengths stay: numbers -> bytes to publish

Measured for 48 joints: 12 us to deserialise a JointState, 1 us to read it here. One estimate published as an object
takes 13-17 us with one listener, as bytes 9.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from via_core.signals import Array
from via_core.wire import FIELDS, SECOND
from via_interfaces.msg import VsaCommand

from via_ros.conversions import MOST_NAMES, STAMP, Command, Joints, Named, Names, joints_of, nanoseconds
from via_ros.interfaces import ENCAPSULATION

NATIVE = b"\x00\x01"  # plain CDR, little endian, of the machines this runs on
LENGTH, SEQUENCE = struct.Struct("<I"), struct.Struct("<Q")
HEADER = struct.Struct("<iII")  # stamp, and how long the frame's name is
COMMAND = struct.Struct("<QB7x3dI")  # after the header of a VsaCommand, from its number to the count of motors
PADDING = bytes(-COMMAND.size % 8)  # before the motors, if there are any
AFTER_STAMP = ENCAPSULATION + STAMP.size
SIZES = {
    "boolean": 1, "octet": 1, "uint8": 1, "int8": 1, "uint16": 2, "int16": 2, "uint32": 4, "int32": 4, "float": 4,
    "uint64": 8, "int64": 8, "double": 8,
}  # fmt: skip


class _Opening(NamedTuple):
    """Frame and names of a message as they stand in it: a whole stretch to compare at once, but for its padding."""

    names: Names
    content: bytes  # padding zero
    mask: np.ndarray  # (n,) uint32, zero where padding is

    def begins(self, data: bytes) -> bool:
        """Whether a message has the same frame and names; what stands in padding is anything."""
        if data.startswith(self.content, AFTER_STAMP):  # most likely it is zero there too
            return True
        if len(data) < AFTER_STAMP + len(self.content):
            return False
        words = np.frombuffer(data, np.uint32, len(self.mask), AFTER_STAMP)
        return (words & self.mask).tobytes() == self.content


class JointStateDecoder:
    """Reads serialised JointStates; the names of a stream of messages are decoded once."""

    def __init__(self) -> None:
        self._known: list[_Opening] = []
        self._turn = 0  # where to look first: devices that send by turns do so in the same order

    def decode(self, data: bytes) -> Joints | None:
        """What a message says; None for bytes that are no JointState."""
        try:
            if not data.startswith(NATIVE):
                return joints_of(deserialize_message(data, JointState), Names(()))
            opening = self._recognised(data) or self._learn(data)
            return _joints(data, opening.names, AFTER_STAMP + len(opening.content))
        except (struct.error, ValueError, RuntimeError, MemoryError):
            return None

    def _recognised(self, data: bytes) -> _Opening | None:
        known = self._known
        for step in range(len(known)):
            at = (self._turn + step) % len(known)
            if known[at].begins(data):
                self._turn = at + 1
                return known[at]
        return None

    def _learn(self, data: bytes) -> _Opening:
        told = bytearray()
        _, at = _text(data, AFTER_STAMP, told)
        (count,) = LENGTH.unpack_from(data, at)
        told += b"\xff" * LENGTH.size
        at += LENGTH.size
        names = []
        for _ in range(count):
            name, at = _text(data, at, told)
            names.append(name)
        mask = np.frombuffer(told, np.uint32)
        content = (np.frombuffer(data, np.uint32, len(mask), AFTER_STAMP) & mask).tobytes()
        opening = _Opening(Names(tuple(names)), content, mask)
        self._known = [*self._known[-MOST_NAMES + 1 :], opening]
        return opening


def _text(data: bytes, at: int, told: bytearray) -> tuple[str, int]:
    """The string at a place and the place after it and its padding; `told` grows by ones, by zeros for padding."""
    (length,) = LENGTH.unpack_from(data, at)
    end = at + LENGTH.size + length
    padding = -end % 4
    if end > len(data):
        raise ValueError("a string ends after its message")
    told += b"\xff" * (LENGTH.size + length) + bytes(padding)
    return data[at + LENGTH.size : end].rstrip(b"\0").decode("utf-8", "replace"), end + padding


def _joints(data: bytes, names: Names, at: int) -> Joints:
    arrays = []
    for _ in FIELDS:
        (count,) = LENGTH.unpack_from(data, at)
        at += LENGTH.size
        if count:
            at += -(at - ENCAPSULATION) % 8
            arrays.append(np.frombuffer(data, np.float64, count, at))
            at += 8 * count
        else:
            arrays.append(np.empty(0))
    stamp = data[ENCAPSULATION:AFTER_STAMP]
    seconds, nanoseconds = STAMP.unpack(stamp)
    return Joints(names, seconds * SECOND + nanoseconds, stamp, *arrays)


def decoded_command(data: bytes) -> tuple[int, Command] | None:
    """Stamp [ns] and command of a message, whether it can be followed or not; None for bytes that are no VsaCommand."""
    try:
        if not data.startswith(NATIVE):
            told = deserialize_message(data, VsaCommand)
            motor = np.array(told.motor, dtype=np.float64)
            command = Command(told.mode, told.equilibrium, told.preset, told.damping, motor)
            return nanoseconds(told.header.stamp), command
        seconds, nanosec, length = HEADER.unpack_from(data, ENCAPSULATION)
        at = HEADER.size + length
        at += ENCAPSULATION + -at % 8
        _, mode, equilibrium, preset, damping, count = COMMAND.unpack_from(data, at)
        at += COMMAND.size + len(PADDING)
        motor = np.frombuffer(data, np.float64, count, at).copy() if count else np.empty(0)
        return seconds * SECOND + nanosec, Command(mode, equilibrium, preset, damping, motor)
    except (struct.error, ValueError, RuntimeError, MemoryError):
        return None


class CommandBytes:
    """The VsaCommands of a device or an arm, numbered from 0."""

    def __init__(self, device: Named) -> None:
        message = VsaCommand()
        message.header.frame_id = device.name
        at = HEADER.size + len(device.name.encode()) + 1
        self._at = ENCAPSULATION + at + -at % 8
        self._start = bytearray(serialize_message(message)[: self._at])
        self._sequence = 0

    def numbered(self, time: int, command: Command) -> bytes:
        """The message of `command` with the stamp `time` [ns] and the next number."""
        STAMP.pack_into(self._start, ENCAPSULATION, *divmod(time, SECOND))
        mode, equilibrium, preset, damping, motor = command
        told = COMMAND.pack(self._sequence, mode, equilibrium, preset, damping, len(motor))
        self._sequence += 1
        if not len(motor):
            return bytes(self._start) + told
        return b"".join((self._start, told, PADDING, np.asarray(motor, dtype=np.float64).tobytes()))


class Template:
    """A message to publish again and again with other numbers; its strings and the lengths of its arrays stay.

    The message begins with a Header and a sequence number (interfaces.NUMBERED) and has a status.
    """

    def __init__(self, message: Any) -> None:
        self._data = bytearray(serialize_message(message))
        self._found, _ = _members(message)
        self._words = np.frombuffer(self._data, np.float64, (len(self._data) - ENCAPSULATION) // 8, ENCAPSULATION)
        self._sequence, self._status = (ENCAPSULATION + self._found[member][0] for member in ("sequence", "status"))

    def places(self, member: str) -> list[int]:
        """Where the doubles of a member lie, in the words that `write` takes."""
        at, count = self._found[member]
        return [at // 8 + k for k in range(count)]

    def write(self, stamp: bytes, sequence: int, status: int, places: np.ndarray, values: Array) -> bytes:
        """The message with this stamp (8,), number and status, and `values` (n,) at `places` (n,)."""
        data = self._data
        data[ENCAPSULATION:AFTER_STAMP] = stamp
        SEQUENCE.pack_into(data, self._sequence, sequence)
        data[self._status] = status
        self._words[places] = values
        return bytes(data)


def _members(message: Any, at: int = 0, prefix: str = "") -> tuple[dict[str, tuple[int, int]], int]:
    """For every member with numbers the place of its first one and how many there are; and where the message ends.

    Plain CDR: everything is aligned to its own size, counted from the end of the encapsulation.
    """
    found: dict[str, tuple[int, int]] = {}
    for member, kind in message.get_fields_and_field_types().items():
        value = getattr(message, member)
        if hasattr(value, "get_fields_and_field_types"):
            inner, at = _members(value, at, f"{prefix}{member}.")
            found |= inner
        elif isinstance(value, str):
            at += -at % 4 + 4 + len(value.encode()) + 1
        else:
            count = 1
            if kind.startswith("sequence<"):
                count = len(value)
                at += -at % 4 + 4
            size = SIZES[kind.removeprefix("sequence<").removesuffix(">")]
            at += -at % size if count else 0
            found[prefix + member] = (at, count)
            at += size * count
    return found, at
