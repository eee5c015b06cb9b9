"""Faults of the samples, estimates and references that reach a controller."""

from __future__ import annotations

from functools import partial
from math import inf, nan
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from via_interfaces.msg import ControlState, JointReference, StiffnessEstimate
from via_ros.conversions import nanoseconds, set_stamp

from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph
from via_validation.reliability.robot import DEVICE, FIRST, LIMIT, PERIOD, Change, Robot

BAD = 20  # successive bad samples
PAUSE = 0.1  # [s] of wall time, longer than the 20 ms after which the controller notices silence
LARGEST_FACTOR = 3.0  # of a spring model, by which feedback may correct it
OK = StiffnessEstimate(status=0, value=9.0, standard_deviation=0.1)


# ---- samples


def _values(field: str, values: list[float]) -> Change:
    return lambda message: setattr(message, field, values)


def _named(*names: str) -> Change:
    return lambda message: setattr(message, "name", list(names))


def _bytes(data: bytes) -> Change:
    return lambda _: data


def _stamped(time: int) -> Change:
    return lambda message: set_stamp(message.header.stamp, time)


def _unusable(change: Change, graph: Graph) -> str:
    """Bad samples that name the joints: each is answered, with zero torque."""
    robot = Robot(graph)
    before = robot.drives()
    worst = max(float(np.abs(robot.torque(change)).max()) for _ in range(BAD))
    expect(worst == 0.0, f"a bad sample was answered with {worst:.2f} N m")
    graph.reported("unusable samples")
    return f"{before:.2f} N m before, 0 N m for {BAD} bad samples, reported, {robot.drives():.2f} N m after"


def _unanswered(change: Change, report: str, graph: Graph) -> str:
    """Messages that are no samples of the joint: not answered; the silence ends the torque."""
    robot = Robot(graph)
    before, answered = robot.drives(), robot.node.answered
    for _ in range(BAD):
        robot.send(change)
    graph.until(lambda: not any(robot.commands[-1].motor), "an end of the torque")
    graph.pause(PAUSE)
    expect(robot.node.answered == answered, f"{robot.node.answered - answered} answers")
    expect(not any(robot.commands[-1].motor), "a torque after the end of the torque")
    if report:
        graph.reported(report)
    return f"{before:.2f} N m before, 0 N m once in the silence, {robot.drives():.2f} N m after"


def _restarted(change: Change, graph: Graph) -> str:
    """Samples with odd stamps: torques stay finite and within the limit, and go on afterwards."""
    robot = Robot(graph)
    before = robot.drives()
    during = max(float(np.abs(robot.torque(change)).max()) for _ in range(BAD))
    return f"{before:.2f} N m before, at most {during:.2f} N m meanwhile, {robot.drives():.2f} N m after"


def _frozen_stamps(stamp: int | None, graph: Graph) -> str:
    """One stamp for all samples: no torque once the stamps have stood still for 20 ms."""
    robot = Robot(graph)
    before = robot.drives()
    change = _stamped(FIRST + robot.tick * PERIOD if stamp is None else stamp)
    robot.torque(change)
    graph.pause(PAUSE)
    worst = max(float(np.abs(robot.torque(change)).max()) for _ in range(BAD))
    expect(worst == 0.0, f"{worst:.2f} N m although stamps stand still")
    graph.reported("stamps stand still")
    return f"{before:.2f} N m before, 0 N m for {BAD} samples of one stamp, reported, {robot.drives():.2f} N m after"


def _silent(graph: Graph) -> str:
    robot = Robot(graph)
    before, count = robot.drives(), len(robot.commands)
    graph.until(lambda: len(robot.commands) > count, "an end of the torque")
    graph.pause(PAUSE)
    expect(len(robot.commands) == count + 1, f"{len(robot.commands) - count} commands in the silence")
    expect(not any(robot.commands[-1].motor), "the command in the silence has a torque")
    graph.reported("no samples")
    return f"{before:.2f} N m before, 0 N m once in the silence, {robot.drives():.2f} N m after"


def _frozen_positions(which: slice, graph: Graph) -> str:
    """Positions repeat one number while the references move on; times in stamps."""
    robot = Robot(graph)
    robot.drives()
    kept = list(robot.message().position)

    def freeze(message: JointState) -> None:
        values = list(message.position)
        values[which] = kept[which]
        message.position = values

    torque = np.array([np.abs(robot.torque(freeze)).max() for _ in range(900)])
    driven = np.flatnonzero(torque)
    expect(len(driven) < len(torque) and driven[-1] < 300, f"torque until {driven[-1]} ms after the freeze")
    graph.reported("does not follow its torque")
    for _ in range(1200):
        robot.torque()
    return f"torque ends {driven[-1]} ms after the freeze, reported, {robot.drives():.2f} N m 1.2 s after its end"


