"""Faults of the commands and requests that reach a simulator."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import inf, nan
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_core.errors import ViaError
from via_interfaces.msg import Effect, VsaCommand
from via_interfaces.srv import ClearEffects, Hold, Push, SetEffects
from via_ros.conversions import nanoseconds, set_stamp
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph

DEVICE = load_device("qbmove_a")
WITHIN = 20_000_000  # [ns] for which a command acts at most
RATE = 250.0  # [Hz] in mode realtime
TORQUE = (0.5, -0.5)  # [N m]
TICKS = 50
HUGE = 10_000_000
LINE = 2000  # characters of an error at most
Change = Callable[[VsaCommand], Any]


class Commander:
    """The peer commands a simulated joint in lockstep."""

    def __init__(self, graph: Graph, **parameters: Any) -> None:
        self.graph, self.sequence = graph, 0
        graph.observe_diagnostics()
        self.samples = graph.hear(JointState, "/joint_states")
        self.commands = graph.publisher(VsaCommand, DEVICE.command_topic)
        self.node = graph.add(SimulatorNode, device=DEVICE.name, **{"mode": "lockstep", **parameters})
        graph.until(lambda: len(self.samples) > 0, "the first sample")

    def command(self, change: Change | None = None) -> Any:
        """A command that answers the last sample, changed."""
        command = VsaCommand(mode=VsaCommand.MOTOR_TORQUE, motor=TORQUE, sequence=self.sequence)
        self.sequence += 1
        command.header.stamp = self.samples[-1].header.stamp
        changed = None if change is None else change(command)
        return command if changed is None else changed

    def steps(self, count: int = TICKS) -> None:
        """Answer so many samples; the joint must move by finite numbers."""
        for _ in range(count):
            heard = len(self.samples)
            self.commands.publish(self.command())
            self.graph.until(lambda: len(self.samples) > heard, "the next sample")  # noqa: B023
        expect(all(np.isfinite(each.position).all() for each in self.samples), "positions that are not finite")
        expect(any(self.samples[-1].effort[1:]), "the torque does not act")


# ---- commands in lockstep


def _refused(change: Change, report: str, graph: Graph) -> str:
    """A bad command must not move time, and the next good one must."""
    commander = Commander(graph)
    commander.steps()
    ticks = commander.node.ticks
    for _ in range(10):
        commander.commands.publish(commander.command(change))
        graph.pause(0.01)
    expect(commander.node.ticks == ticks, f"{commander.node.ticks - ticks} ticks by bad commands")
    graph.reported(report)
    commander.steps()
    return f"10 commands without effect, reported, {TICKS} ticks after"


def _finite(change: Change, graph: Graph) -> str:
    """A huge command is limited or ignored: the state stays finite."""
    commander = Commander(graph)
    commander.steps()
    for _ in range(10):
        heard = len(commander.samples)
        commander.commands.publish(commander.command(change))
        graph.until(lambda: len(commander.samples) > heard, "the next sample")  # noqa: B023
    largest = max(abs(value) for each in commander.samples for value in each.position)
    commander.steps()
    return f"positions within {largest:.3g} rad, {TICKS} ticks after"


def _doubled(graph: Graph) -> str:
    commander = Commander(graph)
    ticks = commander.node.ticks
    for _ in range(TICKS):
        heard, command = len(commander.samples), commander.command()
        commander.commands.publish(command)
        commander.commands.publish(command)
        graph.until(lambda: len(commander.samples) > heard, "the next sample")  # noqa: B023
    graph.pause(0.1)
    taken = commander.node.ticks - ticks
    expect(taken <= TICKS, f"{taken} ticks by {TICKS} commands sent twice")
    return f"{taken} ticks by {TICKS} commands sent twice"


def _lost_command(graph: Graph) -> str:
    """No answer to a sample: it is published again, and time does not go on."""
    commander = Commander(graph)
    commander.steps()
    ticks, heard = commander.node.ticks, len(commander.samples)
    graph.until(lambda: len(commander.samples) > heard, "the sample again")
    expect(commander.node.ticks == ticks, "time went on without a command")
    again, before = commander.samples[-1], commander.samples[heard - 1]
    expect(again.header.stamp == before.header.stamp and again.position == before.position, "another sample")
    commander.steps()
    return f"the sample came again with its stamp, {TICKS} ticks after"


# ---- commands in real time


def _realtime(graph: Graph, inject: Callable[[Commander, Callable[[Any], None]], str]) -> str:
    commander = Commander(graph, mode="realtime", rate=RATE)

    def send(command: Any) -> None:
        commander.commands.publish(command)
        graph.pause(1.0 / RATE)

    for _ in range(50):
        send(commander.command())
    graph.until(lambda: any(commander.samples[-1].effort[1:]), "a torque")
    return inject(commander, send)


def _last_driven(commander: Commander) -> int:
    """[ns] largest stamp of a sample whose tick had a torque."""
    driven = [nanoseconds(each.header.stamp) for each in commander.samples if any(each.effort[1:])]
    return max(driven)


def _ended(commander: Commander, last: int) -> str:
    """Torque must end 20 ms after the stamp `last` [ns]."""
    graph = commander.graph
    graph.until(lambda: nanoseconds(commander.samples[-1].header.stamp) > last + 10 * WITHIN, "later samples")
    after = _last_driven(commander) - last
    expect(after <= WITHIN, f"torque until {1e-6 * after:.1f} ms after the last command")
    return f"torque until {1e-6 * after:.1f} ms after the stamp of the last command"


def _commander_silent(commander: Commander, _: Callable[[Any], None]) -> str:
    last = commander.command()
    commander.commands.publish(last)
    seen = _ended(commander, nanoseconds(last.header.stamp))
    commander.graph.reported("passive, no command")
    return f"{seen}, reported"


def _old_commands(commander: Commander, send: Callable[[Any], None]) -> str:
    """Commands that answer one old sample again and again."""
    last = commander.command()
    for _ in range(50):
        last.sequence += 1
        send(last)
    return _ended(commander, nanoseconds(last.header.stamp))


def _bad_commands(commander: Commander, send: Callable[[Any], None]) -> str:
    """Commands that are refused do not keep the last one alive."""
    last = nanoseconds(commander.samples[-1].header.stamp)
    for _ in range(50):
        send(commander.command(lambda command: setattr(command, "motor", [nan, nan])))
    return _ended(commander, last)


def _two_commanders(commander: Commander, send: Callable[[Any], None]) -> str:
    graph = commander.graph
    other = graph.node("foreign")
    foreign = graph.publisher(VsaCommand, DEVICE.command_topic, other)
    graph.connected(foreign)
    for number in range(100):
        send(commander.command())
        foreign.publish(VsaCommand(mode=VsaCommand.MOTOR_TORQUE, motor=[2.0, -2.0], sequence=number))
    worst = max(abs(value) for each in commander.samples[-10:] for value in each.effort[1:])
    expect(worst == 0.0, f"{worst:.2f} N m under two commanders")
    graph.reported("commanders: /foreign, /peer")
    graph.remove(other)
    graph.pause(1.1)
    for _ in range(50):
        send(commander.command())
    graph.until(lambda: any(commander.samples[-1].effort[1:]), "a torque under one commander")
    return "0 N m under two commanders, both named, torque again under one"


def _two_simulators(commander: Commander, _: Callable[[Any], None]) -> str:
    graph = commander.graph
    second = graph.add(SimulatorNode, device=DEVICE.name, mode="realtime", rate=RATE)
    graph.reported("drivers: /")
    ticks = commander.node.ticks
    graph.until(lambda: commander.node.ticks > ticks + 200, "ticks of the first simulator")
    expect(second.ticks == 0, f"the second simulator took {second.ticks} ticks")
    graph.remove(commander.node)
    graph.until(lambda: second.ticks > 20, "ticks of the second simulator when the first has gone")
    return "the second one waits, both are named; it begins when the first one has gone"


# ---- requests


def _request(kind: Any, service: str, request: Any, graph: Graph) -> str:
    node = graph.add(ArmSimulatorNode if kind in (Hold, Push) else SimulatorNode, mode="free")
    samples = graph.hear(JointState, "/joint_states")
    graph.until(lambda: node.ticks > 10, "ticks")
    answer = graph.call(kind, service, request)
    expect(not answer.success, f"accepted: {answer.message}")
    expect(0 < len(answer.message) < LINE and "\n" not in answer.message, f"answer of {len(answer.message)} characters")
    ticks = node.ticks
    graph.until(lambda: node.ticks > ticks + 100, "ticks after the request")
    expect(bool(np.isfinite(samples[-1].position).all()), "positions that are not finite")
    return f"refused: {answer.message[:80]}"


def _clear(graph: Graph) -> str:
    """Effects change 100 times while the joint moves."""
    commander = Commander(graph)
    effects = [Effect(name="payload", site="link", parameter_names=["mass", "radius"], parameter_values=[0.1, 0.1])]
    accepted = 0
    for _ in range(50):
        accepted += graph.call(SetEffects, "/simulator/set_effects", SetEffects.Request(effects=effects)).success
        commander.steps(2)
        graph.call(ClearEffects, "/simulator/clear_effects", ClearEffects.Request())
        commander.steps(2)
    return f"{accepted} of 50 accepted, {commander.node.ticks} ticks"


def _wrong_parameter(parameters: dict[str, Any], graph: Graph) -> str:
    try:
        graph.add(SimulatorNode, **parameters)
    except ViaError as error:
        return f"refused: {str(error)[:80]}"
    expect(False, "accepted")
    return ""


def faults() -> list[Fault]:
    """The faults of this group."""
    none = "no tick, reported; ticks go on after it"
    finite = "finite positions; ticks go on after it"
    off = "torque off within 20 ms of stamps"
    refused = "refused with one line; the simulation goes on"

    def motor(*values: float) -> Change:
        return lambda command: setattr(command, "motor", list(values))

    def set_to(field: str, value: Any) -> Change:
        return lambda command: setattr(command, field, value)

    def stamped(time: int) -> Change:
        return lambda command: setattr(command, "header", _header(time))

    bad: dict[str, tuple[Change, str]] = {
        "torques NaN": (motor(nan, nan), "refused commands"),
        "one torque infinite": (motor(inf, 0.0), "refused commands"),
        "one torque for two motors": (motor(1.0), "refused commands"),
        "100 000 torques": (motor(*[1.0] * 100_000), "refused commands"),
        "no torques": (motor(), "refused commands"),
        "mode 99": (set_to("mode", 99), "refused commands"),
        "damping NaN": (set_to("damping", nan), "refused commands"),
        "junk bytes": (lambda _: b"\x00\x01\x00\x00junk", "refused commands"),
        "truncated commands": (lambda command: bytes(serialize_message(command)[:40]), "refused commands"),
        "stamps zero": (stamped(0), "unmatched commands=10"),
        "stamps in the future": (stamped(10**18), "unmatched commands=10"),
        "stamps before 1970": (stamped(-(10**18)), "unmatched commands=10"),
    }
    quick = {"torques NaN", "junk bytes", "stamps zero"}
    arm, joint = "/arm_simulator", "/simulator"
    wrong = Effect(name="payload", site="link", parameter_names=["mass"], parameter_values=[nan])
    requests: dict[str, tuple[Any, str, Any]] = {
        "a push of NaN": (Push, f"{arm}/push", Push.Request(impulse=[nan] * 4)),
        "a push of 1e308": (Push, f"{arm}/push", Push.Request(deflection=[1e308] * 4)),
        "a push of ten million numbers": (Push, f"{arm}/push", Push.Request(impulse=np.zeros(HUGE).tolist())),
        "a hold of 1.7e308 s": (Hold, f"{arm}/hold", Hold.Request(duration=1.7e308)),
        "a hold of NaN s": (Hold, f"{arm}/hold", Hold.Request(duration=nan)),
        "an unknown effect": (
            SetEffects,
            f"{joint}/set_effects",
            SetEffects.Request(effects=[Effect(name="x" * 9999)]),
        ),
        "an effect of NaN": (SetEffects, f"{joint}/set_effects", SetEffects.Request(effects=[wrong])),
        "100 000 effects": (SetEffects, f"{joint}/set_effects", SetEffects.Request(effects=[wrong] * 100_000)),
    }
    parameters: dict[str, dict[str, Any]] = {
        "rate 0": {"rate": 0.0}, "rate NaN": {"rate": nan}, "rate 1e300": {"rate": 1e300},
        "mode 'nonsense'": {"mode": "nonsense"}, "listeners -1": {"listeners": -1},
        "device '../../etc/passwd'": {"device": "../../etc/passwd"}, "a rate that is text": {"rate": "fast"},
    }  # fmt: skip
    return [
        *(Fault(f"commands: {name}", none, partial(_refused, *given), name in quick) for name, given in bad.items()),
        Fault("commands: torques of 1e308 N m", finite, partial(_finite, motor(1e308, -1e308)), False),
        Fault("commands: damping 1e308", finite, partial(_finite, set_to("damping", 1e308)), False),
        Fault("every command twice in lockstep", "no tick beyond one per sample", _doubled),
        Fault("a lost command in lockstep", "the sample again, the same one; ticks go on", _lost_command),
        Fault("the commander falls silent", f"{off}, reported", partial(_realtime, inject=_commander_silent)),
        Fault("commands that answer an old sample", off, partial(_realtime, inject=_old_commands), False),
        Fault("commands that are refused, one after another", off, partial(_realtime, inject=_bad_commands), False),
        Fault("two commanders of a joint", "no torque, both named; torque again under one",
              partial(_realtime, inject=_two_commanders), False),
        Fault("two simulators of a joint", "the second one waits; both named",
              partial(_realtime, inject=_two_simulators), False),
        *(Fault(f"request: {name}", refused, partial(_request, *given), name == "a push of NaN")
          for name, given in requests.items()),
        Fault("effects set and cleared 50 times while the joint moves", "finite positions, no tick missing", _clear,
              False),
        *(Fault(f"parameter: {name}", "refused with one line", partial(_wrong_parameter, given), False)
          for name, given in parameters.items()),
    ]  # fmt: skip


def _header(time: int) -> Any:
    message = VsaCommand()
    set_stamp(message.header.stamp, time)
    return message.header
