"""Reads bags of the sqlite3 storage (.db3, also compressed) with `rosbags`, as the container of an MCAP file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from via_core.bags.container import ROW, Channel, Container, Messages, Schema
from via_core.bags.definitions import definition_of
from via_core.errors import BagError, one_line
from via_core.limits import require_regular


def databases_of(path: Path) -> list[Path]:
    """What `read_database` takes to read a bag: the bag with its metadata, or else each .db3 file."""
    if not path.is_dir():
        return [path] if path.suffix == ".db3" else []
    found = sorted(each for each in path.iterdir() if each.suffix in (".db3", ".zstd") and ".db3" in each.name)
    return [path] if found and (path / "metadata.yaml").is_file() else [each for each in found if each.suffix == ".db3"]


def read_database(path: Path, wanted: Callable[[str], bool] = lambda topic: True) -> Container:
    """All messages of the topics `wanted`. Raises BagError when `path` cannot be read.

    Bags before ROS 2 Iron hold no definitions of their messages: these come from `via_core.bags.definitions`.
    """
    remarks: list[str] = []
    channels: dict[int, Channel] = {}
    payloads: dict[int, list[bytes]] = {}
    rows: dict[int, list[tuple[int, ...]]] = {}
    try:
        require_regular(path)
        with Reader(path) as reader:
            chosen = [each for each in reader.connections if wanted(each.topic)]
            for each in chosen:
                text = each.msgdef.data if each.msgdef.format == MessageDefinitionFormat.MSG else ""
                try:
                    text = text or definition_of(each.msgtype).text
                except BagError as error:
                    remarks.append(f"topic {each.topic} is left out: {error}")
                    continue
                schema = Schema(each.msgtype, "ros2msg", text.encode())
                channels[each.id] = Channel(each.topic, schema, "cdr", {})
                payloads[each.id], rows[each.id] = [], []
            readable = [each for each in chosen if each.id in channels]
            for position, (each, time, data) in enumerate(reader.messages(readable) if readable else ()):
                payloads[each.id].append(bytes(data))
                rows[each.id].append((len(data), time, time, 0, position))
    except Exception as error:  # rosbags, sqlite and zstd raise errors of their own
        raise BagError(f"{path.name} cannot be read: {one_line(error)}") from None
    messages = {
        number: Messages(np.frombuffer(b"".join(parts), dtype=np.uint8), np.array(rows[number], dtype=ROW))
        for number, parts in payloads.items()
    }
    return Container(path, "ros2", channels, messages, {}, not remarks, tuple(remarks))
