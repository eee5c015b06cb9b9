"""Node `arm_simulator`: one simulated robot of several flexible joints that looks like a driver.

ros2 run via_sim arm_simulator --ros-args -p arm:=reference_4dof -p mode:=lockstep

publishes   /joint_states       sensor_msgs/JointState: all links and motors, joint by joint, base first
            /<arm>/contact      geometry_msgs/WrenchStamped, what walls and hands do to the end effector
            /clock, /diagnostics  as every simulator, see `simulation`; how time runs as well
subscribes  /<arm>/command      via_interfaces/VsaCommand, MOTOR_TORQUE: torques of all motors in joint order
offers      ~/push              via_interfaces/Push: a blow on the links, or links put aside
            ~/hold              via_interfaces/Hold: somebody holds the end effector and lets it go

Springs that would go beyond their stops stop the arm where it is (counted). Effort of a motor is the torque that it was
given, effort of a link the spring's torque where there are torque sensors.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import load_vsa_arm
from via_core.wire import command_topic
from via_interfaces.msg import VsaCommand
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_ros.arms import ArmStateWriter
from via_ros.conversions import command_of, set_stamp
from via_ros.parameters import declare
from via_ros.spin import run

from via_sim.bodies import ArmBody, Body
from via_sim.contacts import Wall
from via_sim.nodes.simulation import SimulationNode, TimeParameters
from via_sim.simulate import MAX_SEED

WALL = 6  # numbers of one wall: a point on it [m] and its normal


@dataclass(frozen=True)
class ArmSimulatorParameters(TimeParameters):
    """Parameters of the node."""

    arm: str = field(default="reference_4dof", metadata={"description": "arm name or path to its YAML"})
    posture: tuple[float, ...] = field(
        default=(), metadata={"description": "link angles at the start, base first [rad]; empty: all zero"}
    )
    walls: tuple[float, ...] = field(
        default=(), metadata={"description": "six numbers per wall: a point on it [m], its normal; empty: none"}
    )
    link_friction: tuple[float, ...] = field(
        default=(),
        metadata={"description": "viscous friction of the links [N m s/rad]; empty: what the arm's file says"},
    )
    torque_sensors: bool = field(default=False, metadata={"description": "the springs' torques are measured"})
    torque_noise: float = field(
        default=0.0, metadata={"description": "standard deviation of their noise", "unit": "N m", "range": (0.0, 1e3)}
    )
    seed: int = field(default=0, metadata={"description": "seed of the sensor noise", "range": (0, MAX_SEED)})


def body_of(parameters: ArmSimulatorParameters) -> ArmBody:
    """The arm that the parameters describe; raises ParameterError or DeviceError."""
    arm, numbers = load_vsa_arm(parameters.arm), np.array(parameters.walls, dtype=float)
    if len(numbers) % WALL:
        raise ParameterError(f"parameter walls must hold {WALL} numbers per wall, got {len(numbers)}")
    if parameters.link_friction:
        arm = replace(arm, link_friction=np.array(parameters.link_friction, dtype=float))
    walls = tuple(Wall(row[:3], row[3:]) for row in numbers.reshape(-1, WALL))
    return ArmBody(arm, np.array(parameters.posture or [0.0] * arm.n, dtype=float), walls)


class ArmSimulatorNode(SimulationNode[Array]):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("arm_simulator", **options)
        self._chosen = own = declare(self, ArmSimulatorParameters)
        self._body: Body[Any] = body_of(own)
        self._state = self._body.init()
        self._noise = np.random.default_rng(own.seed)
        self._count = len(self._body.joints)
        self._given = np.zeros(self._count)  # [N m] during the last tick
        self._held_until = 0  # ticks
        self._stops = self._failures = 0
        self._step_of(self._given)  # loads what is compiled before anybody waits for it
        self._samples = ArmStateWriter(self._body.name, self._body.joints)
        self._contact = WrenchStamped()
        self._contact.header.frame_id = self._body.name
        self._contacts = self.create_publisher(WrenchStamped, f"/{self._body.name}/contact", qos.SAMPLES)
        self._beside.append(self._contacts)
        self.create_service(Push, "~/push", self._push)
        self.create_service(Hold, "~/hold", self._hold)
        self.start_listening(own, self._body.name, command_topic(self._body.name))

    # ---- the body

    def _passive(self) -> Array:
        return np.zeros(self._count)

    def _row_of(self, message: VsaCommand) -> Array | None:
        command = command_of(message, self._count)
        return None if command is None or command.mode != VsaCommand.MOTOR_TORQUE else command.motor

    def _step_of(self, torque: Array) -> Any:
        return self._body.step(self._state, torque, 1.0 / self._chosen.rate)

    def _advance(self, command: Array) -> None:
        if self._held_until and self.ticks >= self._held_until:
            self._body, self._held_until = self._body.released(), 0
        self._given = self._body.given(self._state, command)
        try:
            after = self._step_of(command)
        except ParameterError:
            self._stops += 1
            after = self._body.stopped(self._state)
        if not np.isfinite(self._body.reading(after).q).all():
            self._failures += 1
            after = self._body.stopped(self._state)
        self._state = after

    def _sample(self, stamp: int) -> JointState:
        set_stamp(self._contact.header.stamp, stamp)
        force = self._contact.wrench.force
        force.x, force.y, force.z = self._body.contact_force(self._state).tolist()
        self._contacts.publish(self._contact)
        told, samples = self._body.reading(self._state), self._samples
        links, motors = samples.links, samples.motors
        samples.position[links], samples.position[motors] = told.q, told.theta
        samples.velocity[links], samples.velocity[motors] = told.velocity, told.motor_velocity
        samples.effort[motors] = self._given
        if self._chosen.torque_sensors:
            noise = self._noise.normal(0.0, self._chosen.torque_noise, self._count)
            samples.effort[links] = told.spring_torque + noise
        return samples.stamped(stamp)

    def _told(self) -> tuple[dict[str, bool], dict[str, Any]]:
        held = self._held_until > 0
        troubles = {"springs at their stops": self._stops > 0, "numerical failures": self._failures > 0}
        return troubles, {"stops": self._stops, "numerical failures": self._failures, "held": held}

    # ---- disturbances

    def _push(self, request: Push.Request, answer: Push.Response) -> Push.Response:
        impulse, deflection = np.array(request.impulse), np.array(request.deflection)
        answer.success = False
        for name, values in (("impulse", impulse), ("deflection", deflection)):
            if len(values) not in (0, self._count) or not np.isfinite(values).all():
                answer.message = f"{name} must hold {self._count} finite numbers or none, got {values.tolist()}"
                return answer
        nothing = np.zeros(self._count)
        try:
            self._state = self._body.pushed(
                self._state, impulse if len(impulse) else nothing, deflection if len(deflection) else nothing
            )
        except ParameterError as error:
            answer.message = str(error)
            return answer
        answer.success, answer.message = True, f"pushed at tick {self.ticks}"
        return answer

    def _hold(self, request: Hold.Request, answer: Hold.Response) -> Hold.Response:
        answer.success = bool(np.isfinite(request.duration)) and request.duration >= 0.0
        if not answer.success:
            answer.message = f"duration must be 0 s or more, got {request.duration}"
        elif request.duration == 0.0:
            self._body, self._held_until = self._body.released(), 0
            answer.message = "let go"
        else:
            self._body = self._body.held(self._state)
            self._held_until = self.ticks + max(1, round(request.duration * self._chosen.rate))
            answer.message = f"held from tick {self.ticks} to {self._held_until}"
        return answer


def main() -> int:
    """Run the node."""
    return run(ArmSimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
