"""Bag reader: columns for analysis, messages in stamp order for replay.

    bag = read_bag("out/run")                    # a bag directory, an .mcap file, finished or not, or a .db3 file
    states = bag["/joint_states"]                # Columns: states.stamp, states["position"], ...
    for message in bag.in_stamp_order(): ...     # RawMessage: topic, type, bytes, times

If all messages of a topic have one layout, which is checked in every message, columns are strided copies; otherwise
messages are decoded one by one. Both ways give the same columns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from via_core.bags.container import Channel, Container, Messages, files_of, joined, read_container
from via_core.bags.database import databases_of, read_database
from via_core.bags.definitions import Definition, typestore_from_text
from via_core.bags.layout import NoFixedLayoutError, column, decoded, layout_of, scalar_formats, shares_layout
from via_core.bags.writer import JUMPS, STORAGE_METADATA
from via_core.errors import BagError, one_line
from via_core.signals import Mask
from via_core.text_files import read_text, read_yaml
from via_core.wire import JOINT_STATE, SECOND

Integers = NDArray[np.int64]
_YamlLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class RawMessage(NamedTuple):
    """One serialised message; `Topic.definition` is its type."""

    topic: str
    type_name: str
    data: bytes
    log_time: int  # [ns] time of recording
    stamp: int  # [ns] of its header; log_time for types without one; see Bag.in_stamp_order
    publish_time: int  # [ns]
    sequence: int


@dataclass(frozen=True)
class Columns:
    """All messages of one topic in file order, as one array per member.

    log_time   (n,) [ns]
    stamp      (n,) [ns] of the header; log_time for types without one
    fields     'position' -> (n,), or (n, k) where all messages have k numbers; else an object array (n,) of arrays, of
               str for texts, of tuples of str for lists of texts. Names of nested members are dotted:
               'header.frame_id'.
    by_offset  whether all messages share one layout and were read by strided copies
    left_out   one sentence per message that could not be decoded
    """

    topic: str
    type_name: str
    log_time: Integers
    stamp: Integers
    fields: Mapping[str, NDArray[Any]]
    by_offset: bool
    left_out: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.log_time)

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self.fields[name]
        except KeyError:
            raise BagError(f"{self.topic} ({self.type_name}) has no member '{name}'") from None


@dataclass(frozen=True)
class Topic:
    """One topic of a bag: its type, and its messages as bytes."""

    name: str
    definition: Definition
    qos: str  # offered_qos_profiles, the YAML text of rosbag2
    messages: Messages  # file by file, position: rank in the bag

    def __len__(self) -> int:
        return len(self.messages)

    @property
    def type_name(self) -> str:
        return self.definition.type_name

    @cached_property
    def store(self) -> Typestore:
        return typestore_from_text(self.type_name, self.definition.text)

    @cached_property
    def log_time(self) -> Integers:
        return self.messages["log_time"]

    @cached_property
    def sequence(self) -> Integers:
        return self.messages["sequence"]

    @cached_property
    def publish_time(self) -> Integers:
        return self.messages["publish_time"]

    @cached_property
    def stamp(self) -> Integers:
        """Header stamps [ns]; log times for types without a header, unset stamps, and messages too short for one."""
        if not self._has_header:
            return self.log_time
        length, stamp = self.messages["length"], self.log_time.copy()
        long = length >= 12
        at = (np.cumsum(length) - length)[long, None] + np.arange(4, 12)
        time = self.messages.data[at].view("<u4").reshape(-1, 2).astype(np.int64)
        seconds = time[:, 0] - ((time[:, 0] >> 31) << 32)  # int32
        stamp[long] = seconds * SECOND + time[:, 1]
        return stamp if len(stamp) < 2 or stamp.any() else self.log_time

    @property
    def unset(self) -> bool:
        """Whether the messages have headers whose stamps were never set."""
        return self._has_header and self.stamp is self.log_time

    @property
    def _has_header(self) -> bool:
        members = self.store.fielddefs[self.type_name][1]
        return bool(members) and members[0][1] == (Nodetype.NAME, "std_msgs/msg/Header")

    def payloads(self) -> Iterator[bytes]:
        """The serialised messages in file order."""
        data, end = self.messages.data.tobytes(), 0
        for length in self.messages["length"].tolist():
            yield data[end : end + length]
            end += length

    @cached_property
    def columns(self) -> Columns:
        """Messages as columns; undecodable ones are listed in `left_out`. Raises BagError when none can be decoded."""
        fields = self._by_offset()
        if fields is not None:
            return Columns(self.name, self.type_name, self.log_time, self.stamp, MappingProxyType(fields), True)
        fields, fits, left_out = self._one_by_one()
        if left_out and not fits.any():
            raise BagError(left_out[0])
        log_time, stamp = self.log_time[fits], self.stamp[fits]
        return Columns(self.name, self.type_name, log_time, stamp, MappingProxyType(fields), False, left_out)

    def _by_offset(self) -> dict[str, NDArray[Any]] | None:
        lengths = self.messages["length"]
        if len(lengths) == 0 or np.any(lengths != lengths[0]):
            return None
        rows = self.messages.data.reshape(len(lengths), int(lengths[0]))
        try:
            layout = layout_of(self.store, self.type_name, rows[0].tobytes())
        except NoFixedLayoutError:
            return None
        if not shares_layout(layout, rows):
            return None
        fields: dict[str, NDArray[Any]] = {name: column(number, rows) for name, number in layout.numbers.items()}
        for name, text in layout.texts.items():
            fields[name] = np.empty(len(rows), dtype=object)
            fields[name].fill(text)
        return fields

    def _one_by_one(self) -> tuple[dict[str, NDArray[Any]], Mask, tuple[str, ...]]:
        """Fields of the decodable messages, a mask of them, and one sentence for every other message."""
        rows: list[dict[str, Any]] = []
        fits = np.ones(len(self), dtype=np.bool_)
        left_out: list[str] = []
        for k, data in enumerate(self.payloads()):
            try:
                rows.append(dict(_flattened(decoded(self.store, self.type_name, data))))
            except Exception as error:  # generated code: raises any exception on invalid bytes
                left_out.append(f"message {k} of {self.name} is not a {self.type_name}: {one_line(error)}")
                fits[k] = False
        formats = scalar_formats(self.store, self.type_name)
        names = rows[0] if rows else ()
        return {name: _stacked([row[name] for row in rows], formats.get(name)) for name in names}, fits, tuple(left_out)


@dataclass(frozen=True)
class Bag:
    """The readable part of a bag.

    topics    by name
    metadata  custom_data of the bag
    complete  nothing is missing or was skipped
    remarks   one sentence for everything that is missing or was skipped
    """

    path: Path
    topics: Mapping[str, Topic]
    metadata: Mapping[str, str]
    complete: bool
    remarks: tuple[str, ...]

    def __contains__(self, topic: object) -> bool:
        return topic in self.topics

    def __len__(self) -> int:
        return sum(len(topic) for topic in self.topics.values())

    def topic(self, name: str) -> Topic:
        try:
            return self.topics[name]
        except KeyError:
            there = ", ".join(sorted(self.topics)) or "none"
            raise BagError(f"no topic {name} in {self.path.name}; there are: {there}") from None

    def __getitem__(self, name: str) -> Columns:
        return self.topic(name).columns

    def in_stamp_order(self, topics: Iterable[str] | None = None) -> Iterator[RawMessage]:
        """The messages of `topics` (default: all) sorted by stamp; equal stamps in file order.

        Stamps of a simulated robot start at zero, while messages without a header have the wall time of the recording.
        A topic whose stamps lie outside those of the joint states is placed among them by log time.
        """
        return self._ordered(topics, by_stamp=True)

    def in_file_order(self) -> Iterator[RawMessage]:
        """All messages in file order."""
        return self._ordered(None, by_stamp=False)

    def _ordered(self, topics: Iterable[str] | None, *, by_stamp: bool) -> Iterator[RawMessage]:
        chosen = [self.topic(name) for name in (self.topics if topics is None else topics)]
        chosen = [topic for topic in chosen if len(topic)]
        if not chosen:
            return
        stamps = np.concatenate(_on_one_clock(chosen) if by_stamp else [topic.stamp for topic in chosen])
        rank = np.concatenate([topic.messages["position"] for topic in chosen])
        which = np.repeat(np.arange(len(chosen)), [len(topic) for topic in chosen])
        index = np.concatenate([np.arange(len(topic)) for topic in chosen])
        payloads = [list(topic.payloads()) for topic in chosen]
        for k in np.lexsort((rank, stamps)) if by_stamp else np.argsort(rank):
            topic, i = chosen[which[k]], int(index[k])
            yield RawMessage(
                topic.name,
                topic.type_name,
                payloads[which[k]][i],
                int(topic.log_time[i]),
                int(stamps[k]),
                int(topic.publish_time[i]),
                int(topic.sequence[i]),
            )


def read_bag(path: str | Path, topics: Iterable[str] | None = None) -> Bag:
    """Read `topics` (default: all) of a bag directory, an .mcap or a .db3 file.

    `Bag.remarks` lists what is missing from a damaged or unfinished bag. Raises BagError where nothing can be read: no
    such path, no file of rosbag2, or no topic in a supported message format.
    """
    path = Path(path)
    if not path.exists():
        raise BagError(f"no bag at {path}")
    chosen = None if topics is None else set(topics)
    databases = databases_of(path)
    files = databases or list(files_of(path))
    if not files:
        hint = "; convert it with rosbags-convert" if list(path.glob("*.bag")) else ""
        raise BagError(f"{path} holds neither an .mcap nor a .db3 file{hint}")
    remarks: list[str] = []
    containers: list[Container] = []

    def wanted(topic: str) -> bool:
        return chosen is None or topic in chosen

    for file in files:
        try:
            before = containers[-1].unpacked if containers else 0
            containers.append(read_database(file, wanted) if databases else read_container(file, wanted, before))
        except BagError as error:
            if len(files) == 1:
                raise
            remarks.append(str(error))
    if not containers:
        raise BagError(f"{path} holds no readable file: {'; '.join(remarks)}")
    for each in containers:
        remarks += [remark if len(files) == 1 else f"{each.path.name}: {remark}" for remark in each.remarks]
    metadata, missing = _metadata(path, containers)
    remarks += missing
    found = _topics(containers, remarks)
    if not found and any(each.channels for each in containers):
        raise BagError(f"{path.name} has no readable topic: {'; '.join(remarks)}")
    kept = {name: topic for name, topic in found.items() if chosen is None or name in chosen}
    return Bag(path, MappingProxyType(kept), MappingProxyType(metadata), not remarks, tuple(remarks))


def _topics(containers: list[Container], remarks: list[str]) -> dict[str, Topic]:
    channels: dict[str, list[tuple[Channel, Messages]]] = {}
    before = 0
    for container in containers:
        for number, channel in container.channels.items():
            messages = container.messages[number]
            messages.rows["position"] += before
            channels.setdefault(channel.topic, []).append((channel, messages))
        before += sum(len(messages) for messages in container.messages.values())
    topics = {}
    for name, parts in channels.items():
        first = parts[0][0]
        if first.schema is None:
            remarks.append(f"topic {name} is left out: no schema")
            continue
        if first.encoding != "cdr" or first.schema.encoding != "ros2msg":
            remarks.append(f"topic {name} is left out: {first.encoding or 'no'} messages, "
                           f"{first.schema.encoding or 'no'} schema instead of cdr and ros2msg")  # fmt: skip
            continue
        same = [each for each in parts if each[0].schema == first.schema and each[0].encoding == first.encoding]
        if len(same) < len(parts):
            remarks.append(f"topic {name} has two types; only its {first.schema.name} messages are read")
        try:
            text = first.schema.text.decode()
            store = typestore_from_text(first.schema.name, text)
            type_hash = first.metadata.get("topic_type_hash") or store.hash_rihs01(first.schema.name)
            definition = Definition(first.schema.name, text, type_hash)
            topic = Topic(name, definition, first.metadata.get("offered_qos_profiles", ""),
                          joined([messages for _, messages in same]))  # fmt: skip
        except (UnicodeDecodeError, BagError) as error:
            remarks.append(f"topic {name} is left out: {error}")
            continue
        topics[name] = topic
    return topics


def _metadata(path: Path, containers: list[Container]) -> tuple[dict[str, str], list[str]]:
    """custom_data from metadata.yaml, or else from the last copy in an MCAP file, and remarks."""
    texts = []
    remarks = []
    if path.is_dir():
        try:
            texts.append(read_text(path / "metadata.yaml", BagError))
        except BagError:
            remarks.append("metadata.yaml is missing or cannot be read")
    texts += [each.metadata.get(STORAGE_METADATA, {}).get("serialized_metadata", "") for each in reversed(containers)]
    for text in filter(None, texts):
        try:
            content = read_yaml(text, "metadata", BagError, _YamlLoader)
            content = content.get("rosbag2_bagfile_information", content)
            custom = content.get("custom_data") or {}
            listed = {Path(each).name for each in content.get("relative_file_paths") or ()}
            if path.is_dir() and not remarks:  # this is metadata.yaml, not a copy
                remarks += [f"{name} is missing" for name in sorted(listed - {each.name for each in path.iterdir()})]
            if JUMPS in custom:
                remarks.append(f"simulated time has jumped {custom[JUMPS]} times during the recording")
            return {str(key): str(value) for key, value in custom.items()}, remarks
        except (BagError, AttributeError, TypeError):
            remarks.append("the metadata of the bag is invalid")
    return {}, remarks


def _on_one_clock(topics: list[Topic]) -> list[Integers]:
    """Stamps of each topic on the clock of the joint states."""
    samples = [topic for topic in topics if topic.type_name == JOINT_STATE]
    if not samples:
        return [topic.stamp for topic in topics]
    logged = np.sort(np.concatenate([topic.log_time for topic in samples]))
    stamps = np.sort(np.concatenate([topic.stamp for topic in samples]))
    first = stamps[0]

    def moved(topic: Topic) -> Integers:
        if topic.stamp.max() >= first and topic.stamp.min() <= stamps[-1]:
            return topic.stamp
        return first + np.interp(topic.log_time - logged[0], logged - logged[0], stamps - first).astype(np.int64)

    return [moved(topic) for topic in topics]


def _flattened(message: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in vars(message).items():
        if name == "structure_needs_at_least_one_member":
            continue
        if hasattr(value, "__msgtype__"):
            yield from _flattened(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            yield prefix + name, tuple(value)
        else:
            yield prefix + name, value


def _stacked(values: list[Any], scalar: str | None) -> NDArray[Any]:
    """Values of one member as in `Columns.fields`; `scalar` is the numpy format of a scalar member."""
    if scalar is not None:
        return np.array(values, dtype=scalar)
    if isinstance(values[0], np.ndarray) and len({len(value) for value in values}) == 1:
        return np.stack(values)
    out = np.empty(len(values), dtype=object)
    for k, value in enumerate(values):
        out[k] = value
    return out
