"""Damaged streams of samples into an estimator: what it answers, and whether an answer with status OK is wrong.

A simulated joint of variable stiffness moves for DURATION; its samples reach the estimator node over DDS in lockstep,
so that no result depends on the machine. A fault acts from ONSET on, a passing one until END.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from via_core.devices import load_device
from via_core.signals import Array, Signals
from via_core.status import Status
from via_estimators.nodes.estimator import EstimatorNode
from via_interfaces.msg import StiffnessEstimate
from via_ros.conversions import nanoseconds, set_stamp
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulation, simulate

from via_validation.compare.faults import torques_of
from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph

DEVICE = load_device("qbmove_a")
RATE, DURATION = 250.0, 14.0  # [Hz], [s]
ONSET, END = 4.0, 5.0  # [s]
PERIOD = round(1e9 / RATE)  # [ns]
FIRST = 1_000_000_000  # [ns] stamp of the first sample
CHUNK = 200  # messages without an answer, fewer than the queue of the node
SD, SHARE = 4.0, 0.15  # a wrong estimate differs by more standard deviations and by more of the true value
RECOVERED = 0.5  # least share of OK samples in the last two seconds after a passing fault
Message = Any  # JointState, or bytes of a serialised one


@dataclass(frozen=True)
class Sent:
    """A message, and the true stiffness at its sample [N m/rad]; NaN if it must get no estimate."""

    message: Message
    truth: float


Damage = Callable[[list[Sent]], list[Sent]]


@cache
def _motion() -> Simulation:
    time = np.arange(int(1000.0 * DURATION) + 1) / 1000.0
    channels = torques_of(DEVICE, time)
    commands = Signals(time, channels, dict.fromkeys(channels, "N m"), frozenset(channels))
    plant = JointPlant.from_device(DEVICE)
    return simulate(plant, commands, DURATION, 1000.0, Sensors.of_device(DEVICE), InitialConditions(seed=3))


def stream() -> list[Sent]:
    """The sound samples."""
    run = _motion()
    step = round(1000.0 / RATE)
    names = [DEVICE.link_joint, *DEVICE.motor_joints]
    rows = zip(
        np.column_stack([run.measured["q"], run.measured["theta"]])[::step],
        np.column_stack([run.measured["tau_link"], run.measured["tau"]])[::step],
        run.truth["stiffness"][::step],
        strict=True,
    )
    found = []
    for tick, (position, effort, truth) in enumerate(rows):
        message = JointState(name=names, position=position.tolist(), effort=effort.tolist())
        set_stamp(message.header.stamp, FIRST + tick * PERIOD)
        found.append(Sent(message, float(truth)))
    return found


# ---- damage


def changed(change: Callable[[JointState], None], until: float = END) -> Damage:
    """`change` in place of every message from ONSET to `until` [s]; an estimate is expected as before."""
    return _inside(lambda sent: [_with(sent, change)], until)


def only_at_onset(change: Callable[[JointState], None]) -> Damage:
    """`change` of a single message."""
    return changed(change, ONSET + 0.5 / RATE)


def unread(make: Callable[[JointState], Message], until: float = ONSET + 0.5 / RATE) -> Damage:
    """Messages that get no estimate, before the sound ones from ONSET to `until` [s]."""
    return _inside(lambda sent: [Sent(make(_copy(sent)), np.nan), sent], until)


def replaced(make: Callable[[JointState], Message], until: float = END) -> Damage:
    """Messages that get no estimate, in place of the sound ones."""
    return _inside(lambda sent: [Sent(make(_copy(sent)), np.nan)], until)


def lost(share: float, until: float = END) -> Damage:
    """Without a random share of the messages."""
    random = np.random.default_rng(1)
    return _inside(lambda sent: [] if random.random() < share else [sent], until)


def doubled(until: float = END) -> Damage:
    """Every message twice."""
    return _inside(lambda sent: [sent, sent], until)


def reordered(block: int, until: float = END) -> Damage:
    """Every so many messages in reverse order."""

    def damage(sound: list[Sent]) -> list[Sent]:
        first, last = round(ONSET * RATE), round(until * RATE)
        inside = [each for at in range(first, last, block) for each in sound[at : at + block][::-1]]
        return [*sound[:first], *inside, *sound[first + len(inside) :]]

    return damage


def interrupted(seconds: float) -> Damage:
    """Without the messages of so many seconds."""
    return lost(1.1, ONSET + seconds)


def shifted(seconds: float, until: float = DURATION) -> Damage:
    """Stamps moved by so many seconds."""

    def shift(message: JointState) -> None:
        set_stamp(message.header.stamp, nanoseconds(message.header.stamp) + round(seconds * 1e9))

    return changed(shift, until)


def frozen(until: float = DURATION, field: str = "position", joints: slice = slice(None)) -> Damage:
    """Values repeated from ONSET on."""
    kept: list[Array] = []

    def freeze(message: JointState) -> None:
        values = np.array(getattr(message, field))
        kept[:] = kept or [values[joints].copy()]
        values[joints] = kept[0]
        setattr(message, field, values.tolist())

    def damage(sound: list[Sent]) -> list[Sent]:
        kept.clear()
        return changed(freeze, until)(sound)

    return damage


def field_set(field: str, value: float, joints: slice = slice(None)) -> Callable[[JointState], None]:
    """One value for some joints."""

    def change(message: JointState) -> None:
        values = np.array(getattr(message, field))
        values[joints] = value
        setattr(message, field, values.tolist())

    return change


def field_scaled(field: str, factor: float, joints: slice = slice(None)) -> Callable[[JointState], None]:
    """Values of some joints times a factor."""

    def change(message: JointState) -> None:
        values = np.array(getattr(message, field))
        values[joints] *= factor
        setattr(message, field, values.tolist())

    return change


def _inside(change: Callable[[Sent], list[Sent]], until: float) -> Damage:
    def damage(sound: list[Sent]) -> list[Sent]:
        found: list[Sent] = []
        for tick, sent in enumerate(sound):
            found += change(sent) if ONSET <= tick / RATE < until else [sent]
        return found

    return damage


def _with(sent: Sent, change: Callable[[JointState], None]) -> Sent:
    message = _copy(sent)
    change(message)
    return Sent(message, sent.truth)


def _copy(sent: Sent) -> JointState:
    message = sent.message
    assert isinstance(message, JointState)
    return JointState(
        header=Header(stamp=Time(sec=message.header.stamp.sec, nanosec=message.header.stamp.nanosec)),
        name=list(message.name), position=list(message.position), effort=list(message.effort),
    )  # fmt: skip


# ---- checks


def estimator_fault(injected: str, must: str, damage: Damage, recovers: bool, quick: bool) -> Fault:
    """A fault of an estimator's samples; `recovers`: estimates must be OK again at the end."""
    return Fault(injected, must, partial(_estimated, damage, recovers), quick)


