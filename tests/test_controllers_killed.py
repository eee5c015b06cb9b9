"""A killed controller process leaves the arm or joint passive within 20 ms; one that is ended says so itself."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from via_bringup.demo.reference import ARM, EQUILIBRIUM
from via_interfaces.msg import ControlState, VsaCommand
from via_ros import qos
from via_ros.conversions import nanoseconds
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

WITHIN = 20_000_000  # [ns]
COMPILED = 600.0  # [s] for the controller to start, including compilation of its kernels
CONTROLLER = "from via_controllers.nodes.single import {} as main; raise SystemExit(main())"
ARGUMENTS = {"excitation": ("--ros-args", "-p", "device:=qbmove_a")}
ROBOTS = {  # name in topics, simulator node and its parameters, motors among the entries of an effort
    "modal_limit_cycle": (ARM.name, ArmSimulatorNode, {"posture": EQUILIBRIUM.tolist()}, slice(1, None, 2)),
    **dict.fromkeys(
        ("equilibrium_preset", "excitation"), ("qbmove_a", SimulatorNode, {"device": "qbmove_a"}, slice(1, None))
    ),
}


@pytest.mark.parametrize(
    ("method", "after"),
    [("modal_limit_cycle", 40), ("modal_limit_cycle", 71), ("equilibrium_preset", 55), ("excitation", 62)],
)
def test_a_killed_controller_leaves_its_motors_passive_within_20_ms(graph, method, after):
    """Killed after this many samples; stamps and the time of the kill are from the same clock."""
    listener, samples, states = graph.node("listener"), [], []
    name, simulator, parameters, motors = ROBOTS[method]

    def hear(message):
        samples.append((nanoseconds(message.header.stamp), np.abs(message.effort[motors]).max()))

    listener.create_subscription(JointState, "/joint_states", hear, qos.SAMPLES)
    listener.create_subscription(ControlState, f"/{name}/control", states.append, qos.SAMPLES)
    with subprocess.Popen(
        [sys.executable, "-c", CONTROLLER.format(method), *ARGUMENTS.get(method, ())], stdin=subprocess.DEVNULL
    ) as controller:
        try:
            # The simulator waits for the listener only: an arm falls until the controller has started.
            graph.add(simulator, mode="realtime", rate=250.0, **parameters)
            graph.until(lambda: len(states) >= after and samples[-1][1] > 0.0, COMPILED)
            os.kill(controller.pid, signal.SIGKILL)
            killed = time.time_ns()
            controller.wait(timeout=600)
        finally:
            controller.kill()
    graph.until(lambda: samples[-1][0] > killed + 10 * WITHIN)
    driven = [stamp for stamp, torque in samples if torque > 0.0]
    # The effort of a sample belongs to the tick before it. The last sample heard before the kill was driven.
    assert max(driven) <= killed + WITHIN


@pytest.mark.parametrize(("method", "number"), [("equilibrium_preset", signal.SIGINT), ("excitation", signal.SIGTERM)])
def test_the_last_command_of_a_controller_that_is_ended_is_zero(graph, method, number):
    """It does not leave the end of its torque to the watchdog of a driver."""
    listener, commands = graph.node("listener"), []
    name, simulator, parameters, _ = ROBOTS[method]
    listener.create_subscription(
        VsaCommand, f"/{name}/command", lambda each: commands.append(np.abs(each.motor).max()), qos.SAMPLES
    )
    with subprocess.Popen(
        [sys.executable, "-c", CONTROLLER.format(method), *ARGUMENTS.get(method, ())], stdin=subprocess.DEVNULL
    ) as controller:
        try:
            graph.add(simulator, mode="realtime", rate=250.0, **parameters)
            graph.until(lambda: len(commands) > 40 and commands[-1] > 0.0, COMPILED)
            controller.send_signal(number)
            assert controller.wait(timeout=600) == 0
        finally:
            controller.kill()
    graph.until(lambda: commands[-1] == 0.0)
