"""Speed of reading a bag by column compared with mcap-ros2-support and rosbags in one run; the values are compared too.

The bag holds one minute of a joint at 333 Hz: 20 000 samples with velocities and torques, and as many commands and
stiffness estimates, 60 000 messages in all. Reading includes decompression and access to every member of every
message: as columns here, as one object per message there. mcap-ros2-support reads in file order, its fastest setting.

Prints a table and writes out/bench/bags.json. Times [s] are the minimum of several runs, one thread each.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from via_bringup.cli.console import answers, print_table
from via_core.bags.definitions import typestore_of
from via_core.bags.layout import filled
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter

from via_validation.bench.timing import keep

SAMPLES = 20_000
PERIOD = 3_000_000  # [ns]
RUNS = 7
JOINT_STATE = "sensor_msgs/msg/JointState"
VSA_COMMAND = "via_interfaces/msg/VsaCommand"
STIFFNESS = "via_interfaces/msg/StiffnessEstimate"
JOINTS = ["cubic_aa_vsa_shaft_joint", "cubic_aa_vsa_motor_1_joint", "cubic_aa_vsa_motor_2_joint"]


def write(path: Path) -> None:
    rng = np.random.default_rng(0)
    stamp = np.arange(SAMPLES) * PERIOD
    stamps = {"header.stamp.sec": stamp // 10**9, "header.stamp.nanosec": stamp % 10**9}
    counted = {**stamps, "sequence": np.arange(SAMPLES)}

    def noise(*shape: int) -> np.ndarray:
        return rng.normal(size=(SAMPLES, *shape))

    topics: dict[str, tuple[str, dict[str, Any], dict[str, np.ndarray]]] = {
        "/joint_states": (
            JOINT_STATE,
            {"name": JOINTS, "position": np.zeros(3), "velocity": np.zeros(3), "effort": np.zeros(3)},
            {**stamps, "position": noise(3), "velocity": noise(3), "effort": noise(3)},
        ),
        "/cubic_aa_vsa/command": (
            VSA_COMMAND,
            {"sequence": 0, "mode": 0, "equilibrium": 0.0, "preset": 0.0, "damping": 0.0, "motor": np.zeros(0)},
            {**counted, "equilibrium": noise(), "preset": noise(), "damping": noise()},
        ),
        "/cubic_aa_vsa/stiffness": (
            STIFFNESS,
            {"sequence": 0, "value": 0.0, "standard_deviation": 0.0, "transmission_value": np.zeros(2),
             "transmission_standard_deviation": np.zeros(2), "status": 0, "method": "modulated_torque"},
            {**counted, "value": noise(), "standard_deviation": noise(), "transmission_value": noise(2),
             "transmission_standard_deviation": noise(2)},
        ),
    }  # fmt: skip
    messages = {}
    for topic, (type_name, members, columns) in topics.items():
        store = typestore_of(type_name)
        header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](0, 0), "cubic_aa_vsa")
        template = store.types[type_name](header=header, **members)
        messages[topic] = filled(store, type_name, template, SAMPLES, columns)
    with BagWriter(path) as bag:
        for topic, (type_name, _, _) in topics.items():
            bag.add_topic(topic, type_name)
        for k in range(SAMPLES):
            for topic in topics:
                bag.write(topic, messages[topic][k], k * PERIOD)


def by_column(path: Path) -> dict[str, dict[str, np.ndarray]]:
    bag = read_bag(path)
    return {topic: dict(bag[topic].fields) for topic in bag.topics}


def by_mcap_ros2_support(path: Path) -> list[tuple[str, Any]]:
    with (path / f"{path.name}_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False)
        ]


def by_rosbags(path: Path) -> list[Any]:
    types = {name: typestore_of(name) for name in (JOINT_STATE, VSA_COMMAND, STIFFNESS)}
    with Reader(path) as reader:
        return [
            types[connection.msgtype].deserialize_cdr(data, connection.msgtype)
            for connection, _, data in reader.messages()
        ]


def differing(columns: dict[str, dict[str, np.ndarray]], decoded: list[tuple[str, Any]]) -> int:
    """Number of members that differ from those decoded by mcap-ros2-support, plus messages that one side lacks."""
    seen = dict.fromkeys(columns, 0)
    wrong = 0
    for topic, message in decoded:
        k = seen[topic]
        seen[topic] += 1
        for name, values in columns[topic].items():
            expected = message
            for part in name.split("."):
                expected = getattr(expected, part)
            wrong += not _equal(values[k], expected)
    return wrong + sum(len(next(iter(fields.values()))) - seen[topic] for topic, fields in columns.items())


def _equal(mine: Any, expected: Any) -> bool:
    if isinstance(mine, np.ndarray):
        return mine.tolist() == list(expected)
    return bool(mine == (tuple(expected) if isinstance(mine, tuple) else expected))


def best(read: Callable[[Path], Any], path: Path, runs: int) -> float:
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        result = read(path)
        times.append(time.perf_counter() - begin)
        del result
    return min(times)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        begin = time.perf_counter()
        write(path)
        writing = time.perf_counter() - begin
        begin = time.perf_counter()
        columns = by_column(path)
        first = time.perf_counter() - begin
        wrong = differing(columns, by_mcap_ros2_support(path))
        mine = best(by_column, path, RUNS)
        theirs = best(by_mcap_ros2_support, path, 3)
        rosbags = best(by_rosbags, path, 2)
        size = (path / "run_0.mcap").stat().st_size
    count = 3 * SAMPLES
    summary = {
        "messages": count, "size": size, "values_that_differ": wrong, "write": writing, "first_read": first,
        "by_column": mine, "mcap_ros2_support": theirs, "rosbags": rosbags,
        "times_faster_than_mcap_ros2_support": theirs / mine, "times_faster_than_rosbags": rosbags / mine,
    }  # fmt: skip
    cells = (
        (name, f"{seconds:.4f}", f"{count / seconds:,.0f}", f"{seconds / mine:.1f}")
        for name, seconds in (("by column", mine), ("mcap-ros2-support", theirs), ("rosbags", rosbags))
    )
    header = ("reader", "time [s]", "messages/s", "by column is faster by")
    print_table(f"{count} messages, {size} bytes", header, cells)
    answers.print(
        f"members that differ: {wrong}; first read with compilation or its cache: {first:.2f} s; "
        f"writing: {count / writing:,.0f} messages/s"
    )
    keep("bags", summary)
