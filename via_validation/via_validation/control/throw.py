"""Section 7's policy in closed loop with a simulated visco-elastic joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.max_velocity import MaxVelocity
from via_core.devices import Device
from via_core.signals import Array
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import Simulator

RATE = 1000.0  # [Hz]


@dataclass(frozen=True)
class Throw:
    """The true motion of link and motor under the law, (N,) each, from rest."""

    time: Array  # [s]
    q: Array  # [rad]
    theta: Array  # [rad]
    velocity: Array  # [rad/s] of the link
    motor_velocity: Array  # [rad/s]
    torque: Array  # [N m] commanded from there on; of the last sample NaN


def throw(
    device: Device, law: MaxVelocity, damping_command: float, sensors: Sensors = IDEAL, more: float = 0.0
) -> Throw:
    """The motion up to t_f and `more` [s]; the law sees what `sensors` read."""
    simulator = Simulator(JointPlant.from_device(device), RATE, sensors)
    body, state = simulator.init(seed=1), law.init()
    measured, _ = simulator.sample(body)
    seen, torques = [body[:6]], []
    for tick in range(round((law.horizon + more) * RATE)):
        state, out = law.step(state, JointSample(tick / RATE, measured[0], measured[1:2]))
        body, measured, _ = simulator.step(body, [out.torque[0], 0.0, damping_command, 0.0])
        seen.append(body[:6])
        torques.append(out.torque[0])
    q, theta, _, velocity, motor_velocity, _ = np.array(seen).T
    return Throw(np.arange(len(q)) / RATE, q, theta, velocity, motor_velocity, np.array([*torques, np.nan]))
