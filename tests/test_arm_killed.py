"""A controller killed at any moment leaves the arm passive within 20 ms: really killed, by its process id."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from via_bringup.control.limit_cycle import ARM, EQUILIBRIUM
from via_interfaces.msg import ControlState
from via_ros import qos
from via_ros.conversions import nanoseconds
from via_sim.nodes.arm_simulator import ArmSimulatorNode

WITHIN = 20_000_000  # [ns]
COMPILED = 120.0  # [s] within which the controller has started, its kernels compiled anew where need be
CONTROLLER = "from via_controllers.nodes.modal_limit_cycle import main; raise SystemExit(main())"


@pytest.mark.parametrize("after", [40, 55, 71])
def test_a_controller_that_is_killed_leaves_the_arm_passive_within_20_ms(graph, after):
    """Killed after so many samples; stamps are this machine's clock, and so is the time of the kill."""
    listener, samples, states = graph.node("listener"), [], []

    def hear(message):
        samples.append((nanoseconds(message.header.stamp), np.abs(message.effort[1::2]).max()))

    listener.create_subscription(JointState, "/joint_states", hear, qos.SAMPLES)
    listener.create_subscription(ControlState, f"/{ARM.name}/control", states.append, qos.SAMPLES)
    with subprocess.Popen([sys.executable, "-c", CONTROLLER], stdin=subprocess.DEVNULL) as controller:
        try:
            # Nobody but the listener is waited for: the arm falls until the controller has started.
            graph.add(ArmSimulatorNode, posture=EQUILIBRIUM.tolist(), mode="realtime", rate=250.0)
            graph.until(lambda: len(states) >= after and samples[-1][1] > 0.0, COMPILED)
            os.kill(controller.pid, signal.SIGKILL)
            killed = time.time_ns()
            controller.wait(timeout=30)
        finally:
            controller.kill()
    graph.until(lambda: samples[-1][0] > killed + 10 * WITHIN)
    driven = [stamp for stamp, torque in samples if torque > 0.0]
    # Effort of a sample is that of the tick before it. Up to the kill it was driven.
    assert killed - 2 * WITHIN < max(driven) <= killed + WITHIN
