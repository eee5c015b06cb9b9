"""Abuse of lifecycle transitions, parameters and services while samples arrive."""

from __future__ import annotations

from functools import partial
from math import inf, nan
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_estimators.nodes.estimator import EstimatorNode
from via_interfaces.msg import StiffnessEstimate, VsaCommand
from via_interfaces.srv import ResetEstimator
from via_ros.nodes.recorder import Recorder
from via_sim.nodes.simulator import SimulatorNode

from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph
from via_validation.reliability.robot import Robot

DEVICE = load_device("qbmove_a")
CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
SHUTDOWN = Transition.TRANSITION_ACTIVE_SHUTDOWN
MANY = 10_000


# ---- lifecycle of a controller


def _transitions(before: tuple[int, ...], invalid: tuple[int, ...], answers: bool, graph: Graph) -> str:
    """Valid transitions to a state, then invalid ones: each refused; samples are answered as before."""
    robot = Robot(graph)
    robot.drives()
    for number in before:
        expect(_change(graph, number), f"transition {number} failed")
    for number in invalid:
        expect(not _change(graph, number), f"the invalid transition {number} succeeded")
    if not answers:
        count = len(robot.commands)
        for _ in range(20):
            robot.send()
        graph.pause(0.2)
        driven = [each for each in robot.commands[count:] if any(each.motor)]
        expect(not driven, f"{len(driven)} torques without an active controller")
        return f"{len(invalid)} refused, no torque"
    torque = max(abs(robot.torque()).max() for _ in range(100))
    return f"{len(invalid)} refused, {torque:.2f} N m after"


def _change(graph: Graph, number: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=number))
    return bool(graph.call(ChangeState, "/excitation/change_state", request).success)


def _cycles(graph: Graph) -> str:
    """Valid and invalid transitions while the simulator ticks as fast as it can."""
    graph.add(NODES["excitation"], device=DEVICE.name)
    commands = graph.hear(VsaCommand, DEVICE.command_topic)
    simulator = graph.add(SimulatorNode, device=DEVICE.name, mode="free")
    graph.until(lambda: simulator.ticks > 10, "ticks")
    cycle = {DEACTIVATE: True, CLEANUP: True, 99: False, CONFIGURE: True, ACTIVATE: True, 0: False}
    for _ in range(20):
        for number, valid in cycle.items():
            expect(_change(graph, number) == valid, f"transition {number}: {not valid}")
    count = len(commands)
    graph.until(lambda: len(commands) > count + 100, "commands after the transitions")
    return f"20 cycles, {simulator.ticks} ticks, commands after them"


# ---- parameters of running nodes


def _value(value: Any) -> ParameterValue:
    if isinstance(value, bool):
        return ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    if isinstance(value, int):
        return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    if isinstance(value, float):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    if isinstance(value, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    return ParameterValue(type=ParameterType.PARAMETER_NOT_SET)


def _set(graph: Graph, node: str, **values: Any) -> list[bool]:
    """Whether each parameter was set."""
    request = SetParameters.Request(parameters=[Parameter(name=name, value=_value(v)) for name, v in values.items()])
    return [each.successful for each in graph.call(SetParameters, f"/{node}/set_parameters", request).results]


def _running(graph: Graph, method: str = "excitation", **parameters: Any) -> Any:
    """Simulator, controller, estimator and recorder, all at work; returns a function that waits for their next work."""
    estimates, commands = (
        graph.hear(StiffnessEstimate, f"/{DEVICE.name}/stiffness"), graph.hear(VsaCommand, DEVICE.command_topic),
    )  # fmt: skip
    kinds = ["/joint_states:sensor_msgs/msg/JointState"]
    recorder = graph.add(Recorder, bag=str(graph.folder / "bag"), topics=kinds)
    graph.add(EstimatorNode, device=DEVICE.name)
    graph.add(NODES[method], device=DEVICE.name, **parameters)
    simulator = graph.add(SimulatorNode, device=DEVICE.name, mode="lockstep", listeners=3)

    def work() -> None:
        ticks, written = simulator.ticks, recorder.counts["/joint_states"].messages
        done = len(estimates), len(commands)
        graph.until(
            lambda: (
                simulator.ticks > ticks + 50
                and recorder.counts["/joint_states"].messages > written + 50
                and len(estimates) > done[0] + 50
                and len(commands) > done[1] + 50
            ),
            "work of all nodes",
        )

    work()
    return work


def _fixed(node: str, values: dict[str, Any], graph: Graph) -> str:
    """Parameters that cannot change at run time."""
    work = _running(graph)
    for name, value in values.items():
        expect(_set(graph, node, **{name: value}) == [False], f"{name} = {value!r:.60} was accepted")
        work()
    return f"{len(values)} refused, all nodes work on"


def _live(graph: Graph) -> str:
    """Values that a parameter which may change must refuse."""
    work = _running(graph, "bang_bang_joint")
    wrong: tuple[Any, ...] = (nan, inf, -inf, -1.0, 1e308, "text", True, None)
    for value in wrong:
        for name in ("amplitude", "threshold"):
            expect(_set(graph, "bang_bang_joint", **{name: value}) == [False], f"{name} = {value!r} was accepted")
    expect(_set(graph, "bang_bang_joint", amplitude=0.05) == [True], "a right value was refused")
    work()
    return f"{2 * len(wrong)} refused, a right one accepted, all nodes work on"


def _many(graph: Graph) -> str:
    work = _running(graph)
    values = {f"p{number}": 1.0 for number in range(MANY)}
    for node in ("simulator", "excitation", "estimator", "recorder"):
        expect(not any(_set(graph, node, **values)), f"{node} accepted unknown parameters")
        names = list(values)
        graph.call(GetParameters, f"/{node}/get_parameters", GetParameters.Request(names=names))
        graph.call(DescribeParameters, f"/{node}/describe_parameters", DescribeParameters.Request(names=names))
        graph.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request(prefixes=names, depth=2**64 - 1))
        work()
    return f"{MANY} unknown ones refused by each of four nodes, all work on"


