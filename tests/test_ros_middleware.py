"""A late reader receives every later message; nodes use UDP on the loopback interface unless opened."""

import os
import subprocess
import sys
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
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
PLAIN = """
import rclpy, select, sys
from std_msgs.msg import Float64
rclpy.init()
publisher = rclpy.create_node("plain").create_publisher(Float64, "/plain", 10)
while not select.select([sys.stdin], [], [], 0.05)[0]:
    publisher.publish(Float64(data=1.0))
"""
TALKER = """
import rclpy, time
from pathlib import Path
from std_msgs.msg import Float64
from via_ros import middleware, qos
middleware.prepare()
rclpy.init()
publisher = rclpy.create_node("talker").create_publisher(Float64, "/talk", qos.SAMPLES)
threads = [each for each in Path("/proc/self/task").iterdir() if each.joinpath("comm").read_text().startswith("dds.ev")]
assert threads
def waits():
    status = "".join(each.joinpath("status").read_text() for each in threads)
    return sum(int(line.split()[1]) for line in status.splitlines() if line.startswith("voluntary"))
while not publisher.get_subscription_count():
    time.sleep(0.01)
before, begin = waits(), time.monotonic()
for n in range(1000):
    publisher.publish(Float64(data=float(n)))
    time.sleep(0.001)
print(waits() - before, time.monotonic() - begin, flush=True)
"""
READ = (middleware.RANGE, middleware.PROFILE, middleware.TRANSPORTS)


def ports(domain):
    """Ports of `domain`, by the DDS standard."""
    return range(7400 + 250 * domain, 7400 + 250 * (domain + 1))


@contextmanager
def running_node(**given):
    """The process of a node whose environment holds `given` and nothing else that the middleware reads."""
    own = {key: value for key, value in os.environ.items() if key not in READ}
    with subprocess.Popen(
        [sys.executable, "-c", NODE], env=own | given, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as node:
        assert node.stdout.readline() == "ready\n"
        yield psutil.Process(node.pid)
        node.stdin.close()


LOCAL = [{}, {middleware.RANGE: "LOCALHOST"}]
OPENED = [
    {middleware.RANGE: "SUBNET"},
    {
        middleware.RANGE: "SUBNET",
        middleware.PROFILE: str(Path(middleware.__file__).resolve().with_name("fastdds_localhost.xml")),
    },
]


@pytest.mark.parametrize("given", LOCAL)
def test_all_sockets_of_a_node_are_on_the_loopback_interface(domain, given):
    with running_node(**given) as node:
        addresses = [each.laddr for each in node.net_connections()]
    assert {each.ip for each in addresses} == {"127.0.0.1"}
    assert any(each.port in ports(domain) for each in addresses)


@pytest.mark.parametrize("given", OPENED)
def test_discovery_can_be_opened_also_by_the_child_of_a_limited_process(domain, given):
    with running_node(**given) as node:
        found = [each.laddr.ip for each in node.net_connections() if each.laddr.port in ports(domain)]
    assert "0.0.0.0" in found


@pytest.mark.parametrize("given", LOCAL + OPENED)
def test_no_node_opens_shared_memory_of_the_middleware(domain, given):
    with running_node(**given) as node:
        mapped = [each.path for each in node.memory_maps()]
    assert mapped and not [each for each in mapped if each.startswith("/dev/shm/fast")]


def test_a_node_finds_one_of_plain_ros_on_this_host(graph):
    """A process that knows nothing of the profile, with the discovery range of the environment file."""
    own = {key: value for key, value in os.environ.items() if key not in READ} | {middleware.RANGE: "LOCALHOST"}
    listener = graph.node("listener")
    heard = []
    listener.create_subscription(Float64, "/plain", lambda message: heard.append(message.data), qos.SAMPLES)
    with subprocess.Popen([sys.executable, "-c", PLAIN], env=own, stdin=subprocess.PIPE, text=True) as talker:
        try:
            graph.until(lambda: bool(heard))
        finally:
            talker.stdin.close()
    assert set(heard) == {1.0}


def test_a_message_does_not_wake_the_middlewares_thread_of_events(graph):
    """The thread wakes once per message and more otherwise; on its own it does so some hundred times a second."""
    listener = graph.node("listener")
    listener.create_subscription(Float64, "/talk", lambda _: None, qos.SAMPLES)
    with subprocess.Popen([sys.executable, "-c", TALKER], stdout=subprocess.PIPE, text=True) as talker:
        graph.until(lambda: talker.poll() is not None)
        woken, seconds = map(float, talker.stdout.read().split())
    assert woken <= 500 + 300.0 * seconds


def test_a_profile_of_the_user_has_priority(monkeypatch, tmp_path):
    monkeypatch.setenv(middleware.RANGE, "LOCALHOST")
    monkeypatch.setenv(middleware.PROFILE, str(tmp_path / "own.xml"))
    middleware.prepare()
    assert (os.environ[middleware.RANGE], os.environ[middleware.PROFILE]) == ("LOCALHOST", str(tmp_path / "own.xml"))


def test_another_middleware_keeps_the_range(monkeypatch):
    """To a middleware that does not read the profile, SYSTEM_DEFAULT would mean the whole subnet."""
    monkeypatch.setattr(middleware, "get_rmw_implementation_identifier", lambda: "rmw_cyclonedds_cpp")
    monkeypatch.delenv(middleware.RANGE)
    monkeypatch.delenv(middleware.PROFILE)
    middleware.prepare()
    assert os.environ[middleware.RANGE] == "LOCALHOST" and middleware.PROFILE not in os.environ


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
