"""Files from others: each costs at most what `limits` allows, and a bad one is refused in one line of the project."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from via_core.arm_files import ArmFile, read_arm
from via_core.bags.definitions import typestore_from_text
from via_core.bags.importing import import_recordings
from via_core.bags.mapping import load_mapping
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter, OfferedQos
from via_core.command_files import read_table
from via_core.devices import load_device
from via_core.errors import BagError, DeviceError, ImportMapError, ViaError
from via_core.limits import LIMITS
from via_core.text_files import read_text, read_yaml, shown

MEMORY = 3 << 30  # [bytes] of address space for a child
ALIASES = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(9)
)
MERGES = (
    "a: &a {"
    + ", ".join(f"k{k}: 1" for k in range(50))
    + "}\n"
    + "".join(f"{chr(98 + k)}: &{chr(98 + k)}\n  <<: [{', '.join(['*' + chr(97 + k)] * 20)}]\n" for k in range(8))
)
BOMBS = {
    "aliases": ALIASES,
    "merges": MERGES,
    "itself": "&a [*a]",
    "deep": "[" * 30_000,
    "deep and closed": "[" * 200 + "]" * 200,
    "deep mapping": "{a: " * 30_000,
    "timestamp": '!!timestamp "x"',
    "bool": '!!bool "x"',
    "int": '!!int ""',
    "binary": '!!binary "x"',
    "python": "!!python/object/apply:os.system [id]",
    "long": "[" + "1, " * 200_000 + "1]",
    "number": "9" * 5000,
    "escape": '"\x1b[2J": 1',
}


LOADERS = (
    (load_device, DeviceError),
    (load_mapping, ImportMapError),
    (lambda path: read_arm(ArmFile, "arms", path), DeviceError),
)


@pytest.mark.parametrize(("load", "error"), LOADERS)
def test_every_loader_refuses_a_key_that_a_file_states_twice(load, error, tmp_path):
    (tmp_path / "twice.yaml").write_text("remark: a\nremark: b\n")
    with pytest.raises(error, match="line 2 duplicate key 'remark'"):
        load(tmp_path / "twice.yaml")


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_bomb_of_yaml_is_refused_by_every_loader(bomb, tmp_path):
    file = tmp_path / "bomb.yaml"
    file.write_text(BOMBS[bomb])
    begin = time.process_time()
    for load, error in LOADERS:
        with pytest.raises(error) as found:
            load(file)
        text = str(found.value)
        assert "bomb.yaml" in text and "\n" not in text and len(text) < 400 and "\x1b" not in text
    assert OfferedQos.from_rosbag2(BOMBS[bomb]) == (OfferedQos(),)
    assert time.process_time() - begin < 20.0


def test_shipped_files_are_far_below_the_limits():
    biggest = 0
    for file in Path(__file__).resolve().parents[2].glob("via_*/**/*.yaml"):
        text = file.read_text(encoding="utf-8")
        biggest = max(biggest, len(text))
        read_yaml(text, file.name)
    assert 4 * biggest < LIMITS.yaml


def test_a_pipe_is_not_read(tmp_path):
    pipe = tmp_path / "x.mcap"
    os.mkfifo(pipe)
    for read in (read_bag, read_text, read_table, lambda path: load_device(Path(path)), lambda _: read_bag(tmp_path)):
        with pytest.raises(ViaError, match="not a regular file"):
            read(pipe)
    for suffix in (".db3", ".csv", ".json"):
        pipe = pipe.rename(tmp_path / f"x{suffix}")
        with pytest.raises(ViaError, match="not a regular file"):
            read_table(pipe)


def test_a_long_text_is_refused(tmp_path):
    file = tmp_path / "long.yaml"
    with file.open("wb") as out:
        out.truncate(1 << 40)
    with pytest.raises(DeviceError, match="more than 16777216 characters"):
        load_device(file)


def in_a_child(body: str, *arguments: object) -> str:
    """Output of Python code with limited memory; a crash fails the test."""
    done = subprocess.run(
        [sys.executable, "-c", body, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.strip()


READ = """
import sys
from via_core.bags.inspection import info
from via_core.errors import BagError
for path in sys.argv[1:]:
    try:
        found = info(path)
        print(found.complete, "; ".join(found.remarks))
    except BagError as error:
        print(error)
