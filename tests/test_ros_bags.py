"""Recorder and player in a graph: complete, ordered, bit-exact, with errors reported."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import BagError, ParameterError
from via_interfaces.msg import StiffnessEstimate
from via_ros import qos
from via_ros.conversions import JointStateWriter, nanoseconds, set_stamp
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder

DEVICE = load_device("cubic_aa_vsa")
SAMPLES = "/joint_states"
ANSWERS = f"/{DEVICE.name}/stiffness"
TYPES = {SAMPLES: "sensor_msgs/msg/JointState", ANSWERS: "via_interfaces/msg/StiffnessEstimate"}
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
START = 1_700_000_000_123_456_789  # [ns]


@pytest.fixture
def bag(tmp_path):
    """A bag with 3000 samples at 1 kHz whose log times are in disorder: only the stamps give the order."""
    rng = np.random.default_rng(1)
    path = tmp_path / "original"
    writer = JointStateWriter(DEVICE)
    with BagWriter(path) as out:
        out.add_topic(SAMPLES, TYPES[SAMPLES])
        for k in rng.permutation(3000):
            writer.position[:] = rng.normal(size=3)
            writer.effort[1:] = k
            data = serialize_message(writer.stamped(START + 1_000_000 * int(k)))
            out.write(SAMPLES, data, log_time=START + 1_000_000 * int(k) + int(rng.integers(0, 10**8)))
    return path


def answer_samples(node):
    """A subscriber that answers every sample, as an estimator does; returns the received samples."""
    heard = []
    publisher = node.create_publisher(StiffnessEstimate, ANSWERS, qos.SAMPLES)

    def answer(data):
        message = deserialize_message(data, JointState)
        estimate = StiffnessEstimate(sequence=len(heard))
        estimate.header.stamp = message.header.stamp
        heard.append(data)
        publisher.publish(estimate)

    node.create_subscription(JointState, SAMPLES, answer, qos.SAMPLES, raw=True)
    return heard


def test_a_played_and_recorded_bag_is_complete_and_bit_exact(graph, bag, tmp_path):
    heard = answer_samples(graph.node("estimator"))
    wanted = [f"{name}:{kind}" for name, kind in TYPES.items()]
    recorder = graph.add(Recorder, bag=str(tmp_path / "again"), topics=wanted)
    player = graph.add(Player, bag=str(bag), rate=0.0, subscribers=2, answers=[ANSWERS], window=100)
    graph.until(player.finished.done)
    assert player.finished.result() == 0
    graph.until(lambda: all(recorder.counts[name].messages == 3000 for name in TYPES))
    assert recorder.counts[ANSWERS].lost == 0
    graph.remove(recorder)
    original = [message.data for message in read_bag(bag).in_stamp_order()]
    again = read_bag(tmp_path / "again")
    assert again.complete
    assert list(again.topic(SAMPLES).payloads()) == original == heard
    assert np.array_equal(again[ANSWERS]["sequence"], np.arange(3000))
    assert np.array_equal(again[ANSWERS].stamp, np.sort(read_bag(bag)[SAMPLES].stamp))


def test_clock_runs_ahead_of_every_sample(graph, bag):
    listener = graph.node("listener")
    heard = []
    listener.create_subscription(Clock, "/clock", lambda message: heard.append(nanoseconds(message.clock)), qos.SAMPLES)
    answer_samples(listener)
    player = graph.add(Player, bag=str(bag), rate=0.0, answers=[ANSWERS])
    graph.until(player.finished.done)
    graph.until(lambda: len(heard) == 3000)
    assert heard == sorted(START + 1_000_000 * k for k in range(3000))


def test_rate_keeps_the_pace_of_the_stamps(graph, bag, monkeypatch):
    """With a fake clock: the pace is the waiting time that the player requests."""
    due = []
    player_wait = Player._sleep_until
    monkeypatch.setattr(Player, "_sleep_until", lambda self, time: due.append(time))
    answer_samples(graph.node("listener"))
    player = graph.add(Player, bag=str(bag), rate=4.0)
    graph.until(player.finished.done)
    assert player_wait is not Player._sleep_until
    assert np.array_equal(np.diff(due[1:]), np.full(2999, 250_000))


def test_player_stops_when_a_subscriber_stops_answering(graph, bag, capsys):
    listener = graph.node("listener")
    publisher = listener.create_publisher(StiffnessEstimate, ANSWERS, qos.SAMPLES)
    heard = []
    listener.create_subscription(JointState, SAMPLES, heard.append, qos.SAMPLES)
    player = graph.add(Player, bag=str(bag), rate=0.0, answers=[ANSWERS], window=50, patience=1.0)
    graph.until(player.finished.done)
    assert player.finished.result() == 3
    assert player.played == 50
    assert ANSWERS in capsys.readouterr().err
    assert publisher.get_subscription_count() == 1


def test_player_waits_for_the_number_of_subscribers(graph, bag, capsys):
    player = graph.add(Player, bag=str(bag), patience=0.3, subscribers=2)
    graph.until(player.finished.done)
    assert (player.finished.result(), player.played) == (3, 0)
    assert "2 subscribers" in capsys.readouterr().err


def test_player_places_messages_of_another_clock_by_log_time(graph, tmp_path, monkeypatch):
    """Samples of a simulated robot start at zero; messages without a header have the wall time of the recording."""
    writer = JointStateWriter(DEVICE)
    writer.position[:] = writer.effort[1:] = 0.0
    with BagWriter(tmp_path / "simulated") as out:
        for name, kind in ((SAMPLES, TYPES[SAMPLES]), ("/events", "std_msgs/msg/String"), ("/clock", CLOCK_TYPE)):
            out.add_topic(name, kind)
        for k in range(10):
            now = START + 2_000_000 * k
            out.write(SAMPLES, serialize_message(writer.stamped(1_000_000 * k)), log_time=now)
            out.write("/clock", serialize_message(Clock()), log_time=now)
            out.write("/events", serialize_message(String(data=str(k))), log_time=now + 1_000_000)
    due = []
    monkeypatch.setattr(Player, "_sleep_until", lambda self, time: due.append(time))
    player = graph.add(Player, bag=str(tmp_path / "simulated"), rate=1.0, subscribers=0)
    graph.until(player.finished.done)
    assert (player.finished.result(), player.played) == (0, 20)
    assert np.array_equal(np.diff(due[1:]), [500_000] * 18 + [0])


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [({}, "bag"), ({"bag": "nowhere"}, "nowhere"), ({"bag": "nowhere", "rate": -1.0}, "rate")],
)
def test_player_errors_give_the_reason(graph, parameters, complaint):
    with pytest.raises((ParameterError, BagError), match=complaint):
        graph.add(Player, **parameters)


def test_player_names_a_missing_topic(graph, bag):
    with pytest.raises(BagError, match="/missing"):
        graph.add(Player, bag=str(bag), topics=["/missing"])


def test_recorder_finds_a_topic_that_appears_later_and_counts_the_missing(graph, tmp_path):
    recorder = graph.add(Recorder, bag=str(tmp_path / "late"), topics=[ANSWERS])
    publisher = graph.node("late").create_publisher(StiffnessEstimate, ANSWERS, qos.SAMPLES)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    message = StiffnessEstimate()
    for k in (0, 1, 4, 5, 9):
        message.sequence = k
        set_stamp(message.header.stamp, k)
        publisher.publish(message)
    graph.until(lambda: ANSWERS in recorder.counts and recorder.counts[ANSWERS].messages == 5)
    assert recorder.counts[ANSWERS].lost == 5
    graph.remove(recorder)
    assert np.array_equal(read_bag(tmp_path / "late")[ANSWERS]["sequence"], [0, 1, 4, 5, 9])


@pytest.mark.parametrize("topics", [[], [ANSWERS], [f"{ANSWERS}:{TYPES[ANSWERS]}"]], ids=["all", "name", "type"])
def test_recorder_finds_publishers_of_any_qos_that_appear_later(graph, tmp_path, topics):
    """First a subscriber without a publisher, then a reliable publisher, then a best-effort one."""
    recorder = graph.add(Recorder, bag=str(tmp_path / "late"), topics=topics)
    robot = graph.node("robot")
    robot.create_subscription(StiffnessEstimate, ANSWERS, lambda _: None, qos.SAMPLES)
    for number, profile in enumerate((qos.SAMPLES, QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))):
        publisher = robot.create_publisher(StiffnessEstimate, ANSWERS, profile)

        def recorded(number=number, publisher=publisher):
            publisher.publish(StiffnessEstimate(sequence=number, value=float(number)))
            return ANSWERS in recorder.counts and recorder.counts[ANSWERS].last == number

        graph.until(recorded, 60.0)
    graph.remove(recorder)
    assert set(read_bag(tmp_path / "late")[ANSWERS]["sequence"]) == {0, 1}


def test_recorder_reports_topics_without_a_message(graph, tmp_path, capsys):
    graph.remove(graph.add(Recorder, bag=str(tmp_path / "empty"), topics=[SAMPLES]))
    assert f"0 messages on 0 topics, 0 missing; no message on {SAMPLES}" in capsys.readouterr().err


def test_a_failing_recorder_leaves_no_finished_bag(graph, tmp_path):
    recorder = graph.add(Recorder, bag=str(tmp_path / "half"), topics=[f"{SAMPLES}:{TYPES[SAMPLES]}"])
    publisher = graph.node("robot").create_publisher(JointState, SAMPLES, qos.SAMPLES)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(JointState(name=["a"]))
    graph.until(lambda: recorder.counts[SAMPLES].messages == 1)
    recorder.close(failed=True)
    assert not (tmp_path / "half" / "metadata.yaml").exists()
    assert not list((tmp_path / "half").glob("*.mcap"))
    assert not read_bag(tmp_path / "half").complete


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [({}, "bag"), ({"bag": "new", "topics": ["/a:no_such_msgs/msg/Thing"]}, "no_such_msgs/msg/Thing")],
)
def test_recorder_errors_give_the_reason_and_leave_no_bag(graph, tmp_path, monkeypatch, parameters, complaint):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ParameterError, BagError), match=complaint):
        graph.add(Recorder, **parameters)
    assert not list(tmp_path.iterdir())


def test_without_answers_full_speed_still_loses_nothing(graph, bag):
    heard = []
    listener = graph.node("listener")
    listener.create_subscription(JointState, SAMPLES, heard.append, qos.SAMPLES, raw=True)
    player = graph.add(Player, bag=str(bag), rate=0.0)
    graph.until(player.finished.done)
    graph.until(lambda: len(heard) == 3000)
    assert heard == [message.data for message in read_bag(bag).in_stamp_order()]
