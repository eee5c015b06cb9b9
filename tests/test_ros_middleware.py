"""A late reader receives every later message; sockets listen on the loopback interface unless opened."""

import os
import subprocess
import sys
from importlib.resources import files
from xml.etree import ElementTree

import psutil
import pytest
from std_msgs.msg import Float64
from via_ros import middleware, qos


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


NODE = """
import rclpy, sys
from via_ros import middleware
middleware.prepare()
rclpy.init()
node = rclpy.create_node("node")
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize(("opened", "everywhere"), [({}, False), ({middleware.RANGE: "SUBNET"}, True)])
def test_sockets_of_discovery_listen_on_the_loopback_interface_unless_opened(domain, opened, everywhere):
    own = {key: value for key, value in os.environ.items() if key not in (middleware.RANGE, middleware.PROFILE)}
    with subprocess.Popen(
        [sys.executable, "-c", NODE], env=own | opened, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as node:
        assert node.stdout.readline() == "ready\n"
        ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))  # of this domain, by the DDS standard
        found = [each.laddr for each in psutil.Process(node.pid).net_connections() if each.laddr.port in ports]
        node.stdin.close()
    assert found and any(each.ip != "127.0.0.1" for each in found) == everywhere


def test_the_environment_file_limits_discovery_unless_opened(root):
    def found(**given):
        own = {key: value for key, value in os.environ.items() if key != middleware.RANGE}
        script = f"source {root}/ros2_ws/env.sh; echo $ROS_AUTOMATIC_DISCOVERY_RANGE"
        return subprocess.run(["bash", "-c", script], env=own | given, capture_output=True, text=True).stdout.strip()

    assert (found(), found(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")) == ("LOCALHOST", "SUBNET")


@pytest.mark.parametrize("name", ["fastdds.xml", "fastdds_localhost.xml"])
def test_writers_say_what_they_have_sent_before_a_history_at_1_khz_is_replaced(name):
    """Several times: what a reader lost while it could not read may be lost again."""
    namespace = "{http://www.eprosima.com}"
    root = ElementTree.fromstring(files("via_ros").joinpath(name).read_text("utf-8"))
    period = root.find(f".//{namespace}data_writer[@is_default_profile='true']//{namespace}heartbeatPeriod")
    seconds, nanoseconds = (float(period.findtext(f"{namespace}{part}")) for part in ("sec", "nanosec"))
    assert 0.0 < seconds + 1e-9 * nanoseconds <= 0.2 * qos.SAMPLES.depth / 1000.0