def _simulated_time(graph: Graph) -> str:
    """`use_sim_time` on and off while nodes run; nobody publishes /clock in between."""
    work = _running(graph)
    for turn in range(10):
        for node in ("excitation", "estimator", "recorder"):
            _set(graph, node, use_sim_time=turn % 2 == 0)
        work()
    return "switched 10 times on three nodes, all work on"


# ---- services


def _resets(graph: Graph) -> str:
    work = _running(graph)
    for _ in range(100):
        answer = graph.call(ResetEstimator, "/estimator/reset", ResetEstimator.Request())
        expect(answer.success, answer.message)
    work()
    return "100 resets, all nodes work on"


def _unanswered_requests(graph: Graph) -> str:
    """Requests whose client goes away before the answer."""
    work = _running(graph)
    for number in range(20):
        node = graph.node(f"client_{number}")
        client = node.create_client(ResetEstimator, "/estimator/reset")
        graph.until(client.service_is_ready, "the service")
        client.call_async(ResetEstimator.Request())
        graph.remove(node)
    work()
    return "20 clients left, all nodes work on"


FOREIGN = """
import rclpy, time
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from via_interfaces.msg import StiffnessEstimate
from via_ros import middleware
middleware.prepare()
rclpy.init()
node = rclpy.create_node("foreign")
kinds = {{"/joint_states": StiffnessEstimate, "/{name}/command": JointState, "/{name}/stiffness": String}}
publishers = [(kind, node.create_publisher(kind, topic, 10)) for topic, kind in kinds.items()]
subscriptions = [node.create_subscription(kind, topic, lambda _: None, 10) for topic, kind in kinds.items()]
while True:
    for kind, publisher in publishers:
        publisher.publish(kind())
    time.sleep(.005)
"""


def _foreign_types(graph: Graph) -> str:
    """Another process publishes and subscribes to the topics of the nodes with other types."""
    work = _running(graph)
    foreign = graph.script("foreign", FOREIGN.format(name=DEVICE.name))
    graph.until(lambda: graph.peer.count_publishers("/joint_states") > 1, "the foreign publisher")
    for _ in range(5):
        work()
        graph.pause(0.1)
    expect(foreign.code is None, f"the foreign node ended: {foreign.errors()[-200:]}")
    return "publisher and subscriber of another type on each of three topics, all nodes work"


def faults() -> list[Fault]:
    """The faults of this group."""
    refused, on = "each refused; the controller drives as before", "all nodes work on"

    def lifecycle(injected: str, before: tuple[int, ...], invalid: tuple[int, ...], drives: bool = True) -> Fault:
        must = refused if drives else "each refused; no torque"
        return Fault(injected, must, partial(_transitions, before, invalid, drives), injected.startswith("active"))

    fixed: dict[str, dict[str, Any]] = {
        "simulator": {"rate": nan, "mode": "free", "device": "/etc/passwd", "listeners": -1, "duration": 1e-9},
        "excitation": {"device": "cubic_demo", "torque_limit": 1e6, "proportional_gain": nan, "autostart": "no"},
        "estimator": {"device": "x" * 100_000, "method": "integral", "joint_topic": "bad topic"},
        "recorder": {"bag": "/", "topics": "/x", "executor": 5},
    }
    return [
        lifecycle("active: configured, activated and cleaned up", (), (CONFIGURE, ACTIVATE, CLEANUP)),
        lifecycle("transitions 0, 10, 99 and 255", (), (0, 10, 99, 255)),
        lifecycle("inactive: configured and deactivated", (DEACTIVATE,), (CONFIGURE, DEACTIVATE, 99)),
        lifecycle("unconfigured: activated, deactivated and cleaned up", (DEACTIVATE, CLEANUP),
                  (ACTIVATE, DEACTIVATE, CLEANUP, 99), False),
        lifecycle("shut down: configured and activated", (SHUTDOWN,), (CONFIGURE, ACTIVATE, 99), False),
        Fault("20 cycles of transitions while samples arrive", "invalid ones refused, valid ones done", _cycles, False),
        *(Fault(f"parameters of the running {node}: {', '.join(values)}", f"each refused; {on}",
                partial(_fixed, node, values), False)
          for node, values in fixed.items()),
        Fault("wrong values of live parameters", f"each refused, a right one accepted; {on}", _live, False),
        Fault(f"{MANY} parameters set, read, described and listed", f"refused; {on}", _many, False),
        Fault("use_sim_time switched on and off", on, _simulated_time, False),
        Fault("an estimator reset 100 times", on, _resets, False),
        Fault("20 clients that leave before the answer", on, _unanswered_requests, False),
        Fault("topics with other types", on, _foreign_types, False),
    ]  # fmt: skip
