"""Columns equal those of a slow decoder that reads message by message, for messages of any layout."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from via_core.bags.definitions import definition_of, typestore_of
from via_core.bags.inspection import check
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.errors import BagError

JOINT_STATE = "sensor_msgs/msg/JointState"
STORE = typestore_of(JOINT_STATE)
TYPES = STORE.types

numbers = st.lists(st.floats(allow_nan=False, width=64), max_size=4)
texts = st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=9), max_size=3)
rows = st.lists(st.tuples(st.integers(0, 2**40), st.text("abc", max_size=5), texts, numbers, numbers), max_size=6)


def joint_state(
    stamp: int, names: list[str], position: list[float], velocity: list[float] = (), frame: str = "d"
) -> bytes:
    header = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), frame)
    message = TYPES[JOINT_STATE](header, names, np.array(position, float), np.array(velocity, float), np.zeros(0))
    return bytes(STORE.serialize_cdr(message, JOINT_STATE))


def write(path: Path, messages: list[bytes], topic: str = "/joint_states", type_name: str = JOINT_STATE) -> None:
    with BagWriter(path) as bag:
        bag.add_topic(topic, type_name)
        for k, message in enumerate(messages):
            bag.write(topic, message, 10 * k, sequence=k)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=rows, repeats=st.integers(1, 3))
def test_columns_equal_the_slow_decoder(tmp_path_factory: pytest.TempPathFactory, rows: list, repeats: int) -> None:
    path = tmp_path_factory.mktemp("bags") / "run"
    write(path, [joint_state(t, n, p, v, frame) for t, frame, n, p, v in rows for _ in range(repeats)])
    states = read_bag(path)["/joint_states"]
    with (path / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        slow = [message for _, _, _, message in reader.iter_decoded_messages()]
    assert len(states) == len(slow) == len(rows) * repeats
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in slow]
    if len(slow) > 1 and not any(stamps):  # unset: the times of the log, see `write`
        stamps = [10 * k for k in range(len(slow))]
    assert states.stamp.tolist() == stamps
    for k, message in enumerate(slow):
        assert states["name"][k] == tuple(message.name)
        assert states["header.frame_id"][k] == message.header.frame_id
        assert states["header.stamp.sec"][k] == message.header.stamp.sec
        for field in ("position", "velocity", "effort"):
            np.testing.assert_array_equal(states[field][k], getattr(message, field))


def test_one_layout_is_read_by_offset_and_a_changed_name_is_noticed(tmp_path: Path) -> None:
    same = [joint_state(k, ["a", "bcd"], [k, -k]) for k in range(1, 3000)]
    write(tmp_path / "same", same)
    renamed = same.copy()
    renamed[2000] = joint_state(2000, ["a", "bxd"], [1.0, 2.0])  # same length, other text
    write(tmp_path / "renamed", renamed)
    fast = read_bag(tmp_path / "same")["/joint_states"]
    careful = read_bag(tmp_path / "renamed")["/joint_states"]
    assert fast.by_offset and not careful.by_offset
    assert careful["name"][2000] == ("a", "bxd") and careful["name"][1999] == ("a", "bcd")
    assert fast["position"].shape == careful["position"].shape == (2999, 2)
    keep = np.arange(2999) != 2000
    for name in fast.fields:
        assert fast[name].dtype == careful[name].dtype
        np.testing.assert_array_equal(fast[name][keep], careful[name][keep])


def test_equal_sizes_with_numbers_moved_between_members_fall_back(tmp_path: Path) -> None:
    write(tmp_path / "run", [joint_state(1, ["a"], [1.0, 2.0], []), joint_state(2, ["a"], [3.0], [4.0])])
    states = read_bag(tmp_path / "run")["/joint_states"]
    assert not states.by_offset
    assert [list(each) for each in states["position"]] == [[1.0, 2.0], [3.0]]
    assert [list(each) for each in states["velocity"]] == [[], [4.0]]


def test_padding_bytes_may_differ(tmp_path: Path) -> None:
    plain = joint_state(1, ["ab"], [1.0, 2.0])
    at = plain.index(b"ab\x00") + 3
    soiled = plain[:at] + b"\xee" + plain[at + 1 :]
    assert plain[at] == 0
    write(tmp_path / "run", [plain, soiled])
    states = read_bag(tmp_path / "run")["/joint_states"]
    assert states.by_offset
    np.testing.assert_array_equal(states["position"], [[1.0, 2.0], [1.0, 2.0]])


@pytest.mark.parametrize("type_name", ["std_msgs/msg/Bool", "std_msgs/msg/Int16MultiArray", "std_msgs/msg/Empty",
                                       "diagnostic_msgs/msg/DiagnosticArray", "geometry_msgs/msg/PoseWithCovariance",
                                       "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage"])  # fmt: skip
def test_other_types_read_by_offset_or_not_give_the_decoded_values(tmp_path: Path, type_name: str) -> None:
    store = typestore_of(type_name)
    rng = np.random.default_rng(3)
    messages = [bytes(store.serialize_cdr(_random(store, type_name, rng), type_name)) for _ in range(5)]
    write(tmp_path / "run", messages, "/t", type_name)
    columns = read_bag(tmp_path / "run")["/t"]
    assert len(columns) == 5
    for k, raw in enumerate(messages):
        message = store.deserialize_cdr(raw, type_name)
        for name, values in columns.fields.items():
            value = message
            for part in name.split("."):
                value = getattr(value, part)
            if isinstance(value, list):
                assert repr(values[k]) == repr(tuple(value))
            else:
                np.testing.assert_array_equal(values[k], value)


def _random(store, type_name: str, rng: np.random.Generator):
    def single(kind: int, inner) -> object:
        if kind == 2:
            return _random(store, inner, rng)
        base = inner[0]
        if base == "string":
            return "text"
        if base == "bool":
            return bool(rng.integers(2))
        return float(rng.normal()) if base.startswith("float") else int(rng.integers(100))

    members = {}
    for name, (kind, inner) in store.fielddefs[type_name][1]:
        if kind in (1, 2):
            members[name] = single(kind, inner)
            continue
        (element, element_type), count = inner
        values = [single(element, element_type) for _ in range(count or 2)]
        plain = element == 1 and element_type[0] != "string"
        members[name] = np.array(values, dtype=element_type[0]) if plain else values
    return store.types[type_name](**members) if members else store.types[type_name]()


def test_messages_come_in_stamp_order_and_equal_stamps_in_file_order(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as bag:
        bag.add_topic("/b", JOINT_STATE)
        bag.add_topic("/a", JOINT_STATE)
        bag.add_topic("/unstamped", "std_msgs/msg/Float64")
        written = [("/b", 5), ("/a", 5), ("/a", 3), ("/b", 9), ("/a", 9), ("/b", 3)]
        for k, (topic, stamp) in enumerate(written):
            bag.write(topic, joint_state(stamp, [topic], [k]), 100 + k)
        bag.write("/unstamped", b"\x00\x01\x00\x00" + bytes(8), 4)
    bag = read_bag(tmp_path / "run")
    order = [(message.topic, message.stamp) for message in bag.in_stamp_order()]
    assert order == [("/a", 3), ("/b", 3), ("/unstamped", 4), ("/b", 5), ("/a", 5), ("/b", 9), ("/a", 9)]
    only = [(message.topic, message.log_time) for message in bag.in_stamp_order(["/b"])]
    assert only == [("/b", 105), ("/b", 100), ("/b", 103)]


def test_rerecording_gives_the_same_bytes(tmp_path: Path) -> None:
    messages = [joint_state(k, ["a"], [k]) for k in range(50)]
    write(tmp_path / "run", messages)
    bag = read_bag(tmp_path / "run")
    with BagWriter(tmp_path / "again") as out:
        for topic in bag.topics.values():
            out.add_topic(topic.name, topic.type_name, definition=topic.definition)
        for message in bag.in_stamp_order():
            out.write(message.topic, message.data, message.log_time, sequence=message.sequence)
    again = read_bag(tmp_path / "again")
    assert list(again.topic("/joint_states").payloads()) == messages
    assert again.topic("/joint_states").definition == definition_of(JOINT_STATE)
    np.testing.assert_array_equal(again.topic("/joint_states").sequence, np.arange(50))


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_files_of_other_writers(tmp_path: Path, compression: CompressionType, chunked: bool) -> None:
    path = tmp_path / "foreign.mcap"
    definition = definition_of(JOINT_STATE)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=300, compression=compression, use_chunking=chunked)
        writer.start(profile="", library="somebody else's")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.text.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for k in range(40):
            writer.add_message(channel, k, joint_state(k, ["a"], [k]), k)
        writer.finish()
    bag = read_bag(path)
    assert bag.complete and bag.remarks == ()
    np.testing.assert_array_equal(bag["/joint_states"]["position"][:, 0], np.arange(40))


def test_only_the_wanted_topics_are_kept(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", {"who": "me"}) as bag:
        bag.add_topic("/a", JOINT_STATE)
        bag.add_topic("/b", JOINT_STATE)
        bag.write("/a", joint_state(1, ["a"], [1.0]), 1)
        bag.write("/b", joint_state(1, ["a"], [1.0]), 1)
    bag = read_bag(tmp_path / "run", topics=["/b"])
    assert list(bag.topics) == ["/b"] and len(bag) == 1 and bag.metadata == {"who": "me"}
    with pytest.raises(BagError, match="no topic /a"):
        bag["/a"]
    with pytest.raises(BagError, match="no member 'torque'"):
        bag["/b"]["torque"]


def test_an_invalid_message_is_skipped_and_listed(tmp_path: Path) -> None:
    write(tmp_path / "run", [joint_state(0, ["a"], [1.0]), b"\x00\x01\x00\x00\xff", joint_state(2, ["a"], [3.0])])
    bag = read_bag(tmp_path / "run")
    states = bag["/joint_states"]
    assert states["position"].tolist() == [[1.0], [3.0]] and len(states) == len(states.log_time) == 2
    assert len(states.left_out) == 1
    assert states.left_out[0].startswith("message 1 of /joint_states is not a sensor_msgs/msg/JointState")
    assert any("message 1 of" in finding.text for finding in check(tmp_path / "run"))
    assert [message.data[4:] for message in bag.in_file_order()][1] == b"\xff"


def test_a_topic_without_valid_messages_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "run", [b"\x00\x01\x00\x00\xff", b"\x00\x01\x00\x00\xfe\xff"])
    with pytest.raises(BagError, match="message 0 of /joint_states is not a sensor_msgs/msg/JointState"):
        read_bag(tmp_path / "run")["/joint_states"]


def test_topic_helpers_agree(tmp_path: Path) -> None:
    write(tmp_path / "run", [joint_state(7 * k, ["a"], [k]) for k in range(4)])
    topic = read_bag(tmp_path / "run").topic("/joint_states")
    assert SimpleNamespace(n=len(topic), t=topic.stamp.tolist()) == SimpleNamespace(n=4, t=[0, 7, 14, 21])


def test_unused_bytes_at_the_end_are_ignored(tmp_path: Path) -> None:
    # Fast DDS: serialize_message(JointState(name=['a'], velocity=[1.0])) is 4 bytes longer than its content
    plain = [joint_state(k, ["a"], [], [float(k)]) + b"\x80\x19gf" for k in range(3)]
    varied = [*plain, joint_state(3, ["a", "b"], [], [3.0]) + b"\x56\x7f\x00\x00\xc0\x8b\xf3f"]
    write(tmp_path / "plain", plain)
    write(tmp_path / "varied", varied)
    for path, by_offset in ((tmp_path / "plain", True), (tmp_path / "varied", False)):
        states = read_bag(path)["/joint_states"]
        assert states.by_offset is by_offset
        np.testing.assert_array_equal(states["velocity"][:, 0], np.arange(len(states)))
