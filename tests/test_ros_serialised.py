"""Serialised messages: equal to those of ROS for any names and lengths; invalid bytes give None."""

from __future__ import annotations

import array
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from ros_messages import CommandWriter
from sensor_msgs.msg import JointState
from via_interfaces.msg import ControlState, DampingEstimate, MotorEstimate, StiffnessEstimate, VsaCommand
from via_ros.conversions import MOST_NAMES, Command, Names, StateWriter, joints_of, nanoseconds, set_stamp
from via_ros.interfaces import stamp_bytes
from via_ros.serialised import CommandBytes, JointStateBytes, JointStateDecoder, Template, decoded_command

TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
DOUBLES = st.floats(width=64)
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)  # [ns]


def bits(values):
    return np.asarray(values, dtype=np.float64).view(np.uint64).tolist()


@st.composite
def joint_states(draw):
    message = JointState(name=draw(st.lists(TEXTS, max_size=6)))
    message.header.frame_id = draw(TEXTS)
    set_stamp(message.header.stamp, draw(STAMPS))
    for member in ("position", "velocity", "effort"):
        setattr(message, member, array.array("d", draw(st.lists(DOUBLES, max_size=6))))
    return message


@given(st.lists(joint_states(), min_size=1, max_size=4))
def test_a_decoded_joint_state_equals_that_of_ros(messages):
    decoder = JointStateDecoder()
    for message in [*messages, *messages]:  # each once with names that are new and once with names that are known
        data = serialize_message(message)
        joints = decoder.decode(data)
        expected = joints_of(deserialize_message(data, JointState), Names(()))
        assert joints.names.joints == expected.names.joints
        assert (joints.stamp, joints.stamp_bytes) == (expected.stamp, expected.stamp_bytes)
        for member in ("position", "velocity", "effort"):
            assert bits(getattr(joints, member)) == bits(getattr(expected, member))


def test_names_are_decoded_once_for_any_padding_in_a_bounded_cache():
    decoder = JointStateDecoder()
    first = serialize_message(JointState(name=["a", "b"], position=[1.0, 2.0]))
    again = bytearray(serialize_message(JointState(name=["a", "b"], position=[3.0])))
    assert (again[28:30], again[36:38]) == (b"a\0", b"b\0")
    for at in (17, 18, 19, 30, 31, 38, 39):
        again[at] ^= 0x5A
    assert decoder.decode(first).names is decoder.decode(bytes(again)).names
    for k in range(2 * MOST_NAMES):
        assert decoder.decode(serialize_message(JointState(name=[f"joint {k}"]))).names.joints == (f"joint {k}",)
    assert len(decoder._known) == MOST_NAMES


@given(st.binary(max_size=200))
def test_random_bytes_are_not_a_message(data):
    for junk in (data, b"\x00\x01\x00\x00" + data):
        decoder = JointStateDecoder()
        joints = decoder.decode(junk)
        assert joints is None or junk.startswith(b"\x00\x01")  # some junk happens to be one


@given(st.integers(0, 150))
def test_a_truncated_message_gives_none(length):
    message = JointState(name=["shaft", "motor"], position=[1.0, 2.0], velocity=[3.0, 4.0], effort=[5.0, 6.0])
    data = serialize_message(message)
    decoder = JointStateDecoder()
    assert decoder.decode(data) is not None
    last = data.index(np.float64(6.0).tobytes()) + 8
    assert (decoder.decode(data[:length]) is None) == (length < last)


@st.composite
def commands(draw):
    message = VsaCommand(sequence=draw(st.integers(0, 2**64 - 1)), mode=draw(st.integers(0, 255)))
    message.header.frame_id = draw(TEXTS)
    set_stamp(message.header.stamp, draw(STAMPS))
    message.equilibrium, message.preset, message.damping = draw(st.tuples(DOUBLES, DOUBLES, DOUBLES))
    message.motor = array.array("d", draw(st.lists(DOUBLES, max_size=5)))
    return message


def big_endian(message):
    """A VsaCommand in the opposite byte order."""
    frame = message.header.frame_id.encode() + b"\0"
    data = struct.pack(">iII", message.header.stamp.sec, message.header.stamp.nanosec, len(frame)) + frame
    data += bytes(-len(data) % 8) + struct.pack(">QB7x", message.sequence, message.mode)
    data += struct.pack(">3dI", message.equilibrium, message.preset, message.damping, len(message.motor))
    return b"\0\0\0\0" + data + bytes(4) * bool(message.motor) + struct.pack(f">{len(message.motor)}d", *message.motor)


@given(commands())
def test_a_decoded_command_equals_that_of_ros(message):
    for data in (serialize_message(message), big_endian(message)):
        expected = deserialize_message(data, VsaCommand)
        stamp, command = decoded_command(data)
        assert (stamp, command.mode) == (nanoseconds(expected.header.stamp), expected.mode)
        numbers = [command.equilibrium, command.preset, command.damping, *command.motor]
        assert bits(numbers) == bits([message.equilibrium, message.preset, message.damping, *message.motor])
        assert command.motor.flags.aligned