def _reordered(graph: Graph) -> str:
    robot = Robot(graph)
    before = robot.drives()
    count = len(robot.commands)
    for _ in range(BAD // 2):
        late, early = robot.message(), robot.message()
        robot.samples.publish(early)
        robot.samples.publish(late)
        graph.pause(0.001)
    graph.until(lambda: len(robot.commands) >= count + BAD, "an answer to each sample")
    during = max(float(np.abs(robot.checked(each)).max()) for each in robot.commands[count:])
    return f"{before:.2f} N m before, at most {during:.2f} N m meanwhile, {robot.drives():.2f} N m after"


def _burst(graph: Graph) -> str:
    """More samples at once than the queue holds."""
    robot = Robot(graph)
    before, count = robot.drives(), len(robot.commands)
    for _ in range(5000):
        robot.send()
    last = FIRST + robot.tick * PERIOD
    graph.until(lambda: nanoseconds(robot.commands[-1].header.stamp) == last, "an answer to the last sample")
    for each in robot.commands[count:]:
        robot.checked(each)
    return f"{before:.2f} N m before, the last of 5000 answered, {robot.drives():.2f} N m after"


# ---- estimates and references


def _estimates(estimate: StiffnessEstimate, graph: Graph) -> str:
    """A stiffness estimate after every sample, into the feedback of `equilibrium_preset`."""
    robot = Robot(graph, "equilibrium_preset", feedback=True)
    estimates = graph.publisher(StiffnessEstimate, f"/{DEVICE.name}/stiffness")
    states = graph.hear(ControlState, f"/{DEVICE.name}/control")
    graph.connected(estimates)
    before = robot.drives()
    for _ in range(300):
        estimate.header.stamp = robot.commands[-1].header.stamp
        estimates.publish(estimate)
        robot.torque()
    factors = np.array([each.value[list(each.name).index("factor")] for each in states])
    expect(bool(np.isfinite(factors).all()), "the correction factor is not finite")
    low, high = factors.min(), factors.max()
    expect(low >= 1.0 / LARGEST_FACTOR - 1e-9 and high <= LARGEST_FACTOR + 1e-9, f"factors from {low} to {high}")
    return f"{before:.2f} N m before, factor {low:.2f} to {high:.2f}, {robot.drives():.2f} N m after"


def _silent_estimator(graph: Graph) -> str:
    robot = Robot(graph, "equilibrium_preset", feedback=True, fallback_time=0.1, correction_time=0.1)
    estimates = graph.publisher(StiffnessEstimate, f"/{DEVICE.name}/stiffness")
    states = graph.hear(ControlState, f"/{DEVICE.name}/control")
    graph.connected(estimates)

    def factor() -> float:
        graph.until(lambda: len(states) >= len(robot.commands) - 1, "a control state")
        return float(states[-1].value[list(states[-1].name).index("factor")])

    for _ in range(300):
        robot.torque()
        OK.header.stamp = robot.commands[-1].header.stamp
        estimates.publish(OK)
    corrected = factor()
    expect(abs(corrected - 1.0) > 0.01, f"factor {corrected:.3f} with estimates")
    for _ in range(1000):
        robot.torque()
    expect(abs(factor() - 1.0) < 1e-3, f"factor {factor():.3f} one second after the last estimate")
    return f"factor {corrected:.2f} with estimates, {factor():.4f} one second after the last, {robot.drives():.2f} N m"


def _references(graph: Graph) -> str:
    robot = Robot(graph, "equilibrium_preset")
    references = graph.publisher(JointReference, f"/{DEVICE.name}/reference")
    states = graph.hear(ControlState, f"/{DEVICE.name}/control")
    graph.connected(references)
    robot.drives()
    values = (nan, inf, -inf, 1e308, -1e308, 1e9)
    for value in values:
        for fields in ({"equilibrium": value, "stiffness": 9.0}, {"equilibrium": 0.0, "stiffness": value}):
            references.publish(JointReference(**fields))
            robot.torque()
    first, last = np.array(states[0].value[:2]), np.array(states[-1].value[:2])
    expect(bool((first == last).all()), f"reference {last} in place of {first}")
    return f"{2 * len(values)} references refused, {robot.drives():.2f} N m after"


def _sample(injected: str, check: Any, *given: Any, must: str, quick: bool = True) -> Fault:
    return Fault(injected, must, partial(check, *given), quick)


def sample_faults() -> list[Fault]:
    """Faults of the samples of a controller."""
    zero = "zero torque for these samples, reported; torque again after them"
    ignored = "no answer, zero torque once after 20 ms; torque again after them"
    within = "torques finite and within the limit, also after them"
    ended = "zero torque, reported; torque again when they go on"
    return [
        _sample("positions NaN", _unusable, _values("position", [nan] * 3), must=zero),
        _sample("one position infinite", _unusable, _values("position", [0.1, inf, 0.1]), must=zero, quick=False),
        _sample("one position 1e308 rad", _unusable, _values("position", [0.1, 1e308, 0.1]), must=zero, quick=False),
        _sample("positions of 200 rad", _unusable, _values("position", [200.0] * 3), must=zero, quick=False),
        _sample("no positions", _unusable, _values("position", []), must=zero, quick=False),
        _sample("one position for three joints", _unusable, _values("position", [0.1]), must=zero, quick=False),
        _sample("names of other joints", _unanswered, _named("a", "b", "c"), "", must=ignored),
        _sample("no names", _unanswered, _named(), "", must=ignored, quick=False),
        _sample("junk bytes", _unanswered, _bytes(b"\x00\x01\x00\x00junk"), "malformed", must=ignored, quick=False),
        _sample("empty serialised messages", _unanswered, _bytes(b""), "malformed", must=ignored, quick=False),
        _sample("truncated messages", _unanswered, lambda m: bytes(serialize_message(m)[:60]), "malformed",
                must=ignored, quick=False),
        _sample("a message with 100 000 names", _unanswered, _named(*(f"j{k}" for k in range(100_000))), "malformed",
                must=ignored, quick=False),
        _sample("one stamp for all samples", _frozen_stamps, None, must=ended),
        _sample("all stamps zero", _frozen_stamps, 0, must=ended, quick=False),
        _sample("no samples", _silent, must="zero torque once, reported; torque again when they go on"),
        _sample("pairs of samples in reverse order", _reordered, must=within, quick=False),
        _sample("5000 samples at once", _burst, must=f"{within}; the last one is answered", quick=False),
        _sample("stamps one hour back for 20 samples", _restarted, _stamped_by(-3600 * 10**9), must=within),
        _sample("stamps in the far future for 20 samples", _restarted, _stamped((2**31 - 1) * 10**9), must=within,
                quick=False),
        _sample("stamps before 1901 for 20 samples", _restarted, _stamped(-(2**31) * 10**9), must=within, quick=False),
        _sample("all positions frozen", _frozen_positions, slice(None), must=f"{ended} (within .3 s)"),
        _sample("one motor's position frozen", _frozen_positions, slice(1, 2), must=f"{ended} (within .3 s)",
                quick=False),
    ]  # fmt: skip


def _stamped_by(shift: int) -> Change:
    return lambda message: set_stamp(message.header.stamp, nanoseconds(message.header.stamp) + shift)


def input_faults() -> list[Fault]:
    """Faults of the estimates and references of a controller."""
    bounded = f"torques within {LIMIT:g} N m, correction factor within 1/3 to 3"
    odd = {
        "stiffness 1e9 +- .1 N m/rad, OK": (0, 1e9, 0.1),
        "stiffness 1e308, OK": (0, 1e308, 0.1),
        "stiffness infinite, OK": (0, inf, 0.1),
        "stiffness NaN, OK": (0, nan, 0.1),
        "stiffness -5 N m/rad, OK": (0, -5.0, 0.1),
        "stiffness 1e-300 N m/rad, OK": (0, 1e-300, 0.1),
        "standard deviation NaN, OK": (0, 9.0, nan),
        "standard deviation 0, OK": (0, 9.0, 0.0),
        "standard deviation -1, OK": (0, 9.0, -1.0),
        "standard deviation 1e308, OK": (0, 9.0, 1e308),
        "status 99": (99, 9.0, 0.1),
    }
    found = [
        Fault(f"estimates with {name}", bounded,
              partial(_estimates, StiffnessEstimate(status=status, value=value, standard_deviation=sd)), False)
        for name, (status, value, sd) in odd.items()
    ]  # fmt: skip
    return [
        *found,
        Fault("the estimator falls silent", "the correction ends with its time constant", _silent_estimator),
        Fault("references NaN, infinite, huge", "refused; the last reference stays", _references),
    ]