def _estimated(damage: Damage, recovers: bool, graph: Graph) -> str:
    messages = damage(stream())
    graph.add(EstimatorNode, device=DEVICE.name)
    samples = graph.publisher(JointState, "/joint_states")
    heard = graph.hear(StiffnessEstimate, f"/{DEVICE.name}/stiffness")
    graph.connected(samples)
    graph.until(lambda: graph.peer.count_publishers(f"/{DEVICE.name}/stiffness") == 1, "a publisher of estimates")
    due = 0
    for number, sent in enumerate(messages, 1):
        samples.publish(sent.message)
        due += not np.isnan(sent.truth)
        if number % CHUNK == 0 or number == len(messages):
            graph.until(lambda: len(heard) >= due, f"estimate {due}")  # noqa: B023
    graph.pause(0.1)  # for estimates beyond those expected
    expect(len(heard) == due, f"{len(heard)} estimates of {due} samples")
    truth = np.array([sent.truth for sent in messages if not np.isnan(sent.truth)])
    value = np.array([each.value for each in heard])
    sd = np.array([each.standard_deviation for each in heard])
    expect(bool(np.isfinite(value).all() and np.isfinite(sd).all()), "numbers that are not finite")
    ok = np.array([each.status == Status.OK for each in heard])
    error = np.abs(value - truth)
    wrong = ok & (error > SD * sd) & (error > SHARE * truth)
    after, late = np.arange(due) > ONSET * RATE, ok[-round(2.0 * RATE) :].mean()
    seen = f"{due} estimates of {len(messages)} messages; OK: {100.0 * ok[after].mean():.0f} % from the fault on, "
    seen += f"{100.0 * late:.0f} % at the end; {wrong.sum()} of them wrong"
    if wrong.any():
        times = np.flatnonzero(wrong) / RATE - ONSET
        seen += f", from {times[0]:.2f} to {times[-1]:.2f} s after the fault"
        seen += f", by up to {100.0 * float((error / truth)[wrong].max()):.0f} %"
    expect(not wrong.any(), seen)
    expect(late >= RECOVERED or not recovers, seen)
    return seen