@given(st.binary(max_size=120), st.integers(0, 110))
def test_truncated_and_random_commands_give_none(junk, length):
    message = VsaCommand(mode=2, motor=[1.0, 2.0])
    message.header.frame_id = "arm"
    data = serialize_message(message)
    assert (decoded_command(data[:length]) is None) == (length < data.index(np.float64(2.0).tobytes()) + 8)
    for each in (junk, b"\x00\x01\x00\x00" + junk):
        decoded_command(each)


class Device:
    def __init__(self, name):
        self.name = name


@given(commands(), STAMPS.filter(lambda stamp: stamp + 2 < 2**31 * 10**9))
def test_commands_written_as_bytes_are_those_that_ros_writes(message, stamp):
    device = Device(message.header.frame_id)
    slow, fast = CommandWriter(device), CommandBytes(device.name)
    command = Command(message.mode, message.equilibrium, message.preset, message.damping, np.array(message.motor))
    for k in range(3):
        expected = deserialize_message(serialize_message(slow.numbered(stamp + k, command)), VsaCommand)
        got = deserialize_message(fast.numbered(stamp + k, command), VsaCommand)
        assert (got.header, got.sequence, got.mode) == (expected.header, k, expected.mode)
        for member in ("equilibrium", "preset", "damping", "motor"):
            assert bits(getattr(got, member)) == bits(getattr(expected, member))


LENGTHS = st.integers(0, 3)


@given(
    st.sampled_from([StiffnessEstimate, DampingEstimate, MotorEstimate]), LENGTHS, LENGTHS, TEXTS, TEXTS, STAMPS,
    st.integers(0, 2**64 - 1), st.integers(0, 255), st.data(),
)  # fmt: skip
def test_a_template_writes_the_bytes_of_ros(kind, first, second, frame, method, stamp, sequence, status, data):
    message = kind(method=method)
    message.header.frame_id = frame
    doubles = [name for name, type_ in message.get_fields_and_field_types().items() if "double" in type_]
    for name, length in zip(doubles, [first, second, first, second], strict=False):
        if isinstance(getattr(message, name), array.array):
            setattr(message, name, [0.0] * length)
    template = Template(message)
    places = {name: template.places(name) for name in doubles}
    flat = np.array([at for each in places.values() for at in each], dtype=np.intp)
    values = np.array(data.draw(st.lists(DOUBLES, min_size=len(flat), max_size=len(flat))), dtype=np.float64)
    set_stamp(message.header.stamp, stamp)
    template.doubles[flat] = values
    written = template.numbered(stamp_bytes(stamp), sequence, bytes([status]))
    got = deserialize_message(written, kind)
    assert (got.header, got.sequence, got.status, got.method) == (message.header, sequence, status, method)
    assert bits(values) == bits([each for name in doubles for each in np.atleast_1d(getattr(got, name))])
    assert template.numbered(bytes(8), 0, b"\0") != written or (stamp, sequence, status) == (0, 0, 0)


@pytest.mark.parametrize("kind", [StiffnessEstimate, DampingEstimate, MotorEstimate])
def test_written_messages_are_not_overwritten(kind):
    template = Template(kind())
    first = template.numbered(bytes(8), 1, b"\0")
    template.numbered(bytes(8), 2, b"\0")
    assert deserialize_message(first, kind).sequence == 1


@given(st.lists(TEXTS, max_size=3), LENGTHS, TEXTS, STAMPS, st.data())
def test_a_template_with_lists_of_texts_writes_the_bytes_of_ros(names, motors, frame, stamp, data):
    message = ControlState(name=names, unit=names, method=frame, torque_limit=[1.0] * motors)
    message.header.frame_id = frame
    message.value = array.array("d", data.draw(st.lists(DOUBLES, min_size=len(names), max_size=len(names))))
    template = Template(message)
    values = data.draw(st.lists(DOUBLES, min_size=len(names), max_size=len(names)))
    template.view("value")[:] = values
    set_stamp(message.header.stamp, stamp)
    got = deserialize_message(template.numbered(stamp_bytes(stamp), 7, bytes([2, 5])), ControlState)
    assert (got.header, got.sequence, got.activity, got.limited) == (message.header, 7, 2, 5)
    assert (got.name, got.unit, got.method, list(got.torque_limit)) == (names, names, frame, [1.0] * motors)
    assert bits(got.value) == bits(values)


@given(TEXTS, st.lists(TEXTS, max_size=4), STAMPS, st.data())
def test_joint_states_written_as_bytes_are_those_that_ros_writes(frame, names, stamp, data):
    writer = StateWriter(frame, names)
    serialised = JointStateBytes(writer)
    for field in ("position", "velocity", "effort"):
        getattr(writer, field)[:] = data.draw(st.lists(DOUBLES, min_size=len(names), max_size=len(names)))
    got = deserialize_message(serialised.stamped(stamp), JointState)
    expected = writer.stamped(stamp)
    assert (got.header, got.name) == (expected.header, expected.name)
    for field in ("position", "velocity", "effort"):
        assert bits(getattr(got, field)) == bits(getattr(expected, field))
