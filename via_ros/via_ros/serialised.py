"""Reading and writing of serialised messages without message objects, which dominate the cost at 16 joints and 1 kHz.

JointStateDecoder  bytes of a JointState -> Joints
decoded_command    bytes of a VsaCommand -> its stamp and a Command
CommandBytes       a Command -> bytes to publish
JointStateBytes    numbers of a StateWriter -> bytes of a JointState
Template           numbers -> bytes of a message with constant strings and array lengths

Measured for 48 joints: 12 us to deserialise a JointState, 1 us to read it here. One estimate published as an object
takes 13-17 us with one listener, as bytes 9.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from via_core.bags.definitions import typestore_of
from via_core.bags.layout import layout_of
from via_core.limits import LIMITS
from via_core.signals import Array
from via_core.wire import FIELDS, SECOND
from via_interfaces.msg import VsaCommand

from via_ros.conversions import (
    MOST_NAMES,
    Command,
    Joints,
    Names,
    StateWriter,
    joints_of,
    nanoseconds,
    unchecked_command,
)
from via_ros.interfaces import ENCAPSULATION, HEADER, SEQUENCE, STAMP, aligned, stamp_bytes, type_name

JOINT_STATES = "joint_states"  # topic of the samples, relative to the namespace of the nodes
NATIVE = b"\x00\x01"  # plain CDR, little endian
LENGTH = struct.Struct("<I")
COMMAND = struct.Struct("<QB7x3dI")  # VsaCommand after its header: sequence number to number of motors
PADDING = bytes(-COMMAND.size % 8)  # before the motors, if any
AFTER_STAMP = ENCAPSULATION + STAMP.size


def raw(publisher: Any) -> Callable[[bytes], None]:
    """Publishes serialised messages, without the checks of `publisher.publish`, which take a third of its time."""
    publish: Callable[[bytes], None] = publisher.handle.publish_raw
    return publish


class _Opening:
    """Serialised frame_id and joint names of a message, compared at once except for padding.

    content  with zeros as padding
    mask     (n,) uint32, zero where padding is
    """

    def __init__(self, names: Names, content: bytes, mask: np.ndarray) -> None:
        self.names, self.length = names, len(content)
        self._content, self._mask = content, mask
        self._latest = content  # with the padding of the last message: a sender seldom changes it

    def begins(self, data: bytes) -> bool:
        """Whether a message has the same frame and names; padding can hold any value."""
        if data.startswith(self._latest, AFTER_STAMP):
            return True
        if len(data) < AFTER_STAMP + self.length:
            return False
        words = np.frombuffer(data, np.uint32, len(self._mask), AFTER_STAMP)
        if (words & self._mask).tobytes() != self._content:
            return False
        self._latest = data[AFTER_STAMP : AFTER_STAMP + self.length]
        return True


class JointStateDecoder:
    """Reads serialised JointStates; decodes the names once per stream of messages."""

    def __init__(self) -> None:
        self._known: list[_Opening] = []
        self._turn = 0  # first candidate: devices publish in a fixed order

    def decode(self, data: bytes) -> Joints | None:
        """Contents of a message; None for invalid bytes and for messages beyond the limits."""
        if len(data) > LIMITS.message:
            return None
        try:
            if not data.startswith(NATIVE):
                return joints_of(deserialize_message(data, JointState), Names(()))
            opening = self._recognised(data) or self._learn(data)
            return _joints(data, opening.names, AFTER_STAMP + opening.length)
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
        mask_bytes = bytearray()
        _, at = _text(data, AFTER_STAMP, mask_bytes)
        (count,) = LENGTH.unpack_from(data, at)
        if count > LIMITS.joints:
            raise ValueError(f"{count} joints")
        mask_bytes += b"\xff" * LENGTH.size
        at += LENGTH.size
        names = []
        for _ in range(count):
            name, at = _text(data, at, mask_bytes)
            names.append(name)
        mask = np.frombuffer(mask_bytes, np.uint32)
        content = (np.frombuffer(data, np.uint32, len(mask), AFTER_STAMP) & mask).tobytes()
        opening = _Opening(Names(tuple(names)), content, mask)
        self._known = [*self._known[-MOST_NAMES + 1 :], opening]
        return opening


def _text(data: bytes, at: int, mask_bytes: bytearray) -> tuple[str, int]:
    """The string at an offset and the offset after its padding; appends ones to the mask, zeros for padding."""
    (length,) = LENGTH.unpack_from(data, at)
    end = at + LENGTH.size + length
    padding = -end % 4
    if end > len(data):
        raise ValueError("a string ends after its message")
    mask_bytes += b"\xff" * (LENGTH.size + length) + bytes(padding)
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
    """Stamp [ns] and command of a message, not validated (see `followed`); None for invalid bytes."""
    try:
        if not data.startswith(NATIVE):
            message = deserialize_message(data, VsaCommand)
            return nanoseconds(message.header.stamp), unchecked_command(message)
        seconds, nanosec, length = HEADER.unpack_from(data, ENCAPSULATION)
        at = ENCAPSULATION + aligned(HEADER.size + length, 8)
        _, mode, equilibrium, preset, damping, count = COMMAND.unpack_from(data, at)
        at += COMMAND.size + len(PADDING)
        motor = np.frombuffer(data, np.float64, count, at).copy() if count else np.empty(0)
        return seconds * SECOND + nanosec, Command(mode, equilibrium, preset, damping, motor)
    except (struct.error, ValueError, RuntimeError, MemoryError):
        return None


class CommandBytes:
    """Writes the VsaCommands of the device or arm `name`, numbered from 0."""

    def __init__(self, name: str) -> None:
        message = VsaCommand()
        message.header.frame_id = name
        start = ENCAPSULATION + aligned(HEADER.size + len(name.encode()) + 1, 8)
        self._start = bytearray(serialize_message(message)[:start])
        self._sequence = 0

    def numbered(self, time: int, command: Command) -> bytes:
        """The message of `command` with stamp `time` [ns] and the next sequence number."""
        STAMP.pack_into(self._start, ENCAPSULATION, *divmod(time, SECOND))
        mode, equilibrium, preset, damping, motor = command
        numbers = COMMAND.pack(self._sequence, mode, equilibrium, preset, damping, len(motor))
        self._sequence += 1
        if not len(motor):
            return bytes(self._start) + numbers
        return b"".join((self._start, numbers, PADDING, np.asarray(motor, dtype=np.float64).tobytes()))


class Template:
    """A message published repeatedly with other numbers; strings and array lengths are constant.

    The message begins with a Header. `doubles` views its content in steps of eight bytes, to be written at `places`.
    """

    def __init__(self, message: Any) -> None:
        self._data = bytearray(serialize_message(message))
        name = type_name(message)
        self._numbers = layout_of(typestore_of(name), name, bytes(self._data)).numbers
        self.doubles = np.frombuffer(self._data, np.float64, (len(self._data) - ENCAPSULATION) // 8, ENCAPSULATION)
        self._sequence = self._numbers["sequence"].offset if "sequence" in self._numbers else 0
        self._octets = next((each.offset for each in self._numbers.values() if each.form == "u1"), 0)

    def places(self, member: str) -> list[int]:
        """Positions in `doubles` of the doubles of a member."""
        first, count = self._slots(member)
        return [*range(first, first + count)]

    def view(self, member: str) -> Array:
        """The doubles (k,) of a member, to be written."""
        first, count = self._slots(member)
        return self.doubles[first : first + count]

    def _slots(self, member: str) -> tuple[int, int]:
        """Position of the first double of a member in `doubles`, and their number."""
        number = self._numbers[member]
        return (number.offset - ENCAPSULATION) // 8, 1 if number.count is None else number.count

    def stamped(self, stamp: bytes) -> bytes:
        """The message with stamp (8,) bytes."""
        self._data[ENCAPSULATION:AFTER_STAMP] = stamp
        return bytes(self._data)

    def numbered(self, stamp: bytes, sequence: int, octets: bytes) -> bytes:
        """The message with stamp (8,) bytes, sequence number and its uint8 numbers, which are adjacent."""
        data = self._data
        data[ENCAPSULATION:AFTER_STAMP] = stamp
        SEQUENCE.pack_into(data, self._sequence, sequence)
        data[self._octets : self._octets + len(octets)] = octets
        return bytes(data)


class JointStateBytes:
    """Serialised JointStates with the numbers of a StateWriter."""

    def __init__(self, numbers: StateWriter) -> None:
        self._template = Template(numbers.stamped(0))
        self._copied = [(self._template.view(field), getattr(numbers, field)) for field in FIELDS]

    def stamped(self, time: int) -> bytes:
        """The message with the present numbers and the stamp `time` [ns]."""
        for written, numbers in self._copied:
            written[:] = numbers
        return self._template.stamped(stamp_bytes(time))
