"""The motion that a device gets without a log: that of the `excitation` node, or a general motion of the device's kind.

An antagonistic joint with torque motors moves as the `excitation` node moves it, supervisor included. Any other joint
runs the general motion of `proposal`. A damper's command swings over its whole range meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.joint_methods import ExcitationParameters
from via_core.command_files import COMMAND_UNITS
from via_core.devices import Device
from via_core.signals import Array, Signals
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulation, Simulator, simulate

from via_gap.design.commands import rate_of
from via_gap.design.proposal import general_motion

DAMPER_FREQUENCY = 0.4  # [Hz]


@dataclass(frozen=True)
class DefaultMotion:
    """Commands and what ideal sensors of the device's rate measure under them.

    name  in words
    """

    name: str
    commands: Signals
    simulation: Simulation


def default_motion(device: Device, duration: float = 12.0) -> DefaultMotion:
    """The default motion; `duration` [s] applies to the `excitation` node. Raises ParameterError if no motion fits."""
    if device.arrangement == "antagonistic" and device.drive == "torque":
        commands, name = excitation(device, duration), "the excitation node"
    else:
        chosen = "strokes under two loads" if device.drive == "servo" else "ladder of speeds"
        motion, commands = general_motion(device, name=chosen)
        name = f"the general motion '{motion.name}'"
    if device.damper is not None:
        swing = 0.5 - 0.5 * np.cos(2.0 * pi * DAMPER_FREQUENCY * commands.time)
        channels = dict(commands.channels) | {"damping": swing}
        commands = Signals(commands.time, channels, COMMAND_UNITS, frozenset(channels))
    return DefaultMotion(name, commands, ideal(device, commands))


def ideal(device: Device, commands: Signals) -> Simulation:
    """What sensors without noise measure under commands, at the rate of the device's sensors."""
    rate = rate_of(device)
    sensors = Sensors(velocity_noise=0.0, link_torque_noise=0.0, rate=device.sensors.rate)
    start = np.zeros(6)
    if device.drive == "servo":
        angles = device.motor_angles(commands["equilibrium"][0], commands["preset"][0])
        start[0], start[1 : 1 + device.n_motors] = commands["equilibrium"][0], angles
    return simulate(
        JointPlant.from_device(device), commands, len(commands) / rate, rate, sensors, InitialConditions(start)
    )


def excitation(device: Device, duration: float) -> Signals:
    """Torques (N, 2) [N m] that the `excitation` node sends to an antagonistic joint without sensor noise."""
    joint = ExcitationParameters(device=device.name).of(device)
    rate = rate_of(device)
    simulator = Simulator(JointPlant.from_device(device), rate)
    state, memory = simulator.init(), joint.supervisor.init()
    measured, _ = simulator.sample(state)
    torque: Array = np.empty((round(duration * rate), 2))
    for k in range(len(torque)):
        sample = JointSample(k / rate, float(measured[0]), measured[1:3].copy())
        memory, answer = joint.supervisor.step(memory, sample, True)
        torque[k] = answer.torque
        state, measured, _ = simulator.step(state, [*answer.torque, 0.0, 0.0])
    time = np.arange(len(torque)) / rate
    return Signals(time, {"motor": torque}, COMMAND_UNITS, frozenset({"motor"}))
