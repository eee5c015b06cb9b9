"""The recorder under faults: what it loses, and what it reports."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from via_core.bags.reader import read_bag
from via_core.bags.recovery import recover
from via_core.bags.writer import BagWriter
from via_core.errors import BagError
from via_interfaces.msg import VsaCommand
from via_ros import qos
from via_ros.conversions import nanoseconds, set_stamp
from via_ros.nodes.recorder import Recorder
from via_ros.spin import close_all, remove

COMMANDS = "/robot/command"
TYPE = "via_interfaces/msg/VsaCommand"
PERIOD = 0.005  # [s]
WITHIN = 0.1  # [s]


class Robot:
    """Publishes numbered messages, stamped with the time now."""

    def __init__(self, graph, depth=qos.SAMPLES):
        self.graph = graph
        self.publisher = graph.node("robot").create_publisher(VsaCommand, COMMANDS, depth)
        self.message, self.due = VsaCommand(), time.monotonic()

    def run(self, until):
        while not until():
            set_stamp(self.message.header.stamp, time.time_ns())
            self.publisher.publish(self.message)
            self.message.sequence += 1
            self.due = max(self.due + PERIOD, time.monotonic())
            self.graph.until(lambda: time.monotonic() >= self.due)


def executable():
    prefixes = [Path(prefix) for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)]
    return next(path for prefix in prefixes if (path := prefix / "lib" / "via_ros" / "recorder").is_file())


def started(folder, **options):
    return subprocess.Popen(
        [executable(), "--ros-args", "-p", "bag:=new", "-p", f"topics:=['{COMMANDS}:{TYPE}']"],
        cwd=folder, stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def test_a_killed_recorder_has_lost_no_more_than_its_last_100_ms(graph, tmp_path):
    robot, recorder = Robot(graph), started(tmp_path)
    try:
        graph.until(lambda: robot.publisher.get_subscription_count() == 1)
        robot.run(lambda: robot.message.sequence > 300)
        recorder.send_signal(signal.SIGSTOP)  # its present state, however busy the machine is
        last = nanoseconds(robot.message.header.stamp)
    finally:
        recorder.kill()
        recorder.communicate()
    found = read_bag(tmp_path / "new")[COMMANDS]
    assert list(found["sequence"]) == list(range(len(found)))
    assert (last - found.stamp[-1]) * 1e-9 < WITHIN + 0.05  # up to one timer late
    assert recover(tmp_path / "new", tmp_path / "saved").messages == {COMMANDS: len(found)}


def test_a_long_recording_has_several_files(graph, tmp_path):
    robot = Robot(graph)
    parameters = {"bag": str(tmp_path / "bag"), "topics": [f"{COMMANDS}:{TYPE}"], "max_bag_duration": 1.0}
    recorder = graph.add(Recorder, **parameters)
    graph.until(lambda: robot.publisher.get_subscription_count() == 1)
    robot.run(lambda: (tmp_path / "bag" / "bag_2.mcap.active").exists())
    graph.remove(recorder)
    bag = read_bag(tmp_path / "bag")
    first = int(bag[COMMANDS]["sequence"][0])
    assert bag.complete and list(bag[COMMANDS]["sequence"]) == list(range(first, robot.message.sequence))


def test_a_removed_folder_ends_the_recorder_with_one_line(graph, tmp_path):
    robot, recorder = Robot(graph), started(tmp_path)
    try:
        graph.until(lambda: robot.publisher.get_subscription_count() == 1)
        robot.run(lambda: robot.message.sequence > 50)
        shutil.rmtree(tmp_path / "new")
        robot.run(lambda: recorder.poll() is not None)
    finally:
        recorder.kill()
    errors = [each for each in recorder.communicate()[1].splitlines() if not each.startswith(("[INFO]", "[WARN]"))]
    assert recorder.returncode == 2
    assert errors == ["recorder: cannot write the bag new: No such file or directory"]


def test_a_replaced_file_is_noticed(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    bag.flush()
    active = tmp_path / "bag" / "bag_0.mcap.active"
    active.unlink()
    active.touch()
    with pytest.raises(BagError, match="it has been replaced"):
        bag.flush()
    bag.abandon()


def test_jumps_of_simulated_time_are_in_the_bag_and_do_not_stretch_it(graph, tmp_path):
    robot, clock = Robot(graph), graph.node("clock").create_publisher(Clock, "/clock", qos.CONTROL)
    recorder = graph.add(Recorder, bag=str(tmp_path / "bag"), topics=[f"{COMMANDS}:{TYPE}"], use_sim_time=True)
    graph.until(lambda: clock.get_subscription_count() and robot.publisher.get_subscription_count())
    for second in (1, 2_000_000_000, 5):
        clock.publish(Clock(clock=Time(sec=second)))
        graph.until(lambda: recorder.get_clock().now().nanoseconds == second * 10**9)  # noqa: B023
        count = recorder.counts[COMMANDS].messages
        robot.run(lambda: recorder.counts[COMMANDS].messages > count + 3)  # noqa: B023
    graph.remove(recorder)
    bag = read_bag(tmp_path / "bag")
    assert not bag.complete and "simulated time has jumped" in bag.remarks[0]
    log_time = bag[COMMANDS].log_time
    assert (log_time[1:] >= log_time[:-1]).all() and log_time[-1] - log_time[0] < 1e12


def test_messages_sent_before_the_first_recorded_one_are_reported(graph, tmp_path, capfd):
    robot = Robot(graph)
    robot.run(lambda: robot.message.sequence == 32)
    recorder = graph.add(Recorder, bag=str(tmp_path / "bag"), topics=[COMMANDS])
    graph.until(lambda: robot.publisher.get_subscription_count() == 1)
    robot.run(lambda: recorder.counts[COMMANDS].messages >= 5)
    graph.remove(recorder)
    before = int(read_bag(tmp_path / "bag")[COMMANDS]["sequence"][0])
    assert before >= 32
    assert f"0 missing; sent before the first recorded one: {before} on {COMMANDS}" in capfd.readouterr().err


def test_messages_that_wait_in_the_queue_at_the_end_are_recorded(graph, tmp_path):
    robot = Robot(graph)
    recorder = graph.add(Recorder, bag=str(tmp_path / "bag"), topics=[f"{COMMANDS}:{TYPE}"])
    (subscription,) = recorder._subscriptions_of.values()
    graph.until(lambda: robot.publisher.get_subscription_count() == 1 and subscription.get_publisher_count() == 1)
    graph.nodes.remove(recorder)
    remove(graph.executor, recorder)  # a machine under load: the executor has not come to them
    for _ in range(50):
        robot.publisher.publish(robot.message)
        robot.message.sequence += 1
    assert robot.publisher.wait_for_all_acked(Duration(seconds=600))
    close_all([recorder])
    bag = read_bag(tmp_path / "bag")
    assert bag.complete and list(bag[COMMANDS]["sequence"]) == list(range(50))
