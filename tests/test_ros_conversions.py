"""Conversions: bit-exact both ways, by name and not by position, NaN for missing values."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from ros_messages import CommandWriter, SampleReader
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_core.errors import BagError, ParameterError
from via_core.wire import SECOND, seconds
from via_interfaces import msg
from via_interfaces.msg import DampingEstimate, GapStatus, StiffnessEstimate, VsaCommand
from via_ros.conversions import (
    Command,
    JointStateWriter,
    Names,
    RowReader,
    command_of,
    joints_of,
    nanoseconds,
    set_stamp,
)
from via_ros.interfaces import NUMBERED, message_class, opening_of, stamp_of

DEVICE = load_device("cubic_aa_vsa")
COLUMNS = ("q", "theta_1", "tau_1", "theta_2", "tau_2", "q_velocity", "theta_velocity_2", "tau_link")
DOUBLES = st.floats(width=64)  # NaN with any payload, infinities, subnormals, both zeros
STAMPS = st.integers(-(2**31) * SECOND, 2**31 * SECOND - 1)  # [ns] all that builtin_interfaces/Time holds


def bits(values):
    return np.asarray(values, dtype=np.float64).view(np.uint64).tolist()


@given(STAMPS)
def test_stamps_pass_exactly(time):
    stamp = Time()
    set_stamp(stamp, time)
    assert nanoseconds(stamp) == time
    assert 0 <= stamp.nanosec < SECOND


@given(STAMPS, st.integers(0, 20 * 86_400 * SECOND))
def test_times_relative_to_an_origin_pass_exactly(origin, later):
    assert origin + round(seconds(origin + later, origin) * SECOND) == origin + later


def test_absolute_stamps_would_not_fit_into_a_float():
    stamp = 1_700_000_000_123_456_789
    assert round(seconds(stamp) * SECOND) != stamp


@given(st.lists(DOUBLES, min_size=9, max_size=9))
def test_a_row_is_serialised_bit_by_bit(values):
    writer = JointStateWriter(DEVICE)
    writer.position[:], writer.velocity[:], writer.effort[:] = values[:3], values[3:6], values[6:]
    message = deserialize_message(serialize_message(writer.stamped(5)), JointState)
    row = SampleReader(DEVICE, COLUMNS).read(message)
    q, theta_1, theta_2, q_velocity, _, theta_velocity_2, tau_link, tau_1, tau_2 = values
    assert bits(row[1:]) == bits([q, theta_1, tau_1, theta_2, tau_2, q_velocity, theta_velocity_2, tau_link])


@given(st.permutations([DEVICE.link_joint, *DEVICE.motor_joints, "other", "gripper"]))
def test_joints_are_found_by_name_in_any_order(names):
    numbers = {name: float(k) for k, name in enumerate([DEVICE.link_joint, *DEVICE.motor_joints])}
    message = JointState(name=names, position=[numbers.get(name, 99.0) for name in names])
    row = SampleReader(DEVICE, ("q", "theta_1", "theta_2")).read(message)
    assert row[1:].tolist() == [0.0, 1.0, 2.0]


def test_names_are_looked_up_again_when_they_change():
    reader = SampleReader(DEVICE, ("q", "theta_1", "theta_2"))
    link, first, second = DEVICE.link_joint, *DEVICE.motor_joints
    assert reader.read(JointState(name=[link, first, second], position=[0.0, 1.0, 2.0]))[1:].tolist() == [0, 1, 2]
    assert reader.read(JointState(name=[second, first, link], position=[2.0, 1.0, 0.0]))[1:].tolist() == [0, 1, 2]
    assert reader.read(JointState(name=["other"], position=[7.0])) is None
    missing = reader.read(JointState(name=[link, second], position=[0.0, 2.0]))[1:]
    assert bits(missing)[0::2] == bits([0.0, 2.0])
    assert np.isnan(missing[1])


@pytest.mark.parametrize("position", [[], [1.0], [1.0, 2.0], [1.0, 2.0, 3.0, 4.0]])
def test_arrays_of_wrong_length_are_nan_and_counted(position):
    reader = SampleReader(DEVICE, ("q", "theta_1", "theta_2"))
    names = [DEVICE.link_joint, *DEVICE.motor_joints]
    assert reader.read(JointState(name=names, position=[1.0, 2.0, 3.0]))[1:].tolist() == [1.0, 2.0, 3.0]
    assert np.all(np.isnan(reader.read(JointState(name=names, position=position))[1:]))
    assert reader.malformed == (len(position) != 0)


def test_row_times_count_from_the_first_sample():
    reader = SampleReader(DEVICE, ("q",))
    writer = JointStateWriter(DEVICE)
    start = 1_700_000_000_123_456_789
    assert [reader.read(writer.stamped(start + k * 1_000_001))[0] for k in range(3)] == [0.0, 0.001000001, 0.002000002]


def test_a_column_that_the_device_does_not_have_is_refused():
    with pytest.raises(ParameterError, match="theta_3"):
        SampleReader(DEVICE, ("q", "theta_3"))


@given(st.tuples(DOUBLES, DOUBLES, DOUBLES, DOUBLES, DOUBLES), st.sampled_from([0, 1, 2, 3, 255]), st.integers(0, 3))
def test_commands_pass_bit_by_bit_or_are_refused(numbers, mode, count):
    equilibrium, preset, damping, *motor = numbers
    motor = [*motor, 0.5][:count]
    sent = CommandWriter(DEVICE).numbered(7, Command(mode, equilibrium, preset, damping, np.array(motor)))
    got = command_of(deserialize_message(serialize_message(sent), VsaCommand), DEVICE.n_motors)
    if mode == VsaCommand.EQUILIBRIUM_PRESET:
        good = np.all(np.isfinite([equilibrium, preset, damping]))
    else:
        good = mode in (1, 2) and count == 2 and np.all(np.isfinite([damping, *motor]))
    assert (got is not None) == good
    if got is not None:
        assert bits([got.equilibrium, got.preset, got.damping]) == bits([equilibrium, preset, damping])
        assert bits(got.motor) == (bits(motor) if mode else [])


def test_commands_stay_in_the_rows_until_the_next_valid_one():
    reader = SampleReader(DEVICE, ("q", "damping", "motor_2"))
    state = JointStateWriter(DEVICE).stamped(0)
    assert np.all(np.isnan(reader.read(state)[2:]))
    commands = CommandWriter(DEVICE)
    assert reader.hold(commands.numbered(0, Command(2, 0.0, 0.0, 0.25, np.array([1.0, 2.0]))))
    assert reader.read(state)[2:].tolist() == [0.25, 2.0]
    assert not reader.hold(commands.numbered(0, Command(2, 0.0, 0.0, np.nan, np.array([3.0, 4.0]))))
    assert reader.read(state)[2:].tolist() == [0.25, 2.0]


def test_commands_are_numbered_without_a_gap():
    commands = CommandWriter(DEVICE)
    command = Command(0, 0.0, 0.0, 0.0, np.empty(0))
    assert [commands.numbered(k, command).sequence for k in range(3)] == [0, 1, 2]


@given(
    st.sampled_from([StiffnessEstimate, DampingEstimate, VsaCommand, GapStatus]),
    STAMPS,
    st.integers(0, 2**64 - 1),
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20),
)
def test_stamp_and_sequence_are_read_without_decoding(kind, time, sequence, frame):
    message = kind(sequence=sequence)
    set_stamp(message.header.stamp, time)
    message.header.frame_id = frame
    data = serialize_message(message)
    assert f"via_interfaces/msg/{kind.__name__}" in NUMBERED
    assert opening_of(data) == (time, sequence)
    assert stamp_of(data) == time


def test_every_type_with_a_sequence_number_is_numbered():
    """A recorder counts losses of these only."""
    assert "via_interfaces/msg/PayloadEstimate" in NUMBERED
    for name in (name for name in vars(msg) if name[0].isupper()):
        fields = list(getattr(msg, name).get_fields_and_field_types().items())
        numbered = f"via_interfaces/msg/{name}" in NUMBERED
        assert numbered == ("sequence" in dict(fields))
        assert not numbered or fields[:2] == [("header", "std_msgs/Header"), ("sequence", "uint64")]


def test_what_messages_lack_is_named():
    reader, names = RowReader([(DEVICE, COLUMNS)]), [DEVICE.link_joint, *DEVICE.motor_joints]

    def read(names, **fields):
        reader.read(joints_of(JointState(name=names, **fields), Names(())))

    assert reader.absent() == reader.missing(0) == ""
    read(["elbow", "wrist"], position=[0.0, 0.0])
    assert reader.foreign == 1 and reader.absent() == f"no {DEVICE.link_joint} in elbow, wrist"
    assert reader.missing(0) == ""
    read(names, position=[0.0] * 3, velocity=[0.0] * 3, effort=[0.0, 0.0, np.nan])
    assert reader.missing(0) == f"effort of {names[2]}"
    read(names[:2], position=[0.0] * 2, effort=[0.0] * 2)
    lacks = [("position", 2), ("effort", 2), ("velocity", 0), ("velocity", 2)]
    assert reader.missing(0) == ", ".join(f"{field} of {names[at]}" for field, at in lacks)
    read([f"{k}\x1b" for k in range(30)])
    assert reader.absent().endswith("19␛, ...")


@pytest.mark.parametrize("name", ["", "via_interfaces", "via_interfaces/msg/None", "no_msgs/msg/Thing", "a/b/c/d"])
def test_unknown_message_types_are_named(name):
    with pytest.raises(BagError, match="not installed"):
        message_class(name)


def test_cdr_is_little_endian_here():
    data = serialize_message(StiffnessEstimate(sequence=1))
    assert struct.unpack_from("<H", data, 0)[0] == 0x0100
