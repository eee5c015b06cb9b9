"""Bag writer in the format of rosbag2: a directory `<name>/` with `<name>_0.mcap` and metadata.yaml.

The index of a file stays in memory until the file is finished: 0.7 KiB for each chunk of four topics. A long recording
is therefore split into several files, `<name>_1.mcap` and so on, as by `ros2 bag record --max-bag-duration`.

During recording the present file is named `<name>_0.mcap.active`; when it is finished it gets its final name.
metadata.yaml is written last. An interrupted bag can be read in part and repaired with `recover`. MCAP: profile 'ros2',
zstd chunks of 64 KiB with message index; metadata.yaml: rosbag2 version 9 (Jazzy). Sources:
https://mcap.dev/spec/registry (profile ros2), rosbag2_storage_mcap, rosbag2_storage TopicMetadata.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from errno import ENOENT
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml
from mcap.writer import CompressionType, IndexType, Writer

from via_core.bags.definitions import Definition, definition_of
from via_core.errors import BagError, ViaError
from via_core.text_files import read_yaml

CHUNK_SIZE = 64 * 1024  # [bytes] before compression; a recorder also ends a chunk by time, see `flush`
UNFINISHED = ".active"
STORAGE_METADATA = "rosbag2"  # name of the MCAP metadata record with rosbag2's copy of metadata.yaml
JUMPS = "clock_jumps"  # custom data: how often simulated time has jumped during the recording
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class OfferedQos:
    """QoS offered by a publisher, in the terms of rosbag2; player and `ros2 bag play` offer it again."""

    reliability: str = "reliable"  # reliable | best_effort
    durability: str = "volatile"  # volatile | transient_local
    history: str = "keep_last"  # keep_last | keep_all | unknown
    depth: int = 10

    @staticmethod
    def from_rosbag2(text: str) -> tuple[OfferedQos, ...]:
        """The profiles in an offered_qos_profiles text of any version; the default where it is invalid."""
        try:
            profiles = read_yaml(text, "offered_qos_profiles") or []
            return tuple(
                OfferedQos(
                    _word(each["reliability"], {2: "best_effort"}, "reliable"),
                    _word(each["durability"], {1: "transient_local"}, "volatile"),
                    _word(each["history"], {2: "keep_all", 3: "unknown"}, "keep_last"),
                    int(each["depth"]),
                )
                for each in profiles
            ) or (OfferedQos(),)
        except (ViaError, KeyError, TypeError, ValueError, OverflowError):
            return (OfferedQos(),)

    def as_rosbag2(self) -> dict[str, Any]:
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


def _word(value: str | int, by_number: dict[int, str], otherwise: str) -> str:
    """Name of a policy; before version 9 rosbag2 stored its number."""
    return value if isinstance(value, str) else by_number.get(value, otherwise)


@dataclass
class _Topic:
    name: str
    definition: Definition
    qos: list[dict[str, Any]]
    channel: int = 0


@dataclass
class _Split:
    """One file of a bag: log times of its messages [ns], and their number by topic."""

    name: str
    first: int | None = None
    last: int = 0
    messages: Counter[str] = field(default_factory=Counter)

    def as_rosbag2(self) -> dict[str, Any]:
        start = self.first or 0
        return {
            "path": self.name,
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": self.last - start},
            "message_count": self.messages.total(),
        }


class BagWriter:
    """Writes serialised messages (CDR with its four-byte header) into a new bag directory.

    path          directory to create; BagError when it exists or its name is not UTF-8
    metadata      texts stored as rosbag2 custom_data
    max_duration  log time [s] from the first message of a file on after which the next file begins

    As a context manager it finishes the bag on success; on an exception the data stays under the unfinished name.
    """

    def __init__(
        self, path: str | Path, metadata: Mapping[str, str] | None = None, max_duration: float = float("inf")
    ) -> None:
        self.path = Path(path)
        self.metadata = dict(metadata or {})
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[str, int] = {}  # of the present file, by type
        self._splits: list[_Split] = []
        self._max_duration = max_duration * 1e9  # [ns]
        self._writer: Writer | None = None
        try:
            self.path.name.encode()  # the bag contains its own name as UTF-8
            self.path.mkdir(parents=True)
        except UnicodeEncodeError:
            raise BagError(f"the name of the bag {self.path} is not UTF-8; choose another") from None
        except FileExistsError:
            raise BagError(f"{self.path} exists already; choose another name or remove it") from None
        except OSError as error:
            raise BagError(f"cannot create the bag {self.path}: {error.strerror}") from None
        with self._filing():
            self._begin()

    def add_topic(
        self,
        topic: str,
        type_name: str,
        qos: OfferedQos | tuple[OfferedQos, ...] = OfferedQos(),
        definition: Definition | None = None,
    ) -> None:
        """Declare `topic` before its first message; a repeated declaration of the same type has no effect.

        definition  for a type that is not installed; default: `definition_of(type_name)`
        Raises BagError for an unknown type or a topic that already has another type.
        """
        writer = self._open_writer()
        known = self._topics.get(topic)
        if known is not None:
            if known.definition.type_name != type_name:
                raise BagError(f"topic {topic} is {known.definition.type_name} in {self.path.name}, not {type_name}")
            return
        profiles = [each.as_rosbag2() for each in (qos if isinstance(qos, tuple) else (qos,))]
        self._topics[topic] = _Topic(topic, definition or definition_of(type_name), profiles)
        self._register(writer, self._topics[topic])

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int | None = None, sequence: int = 0) -> None:
        """Append one serialised message; times in [ns], not negative.

        Raises BagError for an undeclared topic, no CDR header, a negative time, a closed bag or a full disk.
        """
        writer = self._open_writer()
        declared = self._topics.get(topic)
        if declared is None:
            raise BagError(f"topic {topic} was not declared in {self.path.name}")
        if len(data) < 4:
            raise BagError(f"{len(data)} bytes are not a serialised message for {topic}")
        published = log_time if publish_time is None else publish_time
        if min(log_time, published) < 0:
            raise BagError(f"negative time {min(log_time, published)} ns for {topic} in {self.path.name}")
        split = self._splits[-1]
        with self._filing():
            if split.first is not None and log_time - split.first >= self._max_duration:
                self._finish(writer)
                writer, split = self._begin()
            writer.add_message(declared.channel, log_time, data, published, sequence & 0xFFFFFFFF)
        split.messages[topic] += 1
        split.first = log_time if split.first is None else min(split.first, log_time)
        split.last = max(split.last, log_time)

    def flush(self) -> None:
        """End the present chunk and hand it to the operating system: a killed process loses only later messages.

        Raises BagError on a full disk, and when the file has been removed or replaced.
        """
        writer = self._open_writer()
        with self._filing():
            writer.flush()
            if not os.path.samestat(os.stat(self._active), os.fstat(self._file.fileno())):
                raise FileNotFoundError(ENOENT, "it has been replaced")

    def messages(self) -> dict[str, int]:
        """Number of messages written, by topic."""
        counts = _total(self._splits)
        return {topic: counts[topic] for topic in self._topics}

    def close(self) -> None:
        """Finish the file, give it its final name, write metadata.yaml. A second call has no effect."""
        if self._writer is None:
            return
        with self._filing():
            self._finish(self._writer)
            for split in self._splits:
                with (self.path / split.name).open("rb") as file:
                    os.fsync(file.fileno())
            metadata = self.path / "metadata.yaml"
            unfinished = metadata.with_name(metadata.name + UNFINISHED)
            text = _yaml({"rosbag2_bagfile_information": self._information(self._splits)})
            unfinished.write_text(text + "\n", encoding="utf-8")
            unfinished.rename(metadata)

    def _begin(self) -> tuple[Writer, _Split]:
        """Open the next file and declare the topics in it."""
        split = _Split(f"{self.path.name}_{len(self._splits)}.mcap")
        self._active = self.path / (split.name + UNFINISHED)
        self._file = self._active.open("wb")
        writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD, index_types=IndexType.ALL)
        writer.start(profile="ros2", library="via_core")
        self._writer = writer
        self._schemas.clear()
        for topic in self._topics.values():
            self._register(writer, topic)
        self._splits.append(split)
        return writer, split

    def _register(self, writer: Writer, topic: _Topic) -> None:
        """Declare a topic in the present file."""
        definition, name = topic.definition, topic.definition.type_name
        if name not in self._schemas:
            self._schemas[name] = writer.register_schema(name, "ros2msg", definition.text.encode())
        metadata = {"offered_qos_profiles": _yaml(topic.qos), "topic_type_hash": definition.type_hash}
        topic.channel = writer.register_channel(topic.name, "cdr", self._schemas[name], metadata)

    def _finish(self, writer: Writer) -> None:
        """Finish the present file and give it its final name."""
        text = _yaml(self._information(self._splits[-1:]))
        writer.add_metadata(STORAGE_METADATA, {"serialized_metadata": text})
        writer.finish()
        self._file.flush()
        self._writer = None
        self._file.close()
        self._active.rename(self.path / self._splits[-1].name)

    def abandon(self) -> None:
        """Stop without finishing: all chunks, also the current one, stay in the file under its unfinished name."""
        if self._writer is not None:
            with suppress(OSError):  # the disk is full or gone
                self._writer.flush()
        self._let_go()

    def discard(self) -> None:
        """Stop and remove the whole bag directory."""
        self._let_go()
        shutil.rmtree(self.path, ignore_errors=True)

    def _let_go(self) -> None:
        self._writer = None
        with suppress(OSError):  # flushing may fail, the file is closed in any case
            self._file.close()

    @contextmanager
    def _filing(self) -> Iterator[None]:
        """Turns an OSError into a BagError."""
        try:
            yield
        except OSError as error:
            raise BagError(f"cannot write the bag {self.path}: {error.strerror}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def _open_writer(self) -> Writer:
        if self._writer is None:
            raise BagError(f"the bag {self.path.name} is closed")
        return self._writer

    def _information(self, splits: Sequence[_Split]) -> dict[str, Any]:
        """The metadata of rosbag2 for these files."""
        counts = _total(splits)
        start = min((split.first for split in splits if split.first is not None), default=0)
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": max(split.last for split in splits) - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": counts.total(),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.definition.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": topic.qos,
                        "type_description_hash": topic.definition.type_hash,
                    },
                    "message_count": counts[topic.name],
                }
                for topic in self._topics.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [split.name for split in splits],
            "files": [split.as_rosbag2() for split in splits],
            "custom_data": self.metadata or None,
            "ros_distro": "jazzy",
        }


def _total(splits: Sequence[_Split]) -> Counter[str]:
    """Number of messages by topic."""
    return sum((split.messages for split in splits), Counter())


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors, for human readers."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _yaml(value: Any) -> str:
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False, allow_unicode=True).rstrip()
