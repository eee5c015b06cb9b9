"""Faults of bags that are read or played: damaged files, and subscribers that do not answer."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.errors import BagError
from via_interfaces.msg import StiffnessEstimate
from via_ros import qos
from via_ros.conversions import set_stamp
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder

from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph

SAMPLES, ANSWERS = "/joint_states", "/answers"
CUTS = 60


# ---- damaged bags


def _bag(graph: Graph, count: int = 3000) -> Path:
    path = graph.folder / "made"
    with BagWriter(path) as out:
        out.add_topic(SAMPLES, "sensor_msgs/msg/JointState")
        message = JointState(name=["a"], position=[0.0])
        for number in range(count):
            set_stamp(message.header.stamp, (1 + number) * 1_000_000)
            message.position[0] = float(number)
            out.write(SAMPLES, bytes(serialize_message(message)), log_time=(1 + number) * 1_000_000)
    return path


def _cut(graph: Graph) -> str:
    """The file ends anywhere: what is read must be a beginning of the original."""
    path = _bag(graph)
    file = path / "made_0.mcap"
    whole, random, counts = file.read_bytes(), np.random.default_rng(2), []
    (path / "metadata.yaml").unlink()
    for at in sorted(random.integers(1000, len(whole) - 1, CUTS)):
        file.write_bytes(whole[:at])
        try:
            bag = read_bag(path)
        except BagError:
            counts.append(0)
            continue
        values = bag[SAMPLES].stamp if SAMPLES in bag else np.empty(0)
        expect(not bag.complete, f"cut at {at}: complete")
        expect(bool((values == (1 + np.arange(len(values))) * 1_000_000).all()), f"cut at {at}: other messages")
        counts.append(len(values))
    expect(counts == sorted(counts), "a longer file gave fewer messages")
    return f"{CUTS} cuts: 0 to {max(counts)} of 3000 messages, always the first ones, never called complete"


def _played(graph: Graph, damage: Any) -> str:
    """A damaged bag is played as far as it can be read, or refused with one line."""
    path = _bag(graph, 300)
    damage(path)
    heard = graph.hear(JointState, SAMPLES)
    try:
        player = graph.add(Player, bag=str(path), subscribers=1, rate=0.0)
    except BagError as error:
        expect("\n" not in str(error), "an error of several lines")
        return f"refused: {str(error).replace(str(graph.folder), '')[:100]}"
    graph.until(player.finished.done, "the end of the player")
    graph.until(lambda: len(heard) == player.played, "all messages")
    return f"{len(heard)} messages played, exit code {player.finished.result()}"


def _truncate(path: Path) -> None:
    file = path / "made_0.mcap"
    file.write_bytes(file.read_bytes()[:-1000])


def _flip(path: Path) -> None:
    file = path / "made_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(bytes(data))


def _empty(path: Path) -> None:
    (path / "made_0.mcap").write_bytes(b"")


def _without_file(path: Path) -> None:
    (path / "made_0.mcap").unlink()


# ---- the player's subscribers


def _listener_silent(graph: Graph) -> str:
    """A subscriber answers the first half of the samples and falls silent."""
    path, answers = _bag(graph), graph.publisher(StiffnessEstimate, ANSWERS)
    count = [0]

    def answer(message: JointState) -> None:
        count[0] += 1
        if count[0] <= 1500:
            answers.publish(StiffnessEstimate(header=message.header))

    graph.peer.create_subscription(JointState, SAMPLES, answer, qos.SAMPLES)
    player = graph.add(Player, bag=str(path), subscribers=1, rate=0.0, answers=[ANSWERS], window=100, patience=1.0)
    graph.until(player.finished.done, "the end of the player")
    expect(player.finished.result() == 3, f"exit code {player.finished.result()}")
    expect(1500 <= player.played <= 1700, f"{player.played} messages played")
    return f"exit code 3 after {player.played} messages, the others wait"


def _nobody_listens(graph: Graph) -> str:
    player = graph.add(Player, bag=str(_bag(graph, 10)), subscribers=1, patience=0.5)
    graph.until(player.finished.done, "the end of the player")
    expect((player.finished.result(), player.played) == (3, 0), f"exit code {player.finished.result()}")
    return "exit code 3, nothing played"


def _player_killed(graph: Graph) -> str:
    """The recorder of what a player plays goes on with the next player."""
    _bag(graph, 2000)
    topics = [f"{SAMPLES}:sensor_msgs/msg/JointState"]
    recorder = graph.add(Recorder, bag=str(graph.folder / "bag"), topics=topics)
    counts = recorder.counts[SAMPLES]
    first = graph.start("via_ros", "player", "bag:=made", "rate:=1.0")
    graph.until(lambda: counts.messages > 100, "messages of the player")
    first.kill()
    graph.pause(0.5)
    before = counts.messages
    second = graph.start("via_ros", "player", "bag:=made", "rate:=0.0", "subscribers:=1")
    graph.until(lambda: second.code is not None and counts.messages >= before + 2000, "all messages of the second one")
    expect(second.code == 0 and counts.messages == before + 2000, f"{counts.messages - before} of 2000 messages")
    return f"{before} messages of the killed player, all 2000 of the next one"


def faults() -> list[Fault]:
    """The faults of this group."""
    played = "what is whole is played, or one line"
    return [
        Fault(f"the file is cut at {CUTS} places", "a beginning of the original, never called complete", _cut),
        Fault("player: the file is truncated", played, partial(_played, damage=_truncate), False),
        Fault("player: a byte is flipped", played, partial(_played, damage=_flip), False),
        Fault("player: the file is empty", played, partial(_played, damage=_empty), False),
        Fault("player: the file is gone", played, partial(_played, damage=_without_file), False),
        Fault("player: its subscriber falls silent", "exit code 3", _listener_silent, False),
        Fault("player: nobody listens", "exit code 3", _nobody_listens, False),
        Fault("player: SIGKILL and a new one", "the recorder has all messages of the new one", _player_killed, False),
    ]