"""


def foreign(path: Path, schema: str = "float64 data", metadata: str = "", channels: int = 1, schemas: int = 1) -> Path:
    """A bag of another writer."""
    with path.open("wb") as out:
        writer = Writer(out, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        if metadata:
            writer.add_metadata("rosbag2", {"serialized_metadata": metadata})
        for k in range(schemas):
            number = writer.register_schema(f"a/msg/A{k}", "ros2msg", schema.encode())
        for k in range(channels):
            channel = writer.register_channel(f"/a{k}", "cdr", number)
        writer.add_message(channel, 1, bytes(12), 1)
        writer.finish()
    return path


HOSTILE = [
    ({"metadata": "[" * 30_000}, "metadata of the bag is invalid"),
    ({"schema": "string[1000000] x"}, "more than 10000 members"),
    ({"schema": f"Foo[10000000] x\n{'=' * 80}\nMSG: a/Foo\nint32 y"}, "more than 10000 members"),
    ({"schema": "A0 x"}, "nested more than 64 deep"),
    ({"schema": "int32 x" * 100_000}, "more than 262144 characters"),
    ({"channels": 65_000}, "more than 4096 channels"),
    ({"schemas": 3000}, "more than 512 schemas"),
]


def test_hostile_declarations_are_refused(tmp_path):
    files = [foreign(tmp_path / f"{number}.mcap", **contents) for number, (contents, _) in enumerate(HOSTILE)]
    lines = in_a_child(READ, *files).splitlines()
    for line, (_, expected) in zip(lines, HOSTILE, strict=True):
        assert expected in line


def test_large_but_honest_types_are_read():
    typestore_from_text("a/msg/A", "float64[36] covariance\nuint8[1000000] image\nstring[] names\nstring<=9[<=100] x")


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("stated", [100, 2 << 30])
def test_a_chunk_takes_no_more_memory_than_it_states(tmp_path, compression, stated):
    bomb = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression](bytes(1 << 30))
    word = compression.encode()
    head = bytes(16) + stated.to_bytes(8, "little") + bytes(4) + len(word).to_bytes(4, "little") + word
    chunk = head + len(bomb).to_bytes(8, "little") + bomb
    whole = foreign(tmp_path / "x.mcap").read_bytes()
    file = tmp_path / "bomb.mcap"
    at = 8 + 9 + int.from_bytes(whole[9:17], "little")  # after the header record
    file.write_bytes(whole[:at] + b"\x06" + len(chunk).to_bytes(8, "little") + chunk + whole[at:])
    for path in (file, tmp_path / "cut.mcap"):
        path.write_bytes(file.read_bytes()[: at + 9 + len(chunk) - (100 if path != file else 0)])
    # ru_maxrss would begin at the size of the process that started this one.
    after_each = "    print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    bomb_read, peak, *_ = in_a_child(READ + after_each, file, tmp_path / "cut.mcap").splitlines()
    assert "left out" in bomb_read and int(peak) < 700_000, peak  # [kB]


def test_messages_of_a_cut_chunk_are_read_block_by_block(tmp_path):
    """zstd decodes whole blocks of 128 KiB; a recording of rosbag2 has larger chunks."""
    path = tmp_path / "x.mcap"
    with path.open("wb") as out:
        writer = Writer(out, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema("a/msg/A", "ros2msg", b"uint8[1000] data")
        channel = writer.register_channel("/a", "cdr", schema)
        for k in range(1000):
            writer.add_message(channel, k, b"\0\1\0\0" + os.urandom(1000), k)
        writer.finish()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert 300 < len(read_bag(path)["/a"]) < 600


def test_one_byte_of_the_summary_that_renames_a_topic_is_noticed(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/numbers", "std_msgs/msg/Float64")
        bag.write("/numbers", bytes(12), 1)
    file = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.rindex(b"/numbers") + 1] ^= 1
    file.write_bytes(data)
    found = read_bag(tmp_path / "bag")
    assert list(found.topics) == ["/numbers"] and not found.complete
    assert "declared twice, and differently" in found.remarks[0]


def test_odd_names_of_types_are_refused():
    for name, text in (("a/msg/A-", "int32 x"), ("a/msg/1A", "int32 x"), ("a/msg/A", "int32 x-")):
        with pytest.raises(BagError, match=r"definition of .* is invalid"):
            typestore_from_text(name, text)


MAPPING = """
title: t
source: [s]
device: maccepavd
recordings:
  pattern: '{pattern}'
  bag: '{bag}'
  time: {{column: time, unit: s}}
commands:
  file: '{file}'
  time: {{column: time, unit: s}}
  commands: [{{column: e, unit: rad, quantity: equilibrium}}]
"""


def mapped(folder: Path, pattern: str = "(?P<name>.*)[.]csv", bag: str = "b", file: str = "c.csv") -> Path:
    path = folder / "mapping.yaml"
    path.write_text(MAPPING.format(pattern=pattern, bag=bag, file=file))
    return path


def test_a_catastrophic_pattern_is_refused_in_time(tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / ("a" * 60)).write_text("time\n")
    begin = time.monotonic()
    with pytest.raises(ImportMapError, match=r"recordings\.pattern takes more than 1 s"):
        import_recordings(tmp_path / "logs", mapped(tmp_path, "(?:a|aa)+b"), tmp_path / "out")
    assert time.monotonic() - begin < 60.0


@pytest.mark.parametrize("bag", ["{name:>3000000000}", "{name.__class__}", "{name!r}", "{other}", "{0}"])
def test_a_template_holds_plain_names_of_groups(tmp_path, bag):
    with pytest.raises(ImportMapError, match="is no plain name of a group"):
        load_mapping(mapped(tmp_path, bag=bag))


@pytest.mark.parametrize("file", ["../secret.csv", "/etc/passwd", "link.csv"])
def test_a_commands_file_outside_its_folder_is_neither_read_nor_shown(tmp_path, file):
    (tmp_path / "logs").mkdir()
    (tmp_path / "secret.csv").write_text("password\n")
    (tmp_path / "logs" / "link.csv").symlink_to(tmp_path / "secret.csv")
    (tmp_path / "logs" / "a.csv").write_text("time\n0\n")
    with pytest.raises(ImportMapError, match="lies outside") as found:
        import_recordings(tmp_path / "logs", mapped(tmp_path, pattern="a[.]csv", file=file), tmp_path / "out")
    assert "password" not in str(found.value)


def test_characters_that_control_a_terminal_become_pictures():
    assert shown("a\x1b[31mb\x07\x9b\u202ec\n\t") == "a\u241b[31mb\u2407\ufffd\ufffdc\n\t"
