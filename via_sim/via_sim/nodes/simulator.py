"""Node `simulator`: one simulated joint with the interface of a driver.

ros2 run via_sim simulator --ros-args -p device:=cubic_demo -p mode:=lockstep

publishes   /joint_states       sensor_msgs/JointState, measurements of the device's sensors at every tick
            /clock, /diagnostics  see `simulation`, also for the modes of time
            /<device>/truth/... StiffnessEstimate, DampingEstimate with method 'truth', if the parameter `truth` is set
subscribes  /<device>/command   via_interfaces/VsaCommand
offers      ~/set_effects, ~/clear_effects, see `effect_services`; they act from the next tick on
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from via_core.devices import load_device
from via_core.parameters import parameter
from via_core.signals import Array
from via_interfaces.msg import DampingEstimate, StiffnessEstimate, VsaCommand
from via_ros import qos
from via_ros.conversions import Command, JointStateWriter, followed, set_stamp
from via_ros.parameters import declare
from via_ros.spin import run

from via_sim.joint.layout import DAMPING, EXTERNAL, GOAL, M1, N_COMMANDS, POWER
from via_sim.joint.measurements import MEASURED, TRUTH
from via_sim.nodes.effect_services import EffectServices
from via_sim.nodes.simulation import SimulationNode, TimeParameters
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import MAX_SEED, Simulator, finite, passive_command


@dataclass(frozen=True)
class SimulatorParameters(TimeParameters):
    """Parameters of `simulator`."""

    device: str = parameter("cubic_demo", "device name or path to its YAML")
    seed: int = parameter(0, "seed of the sensor noise", "", (0, MAX_SEED))
    effects: str = parameter("", "effects file; empty: the nominal model")
    own_effects: str = parameter("", "modules or files that add effects, separated by commas; their code is executed")
    truth: bool = parameter(False, "whether to publish true stiffness and damping")


class SimulatorNode(SimulationNode[Array]):
    """Simulator node of one joint."""

    def __init__(self, **options: Any) -> None:
        super().__init__("simulator", **options)
        self._chosen = own = declare(self, SimulatorParameters)
        self.device = load_device(own.device)
        self._effects = EffectServices(self, self._change)
        self._effects.load(own.effects, filter(None, own.own_effects.split(",")))
        self._state = self._simulator.init(seed=own.seed)
        self._simulator.step(self._state, np.zeros(N_COMMANDS))  # compiles now and not in the first tick
        self._measured, self._truth = self._simulator.sample(self._state)
        self._failures, self._sent = 0, np.nan
        self._samples = JointStateWriter(self.device)
        self._truths: list[tuple[Any, Any]] = []
        if own.truth:
            self._truths.append(self._offer(StiffnessEstimate, "stiffness"))
            self._truths.append(self._offer(DampingEstimate, "damping"))
        self.start_listening(own, self.device.name, self.device.command_name)

    def _offer(self, kind: Any, what: str) -> tuple[Any, Any]:
        message = kind(method="truth")
        message.header.frame_id = self.device.name
        publisher = self.create_publisher(kind, f"{self.device.name}/truth/{what}", qos.SAMPLES)
        self._beside.append(publisher)
        return message, publisher

    def _change(self, effects: Any) -> None:
        """Simulate with these effects from now on; raises ParameterError for one that does not fit."""
        plant = JointPlant.from_device(self.device).with_effects(effects)
        self._simulator = Simulator(plant, self._chosen.rate, Sensors.of_device(self.device))

    # ---- the robot

    def _passive(self) -> Array:
        return passive_command(self._simulator.plant, self._state)

    def _row_of(self, command: Command) -> Array | None:
        """The command row (N_COMMANDS,) of the kernel; the drive of a rigid joint acts on its link."""
        if self.device.drive == "position":
            return _goal_row(command)
        checked = followed(command, self.device.n_drives)
        if checked is None:
            return None
        command = checked
        servo = self.device.drive == "servo"
        row = np.zeros(N_COMMANDS)
        row[DAMPING] = command.damping
        motors = slice(M1, M1 + self.device.n_motors)
        if command.mode == VsaCommand.EQUILIBRIUM_PRESET and (servo or not self.device.n_motors):
            row[motors] = self.device.motor_angles(command.equilibrium, command.preset)
        elif (command.mode == VsaCommand.MOTOR_POSITION and servo) or (
            command.mode == VsaCommand.MOTOR_TORQUE and not servo
        ):
            row[motors if self.device.n_motors else slice(EXTERNAL, EXTERNAL + 1)] = command.motor
        else:
            return None
        return row

    def _advance(self, command: Array) -> None:
        before = self._state
        self._state, self._measured, self._truth = self._simulator.step(before, command)
        self._sent = command[EXTERNAL]
        if finite(self._state):
            return
        self._failures += 1
        self._command = passive_command(self._simulator.plant, before)
        self._sent = self._command[EXTERNAL]
        self._state, self._measured, self._truth = self._simulator.step(before, self._command)
        if not finite(self._state):
            self._state = self._simulator.init(seed=self._chosen.seed)
            self._measured, self._truth = self._simulator.sample(self._state)

    def _sample(self, stamp: int) -> None:
        for (message, publisher), value in zip(
            self._truths, (self._truth[TRUTH.stiffness], self._truth[TRUTH.damping])
        ):
            set_stamp(message.header.stamp, stamp)
            message.sequence = self.ticks
            message.value = float(value)
            publisher.publish(message)
        measured, count = self._measured, 1 + self.device.n_motors
        self._samples.position[:count] = measured[:count]
        self._samples.velocity[:count] = measured[MEASURED.q_velocity : MEASURED.q_velocity + count]
        self._samples.effort[0] = measured[MEASURED.tau_link]
        if self.device.drive != "position":  # a position drive measures no torque: NaN
            self._samples.effort[1:] = (
                measured[MEASURED.tau_1 : MEASURED.tau_1 + count - 1] if self.device.n_motors else self._sent
            )

    def _diagnose(self) -> tuple[dict[str, int], dict[str, Any]]:
        values = {"numerical failures": self._failures, "effects": self._effects.active}
        return {"numerical failures": self._failures}, values


def _goal_row(command: Command) -> Array | None:
    """The command row (N_COMMANDS,) of a position drive; an equilibrium of NaN switches it off."""
    if (
        command.mode != VsaCommand.EQUILIBRIUM_PRESET
        or np.isinf(command.equilibrium)
        or not np.isfinite(command.damping)
    ):
        return None
    row = np.zeros(N_COMMANDS)
    row[DAMPING] = command.damping
    if np.isfinite(command.equilibrium):
        row[GOAL], row[POWER] = command.equilibrium, 1.0
    return row


main = partial(run, SimulatorNode)  # the executable
