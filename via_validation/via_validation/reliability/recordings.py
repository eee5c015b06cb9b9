"""Faults of recordings: folders, disks, clocks, publishers."""

from __future__ import annotations

import resource
import shutil
import signal
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from via_core.bags.reader import Bag, read_bag
from via_core.bags.recovery import recover
from via_interfaces.msg import VsaCommand
from via_ros import qos
from via_ros.conversions import set_stamp
from via_ros.nodes.recorder import Recorder

from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph, Process

COMMANDS, COMMAND = "/robot/command", "via_interfaces/msg/VsaCommand"
TEXT = "/text:std_msgs/msg/String"
PERIOD = 0.002  # [s]
HUGE = 8_000_000  # characters
FULL = 200_000  # [bytes]


class Source:
    """Publishes numbered commands."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.node = graph, graph.node("robot")
        self.publisher = graph.publisher(VsaCommand, COMMANDS, self.node)
        self.message = VsaCommand()

    def send(self, count: int) -> None:
        """Publish so many messages."""
        for _ in range(count):
            set_stamp(self.message.header.stamp, (1 + self.message.sequence) * 1_000_000)
            self.publisher.publish(self.message)
            self.message.sequence += 1
            self.graph.pause(PERIOD)

    def send_until_end(self, recorder: Process) -> None:
        """Publish until the recorder has ended."""

        def ended() -> bool:
            self.send(1)
            return recorder.code is not None

        self.graph.until(ended, "the end of the recorder")


def _recorder(graph: Graph, *topics: str, bag: str = "bag", **parameters: Any) -> Any:
    """A recorder in this process."""
    wanted = list(topics) or [f"{COMMANDS}:{COMMAND}"]
    return graph.add(Recorder, bag=str(graph.folder / bag), topics=wanted, **parameters)


def _executable(
    graph: Graph, topic: str = f"{COMMANDS}:{COMMAND}", bag: str = "bag", options: dict[str, Any] | None = None
) -> Process:
    return graph.start("via_ros", "recorder", f"bag:={bag}", f"topics:=['{topic}']", options=options)


def _one_line(process: Process, *texts: str) -> str:
    """The error of a process: one line that contains the texts, beside those that say what it does."""
    # Coloured lines are of the middleware: a full disk also takes its shared memory.
    skipped = ("[INFO]", "[WARN]", "\x1b")
    lines = [each for each in process.errors().splitlines() if each and not each.startswith(skipped)]
    seen = f"exit code {process.code}, '{(lines or [''])[-1][:80]}'"
    good = process.code == 2 and len(lines) == 1 and all(text in lines[0] for text in texts)
    expect(good, f"{seen}, {len(lines)} lines: {' / '.join(lines)}")
    return seen


def _numbers(bag: Bag, topic: str = COMMANDS) -> list[int]:
    return [int(each) for each in bag[topic]["sequence"]]


# ---- folders and disks


def _folder_removed(graph: Graph) -> str:
    source, recorder = Source(graph), _executable(graph)
    graph.connected(source.publisher)
    source.send(100)
    shutil.rmtree(graph.folder / "bag")
    source.send_until_end(recorder)
    return _one_line(recorder, "cannot write the bag")


def _file_replaced(graph: Graph) -> str:
    source, recorder = Source(graph), _executable(graph)
    graph.connected(source.publisher)
    source.send(100)
    (graph.folder / "bag" / "bag_0.mcap.active").rename(graph.folder / "kept.mcap")
    (graph.folder / "bag" / "bag_0.mcap.active").touch()
    source.send_until_end(recorder)
    found = _numbers(read_bag(graph.folder / "kept.mcap"))
    expect(found == list(range(found[0], found[0] + len(found))) and len(found) > 50, f"{len(found)} messages kept")
    return f"{_one_line(recorder, 'it has been replaced')}; {len(found)} messages kept"


def _disk_full(graph: Graph) -> str:
    limit: dict[str, Any] = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (FULL, FULL))}
    recorder = _executable(graph, TEXT, options=limit)
    publisher, random = graph.publisher(String, "/text"), np.random.default_rng(0)
    graph.connected(publisher)
    sent = []

    def over() -> bool:
        sent.append(random.bytes(5000).hex())
        publisher.publish(String(data=sent[-1]))
        graph.pause(0.02)
        return recorder.code is not None

    graph.until(over, "the end of the recorder")
    seen = _one_line(recorder, "File too large")
    kept = [str(each) for each in _texts(read_bag(graph.folder / "bag"))]
    begin = sent.index(kept[0])  # discovery takes time
    expect(kept == sent[begin : begin + len(kept)], f"other messages kept than were sent, {len(kept)} of {len(sent)}")
    expect(sum(map(len, kept)) > FULL / 2, f"{len(kept)} of {len(sent)} messages kept")
    return f"{seen}; {len(kept)} messages kept"


def _texts(bag: Bag) -> list[str]:
    return [deserialize_message(bytes(each), String).data for each in bag.topic("/text").payloads()]


def _refused(bag: str, text: str, graph: Graph) -> str:
    """Folders in which no bag can be made."""
    (graph.folder / "file").write_text("a file")
    (graph.folder / "taken").mkdir()
    recorder = _executable(graph, bag=bag)
    graph.until(lambda: recorder.code is not None, "the end of the recorder")
    expect((graph.folder / "file").read_text() == "a file", "the file has changed")
    return _one_line(recorder, text)


def _ended(number: int, graph: Graph) -> str:
    """A signal in the middle of a stream: the bag must be complete."""
    source, recorder = Source(graph), _executable(graph)
    graph.connected(source.publisher)
    source.send(200)
    recorder.signal(number)
    source.send_until_end(recorder)
    bag, found = read_bag(graph.folder / "bag"), _numbers(read_bag(graph.folder / "bag"))
    expect(recorder.code == 0 and bag.complete, f"exit code {recorder.code}, {'; '.join(bag.remarks)}")
    expect(found == list(range(len(found))) and len(found) >= 200, f"{found[:1]} to {found[-1:]}")
    return f"exit code 0, a complete bag of {len(found)} messages, none missing"


def _killed(graph: Graph) -> str:
    source, recorder = Source(graph), _executable(graph)
    graph.connected(source.publisher)
    source.send(200)
    graph.pause(0.3)  # longer than two flushes
    recorder.kill()
    recover(graph.folder / "bag", graph.folder / "recovered")
    found = _numbers(read_bag(graph.folder / "recovered"))
    expect(found == list(range(200)), f"{len(found)} of 200 messages that were sent .3 s before the kill")
    return "all 200 messages that were sent .3 s before the kill are recovered"


# ---- clocks and publishers


def _clock_jumps(jumps: tuple[int, ...], graph: Graph) -> str:
    source, recorder = Source(graph), _recorder(graph, use_sim_time=True)
    clock = graph.node("clock").create_publisher(Clock, "/clock", qos.CONTROL)
    graph.connected(source.publisher, clock)
    for second in jumps:
        clock.publish(Clock(clock=Time(sec=second)))
        graph.until(lambda: recorder.get_clock().now().nanoseconds == second * 10**9, "the time")  # noqa: B023
        source.send(20)
    graph.until(lambda: recorder.counts[COMMANDS].messages == 20 * len(jumps), "all messages")
    graph.remove(recorder)
    bag = read_bag(graph.folder / "bag")
    span = 1e-9 * float(np.ptp(bag[COMMANDS].log_time))
    expect(_numbers(bag) == list(range(20 * len(jumps))), "messages are missing")
    expect(not bag.complete and "jumped" in bag.remarks[0] and span < 600.0, f"{bag.remarks}, span {span:g} s")
    return f"all messages in a span of {span:.1f} s; remark: {bag.remarks[0]}"


def _odd_stamps(graph: Graph) -> str:
    """Stamps of zero, before 1970 and in the far future: they are data."""
    recorder = _recorder(graph)
    publisher = graph.publisher(VsaCommand, COMMANDS)
    graph.connected(publisher)
    stamps = (0, -(2**31) * 10**9, (2**31 - 1) * 10**9, 5, 0)
    for number, stamp in enumerate(stamps):
        message = VsaCommand(sequence=number)
        set_stamp(message.header.stamp, stamp)
        publisher.publish(message)
    graph.until(lambda: recorder.counts[COMMANDS].messages == len(stamps), "all messages")
    graph.remove(recorder)
    found = [int(each) for each in read_bag(graph.folder / "bag")[COMMANDS].stamp]
    expect(sorted(found) == sorted(stamps), f"stamps {found}")
    return f"{len(stamps)} messages with their stamps"


def _publisher_restarts(graph: Graph) -> str:
    source, recorder = Source(graph), _recorder(graph)
    graph.connected(source.publisher)
    source.send(100)
    graph.until(lambda: recorder.counts[COMMANDS].messages == 100, "all messages")
    graph.remove(source.node)
    again = graph.node("robot_again")
    publisher = graph.publisher(VsaCommand, COMMANDS, again)
    graph.connected(publisher)
    for number in range(100):
        publisher.publish(VsaCommand(sequence=number))
        graph.pause(PERIOD)
    graph.until(lambda: recorder.counts[COMMANDS].messages == 200, "all messages")
    lost = recorder.counts[COMMANDS].lost
    graph.remove(recorder)
    bag = read_bag(graph.folder / "bag")
    expect(bag.complete and sorted(_numbers(bag)) == sorted(2 * list(range(100))) and not lost, f"{lost} called lost")
    return "all messages of both publishers, none called lost"


def _gap_is_reported(graph: Graph) -> str:
    graph.observe_diagnostics()
    source, recorder = Source(graph), _recorder(graph)
    graph.connected(source.publisher)
    source.send(10)
    source.message.sequence += 5
    source.send(10)
    graph.reported("messages are missing")
    graph.until(lambda: recorder.counts[COMMANDS].messages == 20, "all messages")
    lost = recorder.counts[COMMANDS].lost
    expect(lost == 5, f"{lost} of 5 reported")
    return "5 of 5 missing numbers reported"


def _bad_messages(graph: Graph) -> str:
    recorder = _recorder(graph)
    publisher = graph.publisher(VsaCommand, COMMANDS)
    graph.connected(publisher)
    whole = bytes(serialize_message(VsaCommand(sequence=7)))
    bad = (b"", b"\0\1\0\0", whole[:14], whole[:18])
    for data in (whole, *bad, whole):
        publisher.publish(data)
    graph.until(lambda: recorder.counts[COMMANDS].messages == 2, "both good messages")
    malformed = recorder.counts[COMMANDS].malformed
    graph.remove(recorder)
    expect(malformed == len(bad) and _numbers(read_bag(graph.folder / "bag")) == [7, 7], f"{malformed} malformed")
    return f"{len(bad)} left out and counted, the good ones recorded"


def _huge_messages(graph: Graph) -> str:
    recorder = _recorder(graph, TEXT)
    publisher = graph.publisher(String, "/text")
    graph.connected(publisher)
    for letter in "abc":
        publisher.publish(String(data=HUGE * letter))
        graph.pause(0.1)
    graph.until(lambda: recorder.counts["/text"].messages == 3, "all messages")
    graph.remove(recorder)
    bag = read_bag(graph.folder / "bag")
    expect(bag.complete and [each[0] for each in _texts(bag)] == ["a", "b", "c"], "messages are missing")
    return f"3 messages of {HUGE // 1_000_000} MB in a complete bag"


def faults() -> list[Fault]:
    """The faults of this group."""
    line, kept = "exit code 2 with one line", "exit code 2 with one line; what was written stays"
    complete, data = "exit code 0, a complete bag, nothing missing", "all messages, the jumps are remarked"
    return [
        Fault("the bag's folder is removed", line, _folder_removed, False),
        Fault("the bag's file is replaced", kept, _file_replaced, False),
        Fault("the disk is full", kept, _disk_full, False),
        Fault("the bag exists", line, partial(_refused, "taken", "exists already"), False),
        Fault("the bag's folder would be in a file", line, partial(_refused, "file/bag", "cannot create"), False),
        Fault("the bag's name is too long", line, partial(_refused, 300 * "x", "cannot create"), False),
        Fault("SIGINT while messages arrive", complete, partial(_ended, signal.SIGINT), False),
        Fault("SIGTERM while messages arrive", complete, partial(_ended, signal.SIGTERM), False),
        Fault("SIGKILL .3 s after the last message", "all messages are recovered", _killed, False),
        Fault("simulated time jumps 63 years forward", data, partial(_clock_jumps, (1, 2_000_000_000))),
        Fault("simulated time jumps backward", data, partial(_clock_jumps, (2_000_000_000, 5, 3)), False),
        Fault("stamps zero, before 1970 and in the far future", "all messages with their stamps", _odd_stamps, False),
        Fault("the publisher is restarted", "all messages, none called lost", _publisher_restarts, False),
        Fault("five numbers are missing", "reported", _gap_is_reported),
        Fault("empty and truncated messages", "left out and counted, the others recorded", _bad_messages, False),
        Fault("messages of 8 MB", "all in a complete bag", _huge_messages, False),
    ]
