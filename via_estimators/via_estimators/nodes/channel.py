"""Estimator channel: one method on one device, from sample rows to published messages, with its computing time."""

from __future__ import annotations

import re
from time import perf_counter_ns
from typing import Any, NamedTuple

import numpy as np
from rclpy.node import Node
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import Status
from via_interfaces.msg import DampingEstimate, MotorEstimate, StiffnessEstimate
from via_ros import qos
from via_ros.reports import StatusReport
from via_ros.serialised import Template, raw

from via_estimators.contract import Estimator, Live

MICROSECOND = 1000  # [ns]


class Member(NamedTuple):
    """Message members that hold some outputs of an estimator and their standard deviations."""

    value: str
    standard_deviation: str
    outputs: str  # pattern of their names


MESSAGES: dict[str, tuple[Any, tuple[Member, ...]]] = {
    "stiffness": (
        StiffnessEstimate,
        (
            Member("value", "standard_deviation", r"stiffness"),
            Member("transmission_value", "transmission_standard_deviation", r"stiffness_\d+"),
        ),
    ),
    "damping": (DampingEstimate, (Member("value", "standard_deviation", r"damping"),)),
    "motor": (
        MotorEstimate,
        (
            Member("inertia", "inertia_standard_deviation", r"motor_inertia_\d+"),
            Member("damping", "damping_standard_deviation", r"motor_damping_\d+"),
        ),
    ),
}


class EstimatorChannel:
    """One method on one device; publishes on `topic`/stiffness, /damping and /motor, as far as the method has them."""

    def __init__(self, node: Node, device: Device, method: str, estimator: Estimator, topic: str) -> None:
        self.device, self.method, self.live = device, method, Live(estimator)
        self.report = StatusReport(node, device.name, method)
        self.sequence = self._reported = self._spent = 0
        self.status: int = Status.WARMING_UP  # of the last sample
        self._logger, self._told = node.get_logger(), set[str]()
        self._outputs, topics = [], []
        for name, (kind, members) in MESSAGES.items():
            message = kind(method=method)
            message.header.frame_id = device.name
            output = _Output(message, members, estimator.outputs)
            if output.used:
                publisher = node.create_publisher(kind, f"{topic}/{name}", qos.SAMPLES)
                topics.append(publisher.topic_name)
                self._outputs.append((output, raw(publisher)))
        self.topics = ", ".join(topics)
        # An invalid sample loads the compiled kernel before the first valid one arrives.
        self.live.take(np.full((1, 1 + len(estimator.inputs)), np.nan))
        self.live.health()  # its first call takes several periods of a loop at 1 kHz
        self.live.restart()
        estimator.load()

    def take(self, row: Array, stamp: bytes) -> None:
        """Process one sample row (1, 1 + k) and publish the estimates, with its stamp (8,)."""
        begin = perf_counter_ns()
        status = self.status = self.live.take(row)
        self._spent += perf_counter_ns() - begin
        for output, publish in self._outputs:
            publish(output.write(stamp, self.sequence, status, self.live.numbers))
        self.sequence += 1

    def restart(self) -> int:
        """Forget every sample; returns their number. Messages continue to be numbered."""
        samples = self.live.health().samples
        self.live.restart()
        return samples

    def fault(self) -> str:
        """The suspected fault of signals or device file, '' without one; each is logged once."""
        fault = self.live.fault()
        if fault and fault not in self._told:
            self._told.add(fault)
            self._logger.warning(f"{self.device.name} {self.method}: {fault}")
        return fault

    def cost(self) -> tuple[int, float]:
        """Samples since the last call, and the mean computing time [us] per sample."""
        count, spent = self.sequence - self._reported, self._spent
        self._reported, self._spent = self.sequence, 0
        return count, spent / MICROSECOND / max(count, 1)


class _Output:
    """A serialised message and the positions of an estimate's numbers in it."""

    def __init__(self, message: Any, members: tuple[Member, ...], outputs: tuple[str, ...]) -> None:
        found = [
            (member, [at for at, output in enumerate(outputs) if re.fullmatch(member.outputs, output)])
            for member in members
        ]
        for member, sources in found:
            if not isinstance(getattr(message, member.value), float):
                setattr(message, member.value, [0.0] * len(sources))
                setattr(message, member.standard_deviation, [0.0] * len(sources))
        self._template = Template(message)
        places, sources = [], []
        for member, each in found:
            if each:
                places += [*self._template.places(member.value), *self._template.places(member.standard_deviation)]
                sources += [*each, *(len(outputs) + at for at in each)]
        self.used = bool(places)
        self._places, self._sources = np.array(places), np.array(sources)

    def write(self, stamp: bytes, sequence: int, status: int, numbers: Array) -> bytes:
        """The message of numbers (2k,): values, then standard deviations."""
        self._template.doubles[self._places] = numbers[self._sources]
        return self._template.numbered(stamp, sequence, bytes((status,)))
