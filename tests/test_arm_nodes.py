"""Arms over DDS: the limit cycle in closed loop and lockstep, lifecycle, watchdogs, disturbances, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from via_bringup.control.limit_cycle import ARM, EQUILIBRIUM, LEVEL, STIFFNESS, CycleCourse
from via_controllers.modal_transform import first_basis
from via_controllers.nodes.modal_limit_cycle import ModalLimitCycleNode
from via_interfaces.msg import ControlState, VsaCommand
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_ros.conversions import nanoseconds
from via_sim.nodes.arm_simulator import ArmSimulatorNode

PERIOD = 1_000_000  # [ns]
REST = EQUILIBRIUM.tolist()


class ArmBench:
    """A simulated arm at its equilibrium, its controller, and ears on everything they say."""

    def __init__(self, graph, controller=None, **parameters):
        self.graph, self.peer = graph, graph.node("peer")
        self.samples, self.states, self.contacts, self.reports, self.commands = [], [], [], [], []
        self.peer.create_subscription(JointState, "/joint_states", self._sample, qos.SAMPLES)
        self.peer.create_subscription(ControlState, f"/{ARM.name}/control", self._state, qos.SAMPLES)
        self.peer.create_subscription(WrenchStamped, f"/{ARM.name}/contact", self._contact, qos.SAMPLES)
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, qos.CONTROL)
        self.peer.create_subscription(VsaCommand, f"/{ARM.name}/command", self._command, qos.SAMPLES)
        self.controller = None
        if controller is not None:
            self.controller = graph.add(ModalLimitCycleNode, **controller)
        self.simulator = graph.add(ArmSimulatorNode, posture=REST, **parameters)
        self.push = self.peer.create_client(Push, "/arm_simulator/push")
        self.hold = self.peer.create_client(Hold, "/arm_simulator/hold")
        self.change = self.peer.create_client(ChangeState, "/modal_limit_cycle/change_state")
        clients = [self.push, self.hold, *([self.change] if controller is not None else [])]
        graph.until(lambda: all(each.service_is_ready() for each in clients))

    def _sample(self, message):
        told = np.array([message.position, message.velocity, message.effort])
        self.samples.append((nanoseconds(message.header.stamp), told))

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
        return np.array([value[self.names.index(name)] for _, _, value in self.states])

    @property
    def joints(self):
        """(N, 3, 8) positions, velocities and efforts of links and motors by turns."""
        return np.array([told for _, told in self.samples])


def pushed_into(mode, share=0.5):
    """A deflection (n,) [rad] to the side of mode k, by a share of the cycle's amplitude."""
    z = np.zeros(ARM.n)
    z[mode] = share * np.sqrt(2.0 * LEVEL)
    return first_basis(ARM.inertia(EQUILIBRIUM), STIFFNESS).W @ z


@pytest.mark.parametrize("mode", [0, 1])
def test_the_cycle_after_a_push(graph, mode):
    """Number 2 over DDS: H within 2e-3, leak below 1e-4, 2 % after 1.2 s, frequency within .5 %."""
    bench = ArmBench(graph, {"mode": mode + 1}, mode="lockstep", duration=2.4)
    answer = bench.call(bench.push, Push.Request(deflection=pushed_into(mode).tolist()))
    assert answer.success
    begin = int(answer.message.split()[-1])
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 2400, timeout=60.0)
    z = np.stack([bench.quantity(f"z_{i + 1}") for i in range(ARM.n)], axis=1)[begin:]
    course = CycleCourse(
        H=bench.quantity("H")[begin:] / LEVEL - 1.0,
        leak=np.abs(np.delete(z, mode, axis=1)).max(axis=1) / np.sqrt(2.0 * LEVEL),
        z=z[:, mode],
        eigenvalue=(2.0 * np.pi * bench.quantity(f"frequency_{mode + 1}")[begin:]) ** 2,
    )
    assert np.abs(course.H[course.late]).max() < 2e-3
    assert course.leak[course.late].max() < 1e-4
    assert len(course.H) >= 2390 and np.abs(course.H[1200:]).max() < 0.02
    frequency, linear = course.frequencies()
    assert frequency == pytest.approx(linear, rel=5e-3)
    assert {activity for activity, _, _ in bench.states} == {ControlState.ACTIVE}
