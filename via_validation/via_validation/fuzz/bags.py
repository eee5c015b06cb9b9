"""A bag to damage, and its reading."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from via_core.bags.inspection import check, info
from via_core.bags.messages import command_messages, joint_messages
from via_core.bags.writer import BagWriter
from via_core.wire import JOINT_STATE, VSA_COMMAND


def read_bag(path: Path) -> None:
    """Inspect a bag as `via bag info` and `via bag check` do."""
    info(path)
    check(path)


def sample_bag() -> bytes:
    """A short recording of a joint with its commands, the content of its file."""
    stamp = np.arange(300) * 1_000_000
    angles = np.sin(0.01 * np.arange(900)).reshape(300, 3)
    joints = joint_messages("robot", ["link", "motor_1", "motor_2"], stamp, {"position": angles})
    with TemporaryDirectory() as folder:
        with BagWriter(Path(folder) / "bag", {"title": "fuzz"}) as bag:
            bag.add_topic("/joint_states", JOINT_STATE)
            bag.add_topic("/robot/command", VSA_COMMAND)
            for at, joint, command in zip(
                stamp.tolist(), joints, command_messages("robot", stamp, {"motor": angles[:, 1:]})
            ):
                bag.write("/joint_states", joint, at)
                bag.write("/robot/command", command, at)
        return (Path(folder) / "bag" / "bag_0.mcap").read_bytes()
