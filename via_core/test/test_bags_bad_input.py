"""Bad input to bags: full disks, invalid stamps, invalid metadata. Each gives one line and no partial bag."""

from __future__ import annotations

import resource
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from via_core.bags.definitions import definition_of, typestore_of
from via_core.bags.importing import import_recordings
from via_core.bags.inspection import check
from via_core.bags.mapping import load_mapping
from via_core.bags.reader import read_bag
from via_core.bags.recovery import recover
from via_core.bags.writer import BagWriter, OfferedQos
from via_core.errors import BagError, ImportMapError

FLOAT = "std_msgs/msg/Float64"
SAMPLE = Path(__file__).resolve().parents[1] / "via_core" / "samples" / "maccepavd"
RECORDING, COMMANDS = "constant/record/record_traj1_3.csv", "constant/command/traj1.csv"


def payload(value: float) -> bytes:
    return b"\0\1\0\0" + np.float64(value).tobytes()


@contextmanager
def files_no_larger_than(size):
    """The kernel refuses to write on, as it does on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def fill(writer, messages=40_000):
    """Write what does not compress."""
    rng = np.random.default_rng(0)
    for k in range(messages):
        writer.write("/x", payload(rng.normal()), log_time=k)


def record_too_much(path):
    with BagWriter(path) as out:
        out.add_topic("/x", FLOAT)
        fill(out)


def test_a_full_disk_raises_bag_error_and_leaves_the_unfinished_file(tmp_path):
    with files_no_larger_than(200_000), pytest.raises(BagError, match=r"cannot write the bag .*run: File too large"):
        record_too_much(tmp_path / "run")
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run_0.mcap.active"]
    saved = read_bag(tmp_path / "run")
    assert not saved.complete
    assert len(saved) > 1000


def test_a_disk_that_fills_during_close_leaves_no_finished_bag(tmp_path):
    writer = BagWriter(tmp_path / "run")
    writer.add_topic("/x", FLOAT)
    fill(writer, 1000)
    with files_no_larger_than(4096), pytest.raises(BagError, match="File too large"):
        writer.close()
    writer.abandon()
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run_0.mcap.active"]


def test_discarding_on_a_full_disk_leaves_nothing(tmp_path):
    with files_no_larger_than(4096):
        writer = BagWriter(tmp_path / "run")
        writer.add_topic("/x", FLOAT)
        with pytest.raises(BagError):
            fill(writer)
        writer.discard()
    assert not (tmp_path / "run").exists()


def foreign(path, messages, qos=""):
    """An MCAP file of (data, log_time, publish_time) by another writer."""
    definition = definition_of(FLOAT)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(FLOAT, "ros2msg", definition.text.encode())
        channel = writer.register_channel("/x", "cdr", schema, {"offered_qos_profiles": qos})
        for data, log_time, publish_time in messages:
            writer.add_message(channel, log_time, data, publish_time)
        writer.finish()
    return path


def test_recover_skips_and_counts_invalid_messages(tmp_path):
    good = (payload(1.0), 5, 5)
    path = foreign(
        tmp_path / "a.mcap", [good, (b"", 6, 6), (payload(2.0), 2**64 - 1, 7), (payload(3.0), 8, 2**63), good]
    )
    done = recover(path, tmp_path / "out")
    assert dict(done.messages) == {"/x": 2}
    assert "3 messages are invalid" in done.remarks[-1]
    again = read_bag(tmp_path / "out")
    assert again.complete and "3 messages" in again.metadata["recovered_without"]


def test_a_name_that_is_not_utf8_is_refused(tmp_path):
    with pytest.raises(BagError, match="is not UTF-8"):
        BagWriter(tmp_path / "b\udcff")
    assert not list(tmp_path.iterdir())


def test_recover_without_intact_messages_writes_no_bag(tmp_path):
    path = foreign(tmp_path / "a.mcap", [(b"", 6, 6)])
    with pytest.raises(BagError, match="no intact message: 1 messages are invalid"):
        recover(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["a: 2020-13-45", "[" * 3000, "rosbag2_bagfile_information: 2020-01-99"])
def test_invalid_metadata_is_a_remark(tmp_path, text):
    with BagWriter(tmp_path / "run") as out:
        out.add_topic("/x", FLOAT)
        out.write("/x", payload(1.0), 1)
    (tmp_path / "run" / "metadata.yaml").write_text(text, encoding="utf-8")
    bag = read_bag(tmp_path / "run")
    assert (len(bag), bag.complete) == (1, False)
    assert "the metadata of the bag is invalid" in bag.remarks


@pytest.mark.parametrize("text", ["- {depth: .inf, reliability: 1, durability: 1, history: 1}", "- 2020-13-45", "5"])
def test_invalid_qos_texts_become_the_default(text):
    assert OfferedQos.from_rosbag2(text) == (OfferedQos(),)


@pytest.mark.parametrize("text", ["title: 2020-13-45", "[" * 3000, ":", "5"])
def test_invalid_mapping_files_give_one_line(tmp_path, text):
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ImportMapError, match=r"m\.yaml") as error:
        load_mapping(path)
    assert "\n" not in str(error.value)


def imported(tmp_path, file, row, text):
    """Import one run of the sample, the time in `row` of one of its files replaced by `text`."""
    for name, column in ((RECORDING, 1), (COMMANDS, 0)):
        lines = (SAMPLE / name).read_text(encoding="utf-8").splitlines()
        if name == file:
            cells = lines[row].split(",")
            cells[column] = text
            lines[row] = ",".join(cells)
        (tmp_path / "in" / name).parent.mkdir(parents=True)
        (tmp_path / "in" / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return import_recordings(tmp_path / "in", "maccepavd", tmp_path / "out").files[0]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("text", ["1e308", "-1e308", "1e19", "1e10", "nan", "inf"])
def test_an_invalid_stamp_discards_only_its_own_sample(tmp_path, text):
    done = imported(tmp_path, RECORDING, 50, text)
    assert done.accepted
    assert any("1 of 325 stamps" in finding.text for finding in done.findings)
    stamp = read_bag(done.bag)["/joint_states"].stamp
    assert len(stamp) == 324
    assert 0 <= stamp[0] < stamp[-1] < 2 * 10**9


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("text", ["1e308", "1e10"])
def test_an_invalid_command_stamp_refuses_the_run_with_a_reason(tmp_path, text):
    done = imported(tmp_path, COMMANDS, 40, text)
    assert not done.accepted
    assert any("command stamps are invalid" in reason for reason in done.reasons)
    assert not list((tmp_path).glob("out/*"))


@pytest.mark.filterwarnings("error")
def test_check_accepts_the_largest_numbers_without_numpy_warnings(tmp_path):
    definition = definition_of("sensor_msgs/msg/JointState")
    store = typestore_of(definition.type_name)
    time = store.types["builtin_interfaces/msg/Time"](0, 0)
    header = store.types["std_msgs/msg/Header"](time, "")
    with BagWriter(tmp_path / "run") as out:
        out.add_topic("/joint_states", definition.type_name)
        for k in range(50):
            position = np.array([1e-3 * k if k < 20 else (-1) ** k * 1e308])
            message = store.types[definition.type_name](header, ["a"], position, np.empty(0), np.empty(0))
            out.write("/joint_states", store.serialize_cdr(message, definition.type_name), k)
    assert not [finding for finding in check(tmp_path / "run") if finding.check == "quantised"]


@pytest.mark.parametrize("name", ["../{strategy}", "/{strategy}", "a/{strategy}", "..", ".", "{strategy:.0}"])
def test_a_mapping_cannot_write_outside_the_output_folder(tmp_path, name):
    mapping = load_mapping("maccepavd")
    elsewhere = mapping.model_copy(update={"recordings": mapping.recordings.model_copy(update={"bag": name})})
    with pytest.raises(ImportMapError, match="not the name of one folder"):
        import_recordings(SAMPLE, elsewhere, tmp_path / "out")
    assert not list(tmp_path.iterdir())
