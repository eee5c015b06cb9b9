"""Bags: MCAP recordings written as rosbag2 writes them and read back as columns."""

from via_core.bags.definitions import Definition, definition_of
from via_core.bags.reader import Bag, Columns, RawMessage, Topic, read_bag
from via_core.bags.writer import BagWriter, OfferedQos

__all__ = [
    "Bag",
    "BagWriter",
    "Columns",
    "Definition",
    "OfferedQos",
    "RawMessage",
    "Topic",
    "definition_of",
    "read_bag",
]
