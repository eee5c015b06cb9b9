"""Spinning: both executors, exit codes, deadlines; QoS profiles compatible with the offered ones."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest
import rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.task import Future
from std_msgs.msg import UInt64
from via_core.errors import ParameterError
from via_ros import qos
from via_ros.spin import EXECUTORS, STEADY, close_all, make_executor, remove, spin, spin_until

NODE_FILE = """
import sys
from rclpy.node import Node
from rclpy.task import Future
from via_core.errors import BagError
from via_ros.spin import run

class Short(Node):
    def __init__(self):
        super().__init__("short")
        self.finished = Future()
        self.create_timer(0.001, self.tick)
    def tick(self):
        if sys.argv[1] == "bad":
            raise BagError("the disk is full")
        if sys.argv[1] == "broken":
            raise ZeroDivisionError("a fault of ours")
        self.finished.set_result(int(sys.argv[1]))
    def close(self, failed=False):
        print("failed" if failed else "closed")

sys.exit(run(Short, args=sys.argv[2:]))
"""


@pytest.mark.parametrize("kind", EXECUTORS)
def test_every_message_is_received_and_the_future_ends_the_spin(graph, kind):
    node = graph.node("talker")
    graph.executor.remove_node(node)
    executor = make_executor(kind, graph.context)
    executor.add_node(node)
    finished, heard = Future(), []
    publisher = node.create_publisher(UInt64, "numbers", qos.SAMPLES)

    def hear(message):
        heard.append(message.data)
        if len(heard) == 500:
            finished.set_result(0)

    node.create_subscription(UInt64, "numbers", hear, qos.SAMPLES)
    assert spin_until(executor, lambda: publisher.get_subscription_count() == 1, 30.0)
    for k in range(500):
        publisher.publish(UInt64(data=k))
    spin(executor, finished)
    assert heard == list(range(500))
    executor.remove_node(node)
    executor.shutdown()


@pytest.mark.parametrize("kind", EXECUTORS)
def test_a_removed_node_is_not_called_any_more(graph, kind):
    """Callbacks of its timers stand in the events executor's queue at half of these removals."""
    executor, beats = make_executor(kind, graph.context), []
    other = rclpy.create_node("other", context=graph.context)
    executor.add_node(other)
    other.create_timer(0.001, lambda: beats.append(True), clock=STEADY)
    for number in range(1, 41):
        calls, closed = [], []
        node = rclpy.create_node("removed", context=graph.context)
        for period in (0.001, 0.002, 0.003):
            node.create_timer(period, lambda calls=calls, closed=closed: calls.append(bool(closed)), clock=STEADY)
        executor.add_node(node)
        assert spin_until(executor, lambda calls=calls, number=number: len(calls) >= number % 5 + 1, 30.0)
        remove(executor, node)
        close_all([node])
        closed.append(True)
        wanted = len(beats) + 5
        assert spin_until(executor, lambda wanted=wanted: len(beats) >= wanted, 30.0)
        assert not any(calls)
    remove(executor, other)
    close_all([other])
    executor.shutdown()


def test_garbage_collection_leaves_out_what_exists_while_callbacks_run(graph):
    node, finished, frozen = graph.node("watcher"), Future(), []
    gc.unfreeze()  # what the tests of this process have frozen

    def look():
        frozen.append(gc.get_freeze_count())
        finished.set_result(0)

    timer = node.create_timer(0.001, look, clock=STEADY)
    spin(graph.executor, finished)
    timer.cancel()
    assert frozen[0] > 10_000 and gc.get_freeze_count() == 0


def test_a_node_whose_process_goes_on_leaves_the_graph(graph):
    """rclpy's lifecycle nodes lie in cycles of references; one that stayed would be counted as a server for ever."""

    def session():
        context, finished = rclpy.Context(), Future()
        rclpy.init(args=[], context=context, domain_id=graph.context.get_domain_id())
        executor, node = make_executor(context=context), LifecycleNode("leaving", context=context)
        executor.add_node(node)
        assert spin_until(graph.executor, lambda: "leaving" in watcher.get_node_names(), 60.0)
        node.create_timer(0.001, lambda: finished.done() or finished.set_result(0), clock=STEADY)
        spin(executor, finished)
        remove(executor, node)
        close_all([node])
        executor.shutdown()
        context.try_shutdown()

    watcher = graph.node("watcher")
    session()
    gc.collect()
    assert spin_until(graph.executor, lambda: "leaving" not in watcher.get_node_names(), 60.0)


def test_a_finished_future_does_not_wait(graph):
    finished = Future()
    finished.set_result(0)
    spin(graph.executor, finished)


def test_a_condition_that_stays_false_has_a_deadline(graph):
    assert not spin_until(graph.executor, lambda: False, 0.0)


def test_unknown_executors_are_refused():
    with pytest.raises(ParameterError, match="threads"):
        make_executor("threads")


@pytest.mark.parametrize(
    ("how", "code", "last"),
    [("0", 0, "closed"), ("3", 3, "failed"), ("bad", 2, "failed"), ("broken", 1, "failed")],
)
@pytest.mark.parametrize("executor", EXECUTORS)
def test_the_exit_code_shows_how_a_node_ended(domain, how, code, last, executor):
    options = ["--ros-args", "-p", f"executor:={executor}"]
    done = subprocess.run(
        [sys.executable, "-c", NODE_FILE, how, *options], capture_output=True, text=True, timeout=600, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (code, last), done.stderr
    assert ("the disk is full" in done.stderr) == (how == "bad")
    assert ("Traceback" in done.stderr) == (how == "broken")


def profile(reliable, latched):
    return QoSProfile(
        depth=5,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


@pytest.mark.parametrize("first", [(True, True), (True, False), (False, True), (False, False)])
@pytest.mark.parametrize("second", [(True, True), (True, False), (False, True), (False, False)])
def test_a_recorder_is_compatible_with_every_offer(first, second):
    offers = [profile(*first), profile(*second)]
    heard = qos.matching(offers)
    assert all(qos_check_compatible(offer, heard)[0] != QoSCompatibility.ERROR for offer in offers)
    if first == second:
        assert (heard.reliability, heard.durability) == (offers[0].reliability, offers[0].durability)


@pytest.mark.parametrize("offer", [(True, True), (True, False), (False, True), (False, False)])
def test_a_player_offers_what_was_offered(offer):
    import yaml

    text = yaml.safe_dump([qos.as_offered(profile(*offer)).as_rosbag2()])
    again = qos.from_bag(text)
    assert (again.reliability, again.durability) == (profile(*offer).reliability, profile(*offer).durability)
    assert again.depth == qos.SAMPLES.depth


def test_a_player_offers_the_policies_that_bags_before_jazzy_number():
    again = qos.from_bag("- {history: 1, depth: 10, reliability: 2, durability: 1}")
    assert again.reliability == ReliabilityPolicy.BEST_EFFORT and again.durability == DurabilityPolicy.TRANSIENT_LOCAL


@pytest.mark.parametrize("text", ["", "[]", "nonsense", "- 3", "{", "- reliability: perhaps\n  depth: many"])
def test_a_player_accepts_unknown_qos_policies(text):
    assert qos.from_bag(text).reliability == ReliabilityPolicy.RELIABLE
