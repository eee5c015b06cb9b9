"""The peer plays the robot: it simulates a joint under the torques that answer its samples, and checks them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_core.signals import Array
from via_interfaces.msg import VsaCommand
from via_ros.conversions import set_stamp
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

from via_validation.reliability.fault import expect
from via_validation.reliability.graph import Graph

DEVICE = load_device("qbmove_a")
NAMES = [DEVICE.link_joint, *DEVICE.motor_joints]
LIMIT = max(getattr(motor, "torque_limit", None) or np.inf for motor in DEVICE.motors)  # [N m]
PERIOD = 1_000_000  # [ns]
FIRST = 1_000_000_000  # [ns]
Change = Callable[[JointState], Any]  # alters the message, or returns another message or bytes in its place


class Robot:
    """A controller of DEVICE in `graph`, and its samples."""

    def __init__(self, graph: Graph, controller: str = "excitation", **parameters: Any) -> None:
        self.graph = graph
        graph.observe_diagnostics()
        self.samples = graph.publisher(JointState, "/joint_states")
        self.commands = graph.hear(VsaCommand, DEVICE.command_topic)
        self.node = graph.add(NODES[controller], device=DEVICE.name, **parameters)
        graph.connected(self.samples)
        graph.until(lambda: graph.peer.count_publishers(DEVICE.command_topic) == 1, "a publisher of commands")
        self.tick = 0
        self._joint = Simulator(JointPlant.from_device(DEVICE), 1e9 / PERIOD, Sensors.of_device(DEVICE))
        self._body = self._joint.init((0.0, 0.3, -0.3, 0.0, 0.0, 0.0))

    def message(self) -> JointState:
        """The next sample."""
        self.tick += 1
        torque = np.array(self.commands[-1].motor) if self.commands else np.zeros(2)
        self._body, measured, _ = self._joint.step(self._body, [*self._bounded(torque), 0.0, 0.0])
        message = JointState(name=NAMES, position=measured[:3].tolist(), effort=[np.nan, 0.0, 0.0])
        set_stamp(message.header.stamp, FIRST + self.tick * PERIOD)
        return message

    @staticmethod
    def _bounded(torque: Array) -> Array:
        """What a motor makes of torques that `checked` would refuse."""
        return np.clip(np.nan_to_num(torque), -LIMIT, LIMIT) if torque.shape == (2,) else np.zeros(2)

    def send(self, change: Change | None = None) -> None:
        """Send the next sample, changed."""
        self._send(self.message(), change)

    def _send(self, message: JointState, change: Change | None) -> None:
        other = None if change is None else change(message)
        self.samples.publish(message if other is None else other)

    def torque(self, change: Change | None = None) -> Array:
        """The torques (2,) that answer the next sample [N m]; raises MissedError beyond the limit."""
        message, first = self.message(), len(self.commands)
        self._send(message, change)

        def answers() -> list[VsaCommand]:  # not the zero torque that a slow machine causes
            return [each for each in self.commands[first:] if each.header.stamp == message.header.stamp]

        self.graph.until(lambda: bool(answers()), "an answer to a sample")
        return self.checked(answers()[0])

    def checked(self, command: VsaCommand) -> Array:
        """The torques of a command; raises MissedError for one that is not finite or beyond the limit."""
        torque = np.array(command.motor)
        expect(bool(np.isfinite(torque).all() and np.abs(torque).max() <= LIMIT), f"torques of {torque} N m")
        return torque

    def drives(self, samples: int = 100) -> float:
        """The largest torque that answers so many sound samples [N m]; raises MissedError if it is zero."""
        largest = max(float(np.abs(self.torque()).max()) for _ in range(samples))
        expect(largest > 0.0, f"no torque in {samples} samples")
        return largest
