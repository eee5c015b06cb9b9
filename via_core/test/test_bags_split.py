"""Bags of several files: long recordings, finished, interrupted and with a file missing."""

import gc
from collections import Counter
from pathlib import Path

import pytest
import yaml
from mcap.records import ChunkIndex
from rosbags.rosbag2 import Reader
from via_core.bags.definitions import typestore_of
from via_core.bags.inspection import info
from via_core.bags.reader import read_bag
from via_core.bags.recovery import recover
from via_core.bags.writer import JUMPS, BagWriter
from via_core.errors import BagError
from via_core.limits import Limits

FLOAT64, BOOL = "std_msgs/msg/Float64", "std_msgs/msg/Bool"
SECOND = 10**9
SPLITS = 12  # more than nine: their order is that of their numbers, not of their names
PER_SPLIT = 20  # messages


def payload(k: int) -> bytes:
    store = typestore_of(FLOAT64)
    return bytes(store.serialize_cdr(store.types[FLOAT64](float(k)), FLOAT64))


def fill(bag: BagWriter, splits: int = SPLITS, begin: int = 0) -> None:
    """Messages `begin` seconds after the first one, one in 50 ms and in each chunk; a topic that is declared later."""
    bag.add_topic("/numbers", FLOAT64)
    for k in range(begin * PER_SPLIT, (begin + splits) * PER_SPLIT):
        if k == PER_SPLIT:
            bag.add_topic("/late", BOOL)
        bag.write("/numbers", payload(k), k * SECOND // PER_SPLIT, sequence=k)
        bag.flush()


def numbers(path: Path) -> list[int]:
    return [int(each) for each in read_bag(path)["/numbers"]["data"]]


@pytest.fixture
def split(tmp_path: Path) -> Path:
    with BagWriter(tmp_path / "run", {"origin": "a test"}, max_duration=1.0) as bag:
        fill(bag)
    return tmp_path / "run"


def test_every_message_is_read_in_order_by_this_and_another_library(split: Path) -> None:
    bag = read_bag(split)
    assert bag.complete and bag.metadata == {"origin": "a test"}
    assert numbers(split) == list(range(SPLITS * PER_SPLIT))
    assert [message.sequence for message in bag.in_file_order()] == list(range(SPLITS * PER_SPLIT))
    assert info(split).size == sum(file.stat().st_size for file in split.glob("*.mcap"))
    with Reader(split) as reader:
        assert [bytes(data) for _, _, data in reader.messages()] == [payload(k) for k in range(SPLITS * PER_SPLIT)]


def test_metadata_lists_the_files_and_each_file_is_a_bag_of_its_own(split: Path) -> None:
    information = yaml.safe_load((split / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == [f"run_{k}.mcap" for k in range(SPLITS)]
    assert information["message_count"] == SPLITS * PER_SPLIT
    assert information["duration"]["nanoseconds"] == SPLITS * SECOND - SECOND // PER_SPLIT
    counts = {
        each["topic_metadata"]["name"]: each["message_count"] for each in information["topics_with_message_count"]
    }
    assert counts == {"/numbers": SPLITS * PER_SPLIT, "/late": 0}
    for k, file in enumerate(information["files"]):
        assert file["message_count"] == PER_SPLIT
        assert file["starting_time"]["nanoseconds_since_epoch"] == k * SECOND
        assert numbers(split / file["path"]) == list(range(k * PER_SPLIT, (k + 1) * PER_SPLIT))
        alone = read_bag(split / file["path"])
        assert alone.complete and alone.topics.keys() == {"/numbers", "/late"}


def test_the_index_in_memory_is_that_of_the_present_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", max_duration=1.0) as bag:
        for begin in (0, 5):
            fill(bag, 5, begin)
            entries = Counter(type(each) for each in gc.get_objects())[ChunkIndex]
            assert 0 < entries <= PER_SPLIT


def test_an_interrupted_recording_has_its_finished_files_and_the_chunks_of_the_last_one(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "run", max_duration=1.0)
    fill(bag, 2)
    bag.metadata[JUMPS] = "1"
    fill(bag, 1, 2)
    bag.abandon()
    names = sorted(file.name for file in bag.path.iterdir())
    assert names == ["run_0.mcap", "run_1.mcap", "run_2.mcap.active"]
    expected = list(range(3 * PER_SPLIT))
    assert numbers(bag.path) == expected
    assert read_bag(bag.path).remarks == (
        "run_2.mcap.active: the file was not finished: it has no footer",
        "metadata.yaml is missing or cannot be read",
        "simulated time has jumped 1 times during the recording",
    )
    saved = recover(bag.path, tmp_path / "saved")
    assert numbers(saved.bag) == expected and read_bag(saved.bag).metadata[JUMPS] == "1"


def test_a_full_disk_at_the_end_of_a_file_leaves_what_was_written(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "run", max_duration=1.0)
    fill(bag, 1)
    (tmp_path / "run" / "run_1.mcap.active").mkdir()  # the next file cannot be opened
    with pytest.raises(BagError, match="cannot write the bag"):
        bag.write("/numbers", payload(0), 2 * SECOND)
    bag.abandon()
    assert numbers(tmp_path / "run" / "run_0.mcap") == list(range(PER_SPLIT))


def test_a_missing_file_is_reported(split: Path) -> None:
    (split / "run_3.mcap").unlink()
    bag = read_bag(split)
    assert not bag.complete and bag.remarks == ("run_3.mcap is missing",)
    assert len(bag) == (SPLITS - 1) * PER_SPLIT


def test_the_limit_of_memory_is_that_of_all_files(split: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = sum(len(payload(k)) + 31 for k in range(PER_SPLIT))  # [bytes] of one file, at least
    monkeypatch.setattr(Limits, "bag", property(lambda _: 8 * whole))
    bag = read_bag(split)
    assert 0 < len(bag) <= 8 * PER_SPLIT
    assert any("the bag exceeds" in remark for remark in bag.remarks)
