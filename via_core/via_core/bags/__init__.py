"""Bags: MCAP recordings written as rosbag2 writes them and read back as columns."""

from via_core.bags.definitions import Definition, definition_of
from via_core.bags.findings import Finding
from via_core.bags.importing import FileReport, ImportReport, import_recordings
from via_core.bags.inspection import BagInfo, TopicInfo, check, info
from via_core.bags.joints import JointRecording, StampReport, joint_signals
from via_core.bags.mapping import Mapping, load_mapping, mapping_names
from via_core.bags.reader import Bag, Columns, RawMessage, Topic, read_bag
from via_core.bags.recording_checks import check_recording
from via_core.bags.recovery import RecoveryReport, recover
from via_core.bags.writer import BagWriter, OfferedQos

__all__ = [
    "Bag",
    "BagInfo",
    "BagWriter",
    "Columns",
    "Definition",
    "FileReport",
    "Finding",
    "ImportReport",
    "JointRecording",
    "Mapping",
    "OfferedQos",
    "RawMessage",
    "RecoveryReport",
    "StampReport",
    "Topic",
    "TopicInfo",
    "check",
    "check_recording",
    "definition_of",
    "import_recordings",
    "info",
    "joint_signals",
    "load_mapping",
    "mapping_names",
    "read_bag",
    "recover",
]
