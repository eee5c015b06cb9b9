"""A late reader receives every later message."""

import pytest
from std_msgs.msg import Float64
from via_ros import qos


@pytest.mark.parametrize("already_sent", [0, 6000])
def test_a_late_reader_receives_every_later_message(graph, already_sent):
    talker, listener = graph.node("talker"), graph.node("listener")
    publisher = talker.create_publisher(Float64, "/late", qos.SAMPLES)
    for n in range(already_sent):
        publisher.publish(Float64(data=float(-n)))
    heard = []
    listener.create_subscription(Float64, "/late", lambda message: heard.append(message.data), qos.SAMPLES)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    discovered = []
    listener.create_timer(0.1, lambda: discovered.append(True))
    graph.until(lambda: bool(discovered))  # discovery is complete
    for n in range(100):
        publisher.publish(Float64(data=float(n)))
    graph.until(lambda: len(heard) == 100)
    assert heard == [float(n) for n in range(100)]
