"""From a designed motion to commands: torques, and the motor angles that they give, for `via sim` and `excitation`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.joint_axes import JointAxes
from via_controllers.joints.played_commands import PlayedCommands
from via_controllers.supervision.arm_limits import Limit
from via_controllers.supervision.joint_supervision import JointSupervisor
from via_core.command_files import COMMAND_UNITS
from via_core.devices import Device
from via_core.signals import Array, Signals
from via_sim.plants import JointPlant
from via_sim.simulate import Simulator

from via_gap.design.commands import rate_of
from via_gap.design.prescribed import Prescribed

PROPORTIONAL, DERIVATIVE, BANDWIDTH = 20.0, 0.6, 300.0  # K_P, K_D, w_f of the excitation node


@dataclass(frozen=True, eq=False)
class Commanded:
    """Commands of a motion.

    commands   motor (N, m) [N m]
    reference  (N, m) [rad] motor angles under these commands
    limited    limits that changed a torque
    """

    commands: Signals
    reference: Array
    limited: Limit


def commanded(device: Device, motion: Prescribed) -> Commanded:
    """Torques of the `excitation` node that follows a motion of the nominal joint, its supervisor included."""
    axes, rate = JointAxes(device), rate_of(device)
    player = PlayedCommands(
        motion.time, motion.torque, motion.theta, PROPORTIONAL, DERIVATIVE, BANDWIDTH,
        tuple(np.minimum(axes.torque_limit, 1e9).tolist()), 1e-3,
    )  # fmt: skip
    supervisor, simulator = JointSupervisor.of(player, axes), Simulator(JointPlant.from_device(device), rate)
    state, memory, limited = simulator.init(), supervisor.init(), Limit.NONE
    measured, _ = simulator.sample(state)
    torque, angles = np.empty_like(motion.torque), np.empty_like(motion.theta)
    for k in range(len(torque)):
        angles[k] = measured[1 : 1 + axes.n]
        memory, answer = supervisor.step(memory, JointSample(k / rate, float(measured[0]), angles[k].copy()), True)
        limited |= answer.limited
        torque[k] = answer.torque
        state, measured, _ = simulator.step(state, [*answer.torque, *np.zeros(4 - axes.n)])
    commands = Signals(np.arange(len(torque)) / rate, {"motor": torque}, COMMAND_UNITS, frozenset({"motor"}))
    return Commanded(commands, angles, limited)
