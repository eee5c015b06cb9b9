"""A written bag is readable by other libraries, and never incomplete under its final name."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from via_core.bags.definitions import definition_of, typestore_of
from via_core.bags.writer import BagWriter, OfferedQos
from via_core.errors import BagError

JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state(stamp: int, names: list[str], position: np.ndarray) -> bytes:
    store = typestore_of(JOINT_STATE)
    types = store.types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    header = types["std_msgs/msg/Header"](time, "device")
    empty = np.zeros(0)
    return bytes(store.serialize_cdr(types[JOINT_STATE](header, names, position, empty, empty), JOINT_STATE))


def write_bag(path: Path, count: int = 500) -> list[bytes]:
    messages = [joint_state(i * 1_000_000, ["a", "bc"], np.array([i, -i]) * 0.1) for i in range(count)]
    with BagWriter(path, {"origin": "a test"}) as bag:
        bag.add_topic("/joint_states", JOINT_STATE, OfferedQos(depth=1000))
        bag.add_topic("/quiet", "std_msgs/msg/Float64")
        for i, message in enumerate(messages):
            bag.write("/joint_states", message, i * 1_000_000, sequence=i)
    return messages


def test_rosbags_reads_back_every_byte_and_the_description(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "run")
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 500
        topics = {each.topic: each for each in reader.connections}
        assert topics["/joint_states"].msgtype == JOINT_STATE
        assert topics["/joint_states"].digest == definition_of(JOINT_STATE).type_hash
        assert topics["/joint_states"].ext.offered_qos_profiles[0].depth == 1000
        assert topics["/quiet"].msgcount == 0
        assert [bytes(data) for _, _, data in reader.messages()] == messages


def test_mcap_ros2_support_decodes_from_the_schemas_in_the_file(tmp_path: Path) -> None:
    write_bag(tmp_path / "run", 20)
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = [message for _, _, _, message in reader.iter_decoded_messages()]
        channel = next(iter(reader.get_summary().channels.values()))
        schema = reader.get_summary().schemas[channel.schema_id]
    assert [message.position[1] for message in decoded] == [-i * 0.1 for i in range(20)]
    assert decoded[3].header.stamp.nanosec == 3_000_000
    assert schema.encoding == "ros2msg"
    assert "MSG: std_msgs/Header" in schema.data.decode()
    assert channel.metadata["topic_type_hash"] == definition_of(JOINT_STATE).type_hash
    assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["reliability"] == "reliable"


def test_metadata_is_version_nine_and_agrees_with_the_copy_in_the_file(tmp_path: Path) -> None:
    write_bag(tmp_path / "run", 20)
    text = (tmp_path / "run" / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["run_0.mcap"]
    assert information["duration"]["nanoseconds"] == 19_000_000
    assert information["custom_data"] == {"origin": "a test"}
    assert "&" not in text and "*" not in text
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        copies = [each.metadata["serialized_metadata"] for each in make_reader(stream).iter_metadata()]
    assert [yaml.safe_load(copy) for copy in copies] == [information]


def test_type_hash_is_the_published_one() -> None:
    # ros-jazzy-sensor-msgs 5.3.6, share/sensor_msgs/msg/JointState.json
    expected = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    assert definition_of(JOINT_STATE).type_hash == expected


def test_an_open_bag_has_no_final_name_and_an_exception_leaves_it_so(tmp_path: Path) -> None:
    def interrupted() -> None:
        with BagWriter(tmp_path / "run") as bag:
            bag.add_topic("/joint_states", JOINT_STATE)
            bag.write("/joint_states", joint_state(0, ["a"], np.zeros(1)), 0)
            assert [path.name for path in bag.path.iterdir()] == ["run_0.mcap.active"]
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run_0.mcap.active"]


def test_discard_leaves_nothing_and_closes(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "run")
    bag.discard()
    bag.close()
    with pytest.raises(BagError, match="closed"):
        bag.add_topic("/a", "std_msgs/msg/Float64")
    assert list(tmp_path.iterdir()) == []


def test_misuse_raises_with_the_reason(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as bag:
        bag.add_topic("/a", "std_msgs/msg/Float64")
        bag.add_topic("/a", "std_msgs/msg/Float64")
        with pytest.raises(BagError, match="/a is std_msgs/msg/Float64"):
            bag.add_topic("/a", JOINT_STATE)
        with pytest.raises(BagError, match="no definition of message type 'nobody_msgs/msg/Nothing'"):
            bag.add_topic("/b", "nobody_msgs/msg/Nothing")
        with pytest.raises(BagError, match="/b was not declared"):
            bag.write("/b", bytes(12), 0)
        with pytest.raises(BagError, match="negative time -1 ns"):
            bag.write("/a", bytes(12), -1)
        with pytest.raises(BagError, match="3 bytes"):
            bag.write("/a", bytes(3), 0)
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "run")
    assert bag.messages() == {"/a": 0}


def test_definitions_come_from_an_installed_share_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "planted_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Inner.msg").write_text("float64 value  # [rad]\n")
    (folder / "Outer.msg").write_text("std_msgs/Header header\nInner[] inner\nuint8 OK=0\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    definition = definition_of("planted_msgs/msg/Outer")
    assert definition.text.startswith("std_msgs/Header header\nInner[] inner\n")
    for name in ("std_msgs/Header", "builtin_interfaces/Time", "planted_msgs/Inner"):
        assert definition.text.count(f"MSG: {name}\n") == 1
    assert "# [rad]" in definition.text
