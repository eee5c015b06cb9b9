"""Unfinished and damaged bags: intact parts are read and missing ones reported, wherever the file ends."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader
from via_core.bags.definitions import definition_of, typestore_of
from via_core.bags.inspection import check, info
from via_core.bags.reader import Bag, read_bag
from via_core.bags.recovery import recover
from via_core.bags.writer import BagWriter, OfferedQos
from via_core.errors import BagError

FLOAT64 = "std_msgs/msg/Float64"
STORE = typestore_of(FLOAT64)
COUNT = 4000
CHUNK_RECORD = 6


def float64(value: float) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[FLOAT64](value), FLOAT64))


def read_or_reason(path: Path) -> Bag | str:
    try:
        return read_bag(path)
    except BagError as error:
        return str(error)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A finished file: numbers that do not repeat, in several chunks."""
    path = tmp_path_factory.mktemp("whole") / "run"
    numbers = np.random.default_rng(0).normal(size=COUNT)
    with BagWriter(path) as bag:
        bag.add_topic("/numbers", FLOAT64, OfferedQos(reliability="best_effort", durability="transient_local", depth=7))
        for k, number in enumerate(numbers):
            bag.write("/numbers", float64(number), 1000 * k, publish_time=1000 * k - k % 3, sequence=k)
    return (path / "run_0.mcap").read_bytes()


