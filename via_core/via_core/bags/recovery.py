"""Recovery of unfinished or damaged bags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from via_core.bags.reader import RawMessage, read_bag
from via_core.bags.writer import BagWriter, OfferedQos
from via_core.errors import BagError


@dataclass(frozen=True)
class RecoveryReport:
    """Result of a recovery.

    bag       the new bag
    messages  number of recovered messages by topic
    remarks   what is missing from the source; empty when it was complete
    """

    source: Path
    bag: Path
    messages: Mapping[str, int]
    remarks: tuple[str, ...]


def recover(path: str | Path, out: str | Path) -> RecoveryReport:
    """Copy every intact message of `path` (bag directory or .mcap file) into a new, finished bag `out`.

    Damaged chunks are skipped. Of a chunk truncated by the end of the file the messages in complete compressed blocks
    are recovered: all whole messages without compression, none of chunks below 128 KiB with zstd.
    Invalid messages (no CDR header, negative time) are skipped and counted in the remarks.
    Raises BagError when nothing can be read from `path`, or `out` exists.
    """
    bag = read_bag(path)
    messages = [each for each in bag.in_file_order() if _valid(each)]
    remarks = bag.remarks
    if len(messages) < len(bag):
        remarks = (*remarks, f"{len(bag) - len(messages)} messages are invalid and left out")
    if not messages:
        raise BagError(f"{bag.path.name} holds no intact message: {'; '.join(remarks) or 'it is empty'}")
    writer = BagWriter(out, {**bag.metadata, "recovered_from": bag.path.name, "recovered_without": "; ".join(remarks)})
    try:
        for topic in bag.topics.values():
            writer.add_topic(topic.name, topic.type_name, OfferedQos.from_rosbag2(topic.qos), topic.definition)
        for message in messages:
            writer.write(message.topic, message.data, message.log_time, message.publish_time, message.sequence)
        writer.close()
    except BaseException:
        writer.discard()
        raise
    return RecoveryReport(bag.path, writer.path, MappingProxyType(writer.messages()), remarks)


def _valid(message: RawMessage) -> bool:
    return len(message.data) >= 4 and message.log_time >= 0 and message.publish_time >= 0
