"""The maximum-velocity controller of Section 7 in closed loop with a simulated visco-elastic joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.joints.max_velocity import MaxVelocity
from via_core.devices import Device
from via_core.signals import Array
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import Simulator

RATE = 1000.0  # [Hz]


@dataclass(frozen=True)
class Throw:
    """True motion of link and motor from rest, (N,) each."""

    time: Array  # [s]
    q: Array  # [rad]
    theta: Array  # [rad]
    velocity: Array  # [rad/s] of the link
    motor_velocity: Array  # [rad/s]
    torque: Array  # [N m] commanded until the next sample; NaN at the last one


def throw(
    device: Device, controller: MaxVelocity, damping_command: float, sensors: Sensors = IDEAL, more: float = 0.0
) -> Throw:
    """Simulate up to t_f and `more` [s] longer; the controller gets measurements from `sensors`."""
    simulator = Simulator(JointPlant.from_device(device), RATE, sensors)
    body, state = simulator.init(seed=1), controller.init()
    measured, _ = simulator.sample(body)
    seen, torques = [body[:6]], []
    for tick in range(round((controller.horizon + more) * RATE)):
        state, out = controller.step(state, JointSample(tick / RATE, measured[0], measured[1:2]))
        body, measured, _ = simulator.step(body, [out.torque[0], 0.0, damping_command, 0.0])
        seen.append(body[:6])
        torques.append(out.torque[0])
    q, theta, _, velocity, motor_velocity, _ = np.array(seen).T
    return Throw(np.arange(len(q)) / RATE, q, theta, velocity, motor_velocity, np.array([*torques, np.nan]))