@pytest.fixture(scope="module")
def numbers(whole: bytes, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    path = tmp_path_factory.mktemp("numbers") / "run.mcap"
    path.write_bytes(whole)
    return read_bag(path)["/numbers"]["data"]


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, begin and end of every record, by the slow obvious walk."""
    found, at = [], 8
    while at + 9 <= len(data) - 8:
        length = struct.unpack_from("<Q", data, at + 1)[0]
        found.append((data[at], at, at + 9 + length))
        at += 9 + length
    return found


def test_the_fixture_has_several_chunks(whole: bytes, numbers: np.ndarray) -> None:
    assert [opcode for opcode, _, _ in records(whole)].count(CHUNK_RECORD) >= 3
    assert len(numbers) == COUNT


@settings(max_examples=150, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
@example(share=0.9999)
def test_a_file_truncated_anywhere_gives_its_intact_beginning_and_a_remark(
    whole: bytes, numbers: np.ndarray, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    end = int(share * len(whole))
    path = tmp_path_factory.mktemp("cut") / "run.mcap"
    path.write_bytes(whole[:end])
    whole_chunks = [(begin, stop) for opcode, begin, stop in records(whole) if opcode == CHUNK_RECORD and stop <= end]
    bag = read_or_reason(path)
    if isinstance(bag, str):
        assert "\n" not in bag and not whole_chunks
        return
    ending = "not finished" if end < len(whole) - 8 else "no valid end"  # of 8 bytes
    assert not bag.complete and ending in bag.remarks[0]
    if not whole_chunks:
        assert len(bag) == 0 or len(bag["/numbers"]) < COUNT
        return
    read = bag["/numbers"]["data"]
    np.testing.assert_array_equal(read, numbers[: len(read)])
    expected = sum(struct.unpack_from("<Q", whole, begin + 25)[0] for begin, _ in whole_chunks)  # uncompressed bytes
    assert 0 <= expected - len(read) * (9 + 22 + 12) < 1000  # every message of every whole chunk, beside descriptions


@settings(max_examples=100, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True), value=st.integers(1, 255))
def test_one_wrong_byte_never_gives_a_wrong_number_without_a_remark(
    whole: bytes, numbers: np.ndarray, tmp_path_factory: pytest.TempPathFactory, share: float, value: int
) -> None:
    at = int(share * len(whole))
    damaged = bytearray(whole)
    damaged[at] ^= value
    path = tmp_path_factory.mktemp("wrong") / "run.mcap"
    path.write_bytes(damaged)
    assert_honest(path, numbers)


def test_wrong_bytes_in_the_heads_of_records(whole: bytes, numbers: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for _, begin, _ in records(whole):
        for at in range(begin, begin + 9):
            for value in (0, 1, 7, 255):
                path.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
                assert_honest(path, numbers)


def assert_honest(path: Path, numbers: np.ndarray) -> None:
    """Every number read is one that was written, and none is missing without a remark."""
    bag = read_or_reason(path)
    if isinstance(bag, str):
        assert "\n" not in bag
        return
    read = bag["/numbers"]["data"] if "/numbers" in bag else np.empty(0)
    assert np.isin(read, numbers).all()
    if bag.complete:
        np.testing.assert_array_equal(read, numbers)


def test_a_damaged_chunk_is_left_out_and_the_others_are_kept(whole: bytes, numbers: np.ndarray, tmp_path: Path) -> None:
    chunks = [(begin, end) for opcode, begin, end in records(whole) if opcode == CHUNK_RECORD]
    begin, end = chunks[1]
    damaged = bytearray(whole)
    damaged[(begin + end) // 2] ^= 0xFF
    (tmp_path / "run.mcap").write_bytes(damaged)
    bag = read_bag(tmp_path / "run.mcap")
    read = bag["/numbers"]["data"]
    assert f"chunk at byte {begin} is left out" in bag.remarks[0]
    assert bag.remarks[1:] == (f"the file holds {len(read)} messages, its statistics state {COUNT}",)
    assert 0 < len(read) < COUNT and np.isin(read, numbers).all() and read[-1] == numbers[-1]


def test_a_wrong_checksum_is_named(whole: bytes, tmp_path: Path) -> None:
    begin = next(begin for opcode, begin, _ in records(whole) if opcode == CHUNK_RECORD)
    damaged = bytearray(whole)
    damaged[begin + 9 + 24 : begin + 9 + 28] = struct.pack("<I", zlib.crc32(b"something else"))
    (tmp_path / "run.mcap").write_bytes(damaged)
    assert "its checksum differs" in read_bag(tmp_path / "run.mcap").remarks[0]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_messages_of_a_chunk_cut_in_two(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "run.mcap"
    values = np.random.default_rng(1).normal(size=40_000)
    with path.open("wb") as file:  # one large chunk, as other writers make them
        writer = Writer(file, chunk_size=1 << 26, compression=compression)
        writer.start(profile="ros2")
        schema = writer.register_schema(FLOAT64, "ros2msg", definition_of(FLOAT64).text.encode())
        channel = writer.register_channel("/numbers", "cdr", schema)
        for k, value in enumerate(values):
            writer.add_message(channel, k, float64(value), k)
        writer.finish()
    data = path.read_bytes()
    begin, end = next((begin, end) for opcode, begin, end in records(data) if opcode == CHUNK_RECORD)
    path.write_bytes(data[: begin + (end - begin) * 2 // 3])
    bag = read_bag(path)
    read = bag["/numbers"]["data"]
    assert len(values) / 3 < len(read) < len(values)
    np.testing.assert_array_equal(read, values[: len(read)])
    assert f"within the record at byte {begin}" in bag.remarks[0]


def test_recover_completes_the_bag_of_a_killed_recorder(numbers: np.ndarray, tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "run", {"who": "me"})
    bag.add_topic("/numbers", FLOAT64, OfferedQos(reliability="best_effort", durability="transient_local", depth=7))
    for k, number in enumerate(numbers):
        bag.write("/numbers", float64(number), 1000 * k, publish_time=1000 * k + k % 3, sequence=k)
    bag.abandon()
    unfinished = read_bag(tmp_path / "run")
    assert not unfinished.complete and len(unfinished) == COUNT
    assert any("metadata.yaml is missing" in remark for remark in unfinished.remarks)
    report = recover(tmp_path / "run", tmp_path / "mended")
    assert report.messages == {"/numbers": COUNT} and report.remarks == unfinished.remarks
    mended = read_bag(report.bag)
    assert mended.complete and mended.metadata["recovered_from"] == "run"
    topic = mended.topic("/numbers")
    assert list(topic.payloads()) == [float64(number) for number in numbers]
    np.testing.assert_array_equal(topic.publish_time - topic.log_time, np.arange(COUNT) % 3)
    assert OfferedQos.from_rosbag2(topic.qos) == (OfferedQos("best_effort", "transient_local", depth=7),)
    with Reader(report.bag) as reader:
        assert reader.message_count == COUNT
    with pytest.raises(BagError, match="exists already"):
        recover(tmp_path / "run", tmp_path / "mended")


def test_a_growing_bag_is_read_up_to_its_last_complete_chunk(numbers: np.ndarray, tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "run")
    bag.add_topic("/numbers", FLOAT64)
    for k, number in enumerate(numbers):
        bag.write("/numbers", float64(number), 1000 * k)
    seen = read_bag(tmp_path / "run")  # what a killed recorder would leave: nothing was flushed by hand
    bag.close()
    read = seen["/numbers"]["data"]
    np.testing.assert_array_equal(read, numbers[: len(read)])
    assert COUNT / 2 < len(read) < COUNT and not seen.complete
    assert read_bag(tmp_path / "run").complete


def test_qos_policies_of_older_bags_are_numbers() -> None:
    old = "- {history: 3, depth: 0, reliability: 2, durability: 1, deadline: {sec: 1, nsec: 0}}"
    assert OfferedQos.from_rosbag2(old) == (OfferedQos("best_effort", "transient_local", "unknown", 0),)
    for text in ("", "nonsense", "- 3", ": ["):
        assert OfferedQos.from_rosbag2(text) == (OfferedQos(),)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"SQLite format 3\x00", "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "ends before its first record"),
        (b"\x89MCAP0\r\n" + bytes(500), "ends before its first record"),
    ],
)
def test_files_that_are_not_mcap_give_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    for look in (read_bag, info, check):
        with pytest.raises(BagError, match=words) as error:
            look(path)
        assert "\n" not in str(error.value)


def test_paths_without_a_bag_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="no bag at"):
        read_bag(tmp_path / "nowhere")
    with pytest.raises(BagError, match=r"holds neither an \.mcap nor a \.db3 file"):
        read_bag(tmp_path)
    (tmp_path / "old_0.db3").write_bytes(b"SQLite")
    with pytest.raises(BagError, match=r"old_0\.db3 cannot be read"):
        read_bag(tmp_path)


def foreign(path: Path, message_encoding: str, schema_encoding: str, schema_text: bytes) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="somebody")
        schema = writer.register_schema("some/msg/Thing", schema_encoding, schema_text)
        channel = writer.register_channel("/thing", message_encoding, schema)
        writer.add_message(channel, 1, b"{}", 1)
        schema = writer.register_schema(FLOAT64, "ros2msg", definition_of(FLOAT64).text.encode())
        writer.add_message(writer.register_channel("/numbers", "cdr", schema), 2, float64(2.0), 2)
        writer.add_message(writer.register_channel("/bare", "cdr", 0), 2, float64(2.0), 2)
        writer.finish()


@pytest.mark.parametrize(
    ("message_encoding", "schema_encoding", "text", "words"),
    [
        ("json", "jsonschema", b"{}", "json messages, jsonschema schema"),
        ("cdr", "ros2idl", b"module", "cdr messages, ros2idl schema"),
        ("cdr", "ros2msg", b"this is nothing !", "is invalid"),
        ("cdr", "ros2msg", b"unknown_msgs/Nothing x\n", "left out"),
        ("cdr", "ros2msg", b"\xff\xfe", "left out"),
    ],
)
def test_topics_of_foreign_formats_are_left_out_by_name(
    tmp_path: Path, message_encoding: str, schema_encoding: str, text: bytes, words: str
) -> None:
    foreign(tmp_path / "run.mcap", message_encoding, schema_encoding, text)
    bag = read_bag(tmp_path / "run.mcap")
    assert bag["/numbers"]["data"].tolist() == [2.0]
    assert list(bag.topics) == ["/numbers"] and not bag.complete
    assert any(remark.startswith("topic /thing") and words in remark for remark in bag.remarks)
    assert any("/bare is left out: no schema" in remark for remark in bag.remarks)
    assert [finding.text for finding in check(tmp_path / "run.mcap") if finding.check == "file"] == list(bag.remarks)


def test_a_file_with_nothing_readable_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/thing", "json", 0), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(BagError, match="no readable topic"):
        read_bag(tmp_path / "run.mcap")


def test_a_split_bag_with_one_lost_part_reads_the_rest(whole: bytes, numbers: np.ndarray, tmp_path: Path) -> None:
    for k in (0, 1, 2, 10):
        (tmp_path / f"run_{k}.mcap").write_bytes(whole)
    (tmp_path / "run_1.mcap").write_bytes(b"")
    bag = read_bag(tmp_path)
    np.testing.assert_array_equal(bag["/numbers"]["data"], np.tile(numbers, 3))
    assert "run_1.mcap is empty" in bag.remarks
    order = [message.sequence for message in bag.in_file_order()]
    assert order == list(range(COUNT)) * 3
