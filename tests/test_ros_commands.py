"""`via topic`, `service`, `action`, `param`, `node` and `lifecycle` on a live graph, and YAML to and from messages."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import pytest
import rclpy
import yaml
from rcl_interfaces.srv import ListParameters
from rclpy.action import ActionServer, CancelResponse
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Byte, String
from via_bringup.cli.ros.values import filled, member, shown
from via_core.errors import ParameterError, ViaError
from via_core.parameters import parameter
from via_interfaces.action import DiagnoseGap
from via_interfaces.msg import JointReference, StiffnessEstimate
from via_interfaces.srv import Push, SetEffects
from via_ros.domains import reserved_domain
from via_ros.parameters import declare

INTERRUPTED = 130
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class Done:
    code: int
    out: str
    err: str


def via(graph, *words: str, end=lambda out, err: False) -> Done:
    """Run a command while the graph runs; Ctrl-C as soon as end(lines of stdout, lines of stderr)."""
    process = subprocess.Popen(["via", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    printed: tuple[list[str], list[str]] = ([], [])
    readers = [
        threading.Thread(target=lambda to, of: to.extend(iter(of.readline, "")), args=pair)
        for pair in zip(printed, (process.stdout, process.stderr))
    ]
    for each in readers:
        each.start()
    sent = False

    def ended() -> bool:
        nonlocal sent
        if not sent and end(*printed):
            process.send_signal(signal.SIGINT)
            sent = True
        return process.poll() is not None

    try:
        graph.until(ended, 90.0)
    except AssertionError as error:
        raise AssertionError(f"{' '.join(words)} did not end: {printed}") from error
    finally:
        process.kill()
    for each in readers:
        each.join()
    return Done(process.returncode, "".join(printed[0]), "".join(printed[1]))


@pytest.fixture(scope="module")
def domain(domain):
    """A domain of this module alone: the commands list everything, and nodes of other tests may leave late."""
    with reserved_domain() as own, pytest.MonkeyPatch.context() as changed:
        changed.setenv("ROS_DOMAIN_ID", str(own))
        yield own


@pytest.fixture
def talker(graph):
    """A node that publishes joint states as a sensor does (best effort), and once a latched text."""
    node = graph.node("talker")
    samples = node.create_publisher(JointState, "/joint_states", BEST_EFFORT)
    message = JointState(name=["a", "b"], position=[0.5, float("nan")])
    node.create_timer(0.01, lambda: samples.publish(message))
    node.latched = node.create_publisher(String, "/note", LATCHED)
    node.latched.publish(String(data="kept\x1b[31m"))
    return node


def test_topics_are_listed_described_and_measured(graph, talker):
    listed = via(graph, "topic", "list", "-t")
    assert "/joint_states [sensor_msgs/msg/JointState]" in listed.out.splitlines() and "/_" not in listed.out
    info = via(graph, "topic", "info", "/joint_states")
    assert "publishers: 1\n  /talker: best_effort, volatile" in info.out
    assert "/talker" in via(graph, "node", "list").out.splitlines()
    rate = via(graph, "topic", "hz", "/joint_states", end=lambda out, _: out)
    assert rate.code == INTERRUPTED and rate.err == "interrupted\n"
    assert " Hz; interval from " in rate.out


def test_echo_takes_best_effort_and_latched_messages(graph, talker):
    once = via(graph, "topic", "echo", "joint_states", "--once")
    assert once.code == 0 and once.out.endswith("---\n")
    content = yaml.safe_load(once.out.removesuffix("---\n"))
    assert content["name"] == ["a", "b"] and content["position"][0] == 0.5
    assert via(graph, "topic", "echo", "/joint_states", "--field", "name.1", "--once").out == "b\n---\n"
    note = via(graph, "topic", "echo", "/note", end=lambda out, _: "---\n" in out)
    assert yaml.safe_load(note.out.removesuffix("---\n")) == {"data": "kept\x1b[31m"}
    assert "\x1b" not in note.out
    assert (note.code, note.err) == (INTERRUPTED, "interrupted\n")


def test_a_topic_that_nobody_publishes_is_said_with_those_that_are(graph, talker):
    done = via(graph, "topic", "hz", "/joint_stats", end=lambda _, err: err)
    assert done.code == INTERRUPTED
    assert done.err.startswith("waiting for topic /joint_stats; there are: /joint_states, /note")
    assert via(graph, "topic", "info", "/joint_stats").err.startswith("error: no topic /joint_stats; there are: /joint")


def test_pub_reaches_a_subscriber(graph):
    node, received = graph.node("listener"), []
    node.create_subscription(JointReference, "/joint/reference", received.append, LATCHED)
    words = ("topic", "pub", "-1", "/joint/reference", "via_interfaces/msg/JointReference")
    assert via(graph, *words, "{stiffness: 8, header: {stamp: now}}").code == 0
    graph.until(lambda: received)
    assert received[0].stiffness == 8.0 and received[0].header.stamp.sec > 1e9
    refused = via(graph, *words, "{stiffnes: 8}")
    assert (refused.code, refused.err) == (
        2, "error: no member 'stiffnes'; there are: header, equilibrium, stiffness\n",
    )  # fmt: skip


def test_services_are_listed_and_called(graph):
    node = graph.node("server")

    def answer(request, response):
        response.success, response.message = True, f"pushed {list(request.impulse)}"
        return response

    node.create_service(Push, "/arm/push", answer)
    assert "/arm/push [via_interfaces/srv/Push]" in via(graph, "service", "list", "-t").out.splitlines()
    done = via(graph, "service", "call", "/arm/push", "via_interfaces/srv/Push", "{impulse: [0.1, 2]}")
    assert yaml.safe_load(done.out) == {"success": True, "message": "pushed [0.1, 2.0]"}
    wrong = via(graph, "service", "call", "/arm/push", "via_interfaces/srv/Pusch")
    assert (wrong.code, wrong.err.count("\n")) == (2, 1) and "Pusch is not installed" in wrong.err


class Diagnosing:
    """An action server whose goal ends when `finish` is set, or is cancelled."""

    def __init__(self, node, answer: str) -> None:
        self.cancelled = False
        self.goal = None
        self.answer = answer
        self.server = ActionServer(
            node, DiagnoseGap, "/monitor/diagnose", self._execute, handle_accepted_callback=self._accept,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    def _accept(self, goal) -> None:
        self.goal = goal
        goal.publish_feedback(DiagnoseGap.Feedback(doing="fitting", share=0.5))
        if self.answer != "wait":
            goal.execute()

    def _execute(self, goal):
        getattr(goal, self.answer)()
        return DiagnoseGap.Result(success=self.answer == "succeed", message=f"{goal.request.seconds:g} s")


SEND = ("action", "send", "-f", "/monitor/diagnose", "via_interfaces/action/DiagnoseGap", "{seconds: 5}")


def test_a_service_is_called_once_its_node_has_answered_another_client(graph):
    """A node that has not found the client yet would lose the request."""
    order = []
    node = graph._added(rclpy.create_node("late", context=graph.context, start_parameter_services=False))
    node.create_service(ListParameters, "/late/list_parameters", lambda _, answer: order.append("asked") or answer)
    node.create_service(Push, "/late/push", lambda _, answer: order.append("called") or answer)
    assert via(graph, "service", "call", "/late/push", "via_interfaces/srv/Push").code == 0
    assert order[0] == "asked" and order[-1] == "called" and order.count("called") == 1


@pytest.mark.parametrize(
    ("ending", "code", "said"), [("succeed", 0, ""), ("abort", 2, "error: the goal was aborted\n")]
)
def test_a_goal_is_sent_and_its_result_printed(graph, ending, code, said):
    Diagnosing(graph.node("monitor"), ending)
    done = via(graph, *SEND)
    result = done.out.rsplit("---\n", 1)[-1]
    assert yaml.safe_load(result)["message"] == "5 s"
    assert (done.code, done.err) == (code, said)


def test_ctrl_c_cancels_the_goal(graph):
    server = Diagnosing(graph.node("monitor"), "wait")
    done = via(graph, *SEND, end=lambda *_: server.goal is not None)
    assert done.code == INTERRUPTED and done.err == "interrupted\n"
    graph.until(lambda: server.goal.is_cancel_requested)


@dataclass(frozen=True)
class Parameters:
    level: float = parameter(0.5, "energy", "J", (0.0, 1.0), live=True)
    mode: str = parameter("free", "mode of time", choices=("free", "lockstep"))


def test_parameters_are_listed_described_read_and_changed(graph):
    node, taken = graph.node("tuned"), []

    def take(parameters: Parameters) -> Callable[[], None]:
        if parameters.level == 0.25:
            raise ParameterError("a quarter is never enough")
        return partial(taken.append, parameters)

    declare(node, Parameters, changed=take)
    assert {"level", "mode"} <= set(via(graph, "param", "list", "/tuned").out.split())
    about = via(graph, "param", "describe", "/tuned", "level").out
    assert "level: energy [J]" in about and "range: [0, 1]" in about and "can change while the node runs" in about
    assert "fixed when the node starts" in via(graph, "param", "describe", "tuned", "mode").out
    assert via(graph, "param", "set", "/tuned", "level", "1").code == 0
    assert taken == [Parameters(level=1.0)] and via(graph, "param", "get", "/tuned", "level").out == "1.0\n"
    for words, complaint in (
        (("level", "7"), "error: /tuned keeps level: Parameter level out of range Min: 0.0, Max: 1.0"),
        (("level", "0.25"), "error: /tuned keeps level: a quarter is never enough"),
        (
            ("mode", "lockstep"),
            "error: mode of /tuned is fixed when the node starts; give it there as -p",
        ),
        (("speed", "1"), "error: /tuned has no parameter speed; it has: level, mode,"),
    ):
        refused = via(graph, "param", "set", "/tuned", *words)
        assert refused.code == 2 and refused.err.startswith(complaint), refused.err
    assert len(taken) == 1
    assert via(graph, "param", "get", "/tuned", "level").out == "1.0\n"


def test_a_lifecycle_node_changes_its_state(graph):
    graph._added(LifecycleNode("phases", context=graph.context))
    assert via(graph, "lifecycle", "get", "/phases").out == "unconfigured\n"
    assert via(graph, "lifecycle", "set", "/phases", "configure").out == "/phases: configure succeeded\n"
    assert via(graph, "lifecycle", "get", "/phases").out == "inactive\n"
    wrong = via(graph, "lifecycle", "get", "/phase").err
    assert wrong.startswith("error: no node /phase; there are: ") and "/phases" in wrong


def test_messages_survive_the_way_through_yaml():
    estimate = StiffnessEstimate(value=0.1, transmission_value=[1.0, float("inf")], status=5, method="1e3")
    estimate.header.stamp.sec = 7
    again = filled(StiffnessEstimate(), shown(estimate))
    assert again == estimate
    assert filled(Byte(), "{data: 200}").data == bytes([200])
    assert len(member(filled(JointState(), f"position: {list(range(300))}"), "position")) == 300
    assert shown(filled(JointState(), f"position: {list(range(300))}")).count(",") < 140


@pytest.mark.parametrize(
    ("kind", "text", "complaint"),
    [
        (StiffnessEstimate, "{value: high}", "value: must be a number, got 'high'"),
        (StiffnessEstimate, "{status: 256}", r"status: must lie in \[0, 255\], got 256"),
        (StiffnessEstimate, "{status: 1.5}", "status: must be an integer, got 1.5"),
        (StiffnessEstimate, "{transmission_value: 3}", "transmission_value: must be a list, got 3"),
        (StiffnessEstimate, "{header: {stamp: {secs: 1}}}", "header: stamp: no member 'secs'; there are: sec, nanosec"),
        (StiffnessEstimate, "[1, 2]", "the values: must be a mapping such as {header: ...}"),
        (StiffnessEstimate, "{method: [", "the values are not YAML"),
        (SetEffects.Request, "{effects: [{motor: -1}]}", r"effects.0: motor: must lie in \[0, 255\], got -1"),
    ],
)
def test_wrong_values_are_refused_with_their_place(kind, text, complaint):
    with pytest.raises(ViaError, match=complaint):
        filled(kind(), text)


def test_where_ros2_is_installed_it_runs_instead(tmp_path):
    native = tmp_path / "ros2"
    native.write_text('#!/bin/sh\necho "$@"\n')
    native.chmod(native.stat().st_mode | stat.S_IXUSR)
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}

    def said(*words: str) -> str:
        return subprocess.run(["via", *words], env=environment, capture_output=True, text=True, check=True).stdout

    assert said("topic", "echo", "/x", "--qos-depth", "3") == "topic echo /x --qos-depth 3\n"
    assert said("action", "send", "-f", "/x", "y", "{}") == "action send_goal -f /x y {}\n"
    assert said("launch", "joint", "bag:=x").split()[-1:] == ["bag:=x"] and said("launch", "joint").startswith(
        "launch /"
    )
