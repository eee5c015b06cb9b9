"""An arm in a graph for tests: simulator, controller, and everything that they say."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from via_interfaces.msg import ControlState, VsaCommand
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_ros.conversions import nanoseconds
from via_sim.nodes.arm_simulator import ArmSimulatorNode

ARM = "reference_4dof"


class ArmBench:
    """A simulated arm, a controller (class, its parameters, or None), and ears on everything they say."""

    def __init__(self, graph, kind=None, controller=None, **simulator):
        self.graph, self.peer = graph, graph.node("peer")
        self.samples, self.states, self.contacts, self.reports, self.commands = [], [], [], [], []
        self.peer.create_subscription(JointState, "/joint_states", self._sample, qos.SAMPLES)
        self.peer.create_subscription(ControlState, f"/{ARM}/control", self._state, qos.SAMPLES)
        self.peer.create_subscription(WrenchStamped, f"/{ARM}/contact", self._contact, qos.SAMPLES)
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, qos.CONTROL)
        self.peer.create_subscription(VsaCommand, f"/{ARM}/command", self._command, qos.SAMPLES)
        self.controller = None
        if kind is not None:
            self.controller = graph.add(kind, **(controller or {}))
        self.simulator = graph.add(ArmSimulatorNode, **simulator)
        self.push = self.peer.create_client(Push, "/arm_simulator/push")
        self.hold = self.peer.create_client(Hold, "/arm_simulator/hold")
        clients = [self.push, self.hold]
        if kind is not None:
            self.change = self.peer.create_client(ChangeState, f"/{self.controller.get_name()}/change_state")
            clients.append(self.change)
        graph.until(lambda: all(each.service_is_ready() for each in clients))

    def _sample(self, message):
        measured = np.array([message.position, message.velocity, message.effort])
        self.samples.append((nanoseconds(message.header.stamp), measured))

    def _state(self, message):
        self.states.append((message.activity, message.limited, np.array(message.value)))
        self.names = list(message.name)

    def _contact(self, message):
        force = message.wrench.force
        self.contacts.append((force.x, force.y, force.z))

    def _command(self, message):
        self.commands.append((nanoseconds(message.header.stamp), np.array(message.motor)))

    def call(self, client, request):
        answer = client.call_async(request)
        self.graph.until(answer.done)
        return answer.result()

    def transition(self, number):
        assert self.call(self.change, ChangeState.Request(transition=Transition(id=number))).success

    def quantity(self, name):
        """(N,) what the controller reported so far."""
        return np.array([value[self.names.index(name)] for _, _, value in self.states])

    def now(self, name, ago=0):
        """What it reported last, or so many samples ago."""
        return self.states[-1 - ago][2][self.names.index(name)]

    @property
    def joints(self):
        """(N, 3, 8) positions, velocities and efforts of links and motors by turns."""
        return np.array([measured for _, measured in self.samples])
