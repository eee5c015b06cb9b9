"""Base of simulator nodes for robots with several flexible joints: a driver interface, pushes and holds.

publishes   /joint_states       sensor_msgs/JointState: all links and motors, joint by joint, base first
            /<name>/contact     geometry_msgs/WrenchStamped, force of walls, hands and ground on the robot
            /<name>/base        geometry_msgs/PoseStamped, pose of a base that is not fixed
            /clock, /diagnostics  see `simulation`, also for the modes of time
subscribes  /<name>/command     via_interfaces/VsaCommand, mode MOTOR_TORQUE: torques of all motors in joint order
offers      ~/push              via_interfaces/Push: an impulse on the links, or a displacement of the links
            ~/hold              via_interfaces/Hold: holds the end effector for a time

A step that would deflect a spring beyond its stop is not taken; instead all velocities are set to zero, and the event
is counted. The effort of a motor is its limited torque; the effort of a link is its spring torque, if measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from via_core.errors import ParameterError
from via_core.parameters import parameter
from via_core.signals import Array
from via_core.wire import command_name
from via_interfaces.msg import VsaCommand
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_ros.conversions import ArmStateWriter, Command, followed, set_stamp
from via_ros.parameters import declare

from via_sim.nodes.simulation import LONGEST, SimulationNode, TimeParameters
from via_sim.robots.bodies import Body
from via_sim.simulate import MAX_SEED


@dataclass(frozen=True)
class RobotParameters(TimeParameters):
    """Parameters of every node for a multi-joint robot."""

    torque_sensors: bool = parameter(False, "whether spring torques are measured")
    torque_noise: float = parameter(0.0, "standard deviation of torque noise", "N m", (0.0, 1e3))
    seed: int = parameter(0, "seed of the sensor noise", "", (0, MAX_SEED))


Parameters = TypeVar("Parameters", bound=RobotParameters)


class RobotSimulationNode(SimulationNode[Array]):
    """A robot in simulated time.

    kind  dataclass of the node's parameters
    make  returns the robot for such parameters; raises ParameterError
    """

    def __init__(
        self, name: str, kind: type[Parameters], make: Callable[[Parameters], Body[Any]], **options: Any
    ) -> None:
        super().__init__(name, **options)
        own = declare(self, kind)
        self._chosen: RobotParameters = own
        self._body: Body[Any] = make(own)
        self._state = self._body.init()
        self._noise = np.random.default_rng(own.seed)
        self._count = len(self._body.joints)
        self._torque = np.zeros(self._count)  # [N m] during the last tick, limited
        self._held_until = 0  # ticks
        self._stops = self._failures = 0
        self._step_of(self._torque)  # compiles now and not during the first tick
        self._samples = ArmStateWriter(self._body.name, self._body.joints)
        self._contact = WrenchStamped()
        self._contact.header.frame_id = self._body.name
        self._contacts = self.create_publisher(WrenchStamped, f"{self._body.name}/contact", qos.SAMPLES)
        self._beside.append(self._contacts)
        self._base = PoseStamped()
        self._base.header.frame_id = "world"
        self._bases: Any = None
        if self._body.base(self._state) is not None:
            self._bases = self.create_publisher(PoseStamped, f"{self._body.name}/base", qos.SAMPLES)
            self._beside.append(self._bases)
        self.create_service(Push, "~/push", self.gate.request(self._push))
        self.create_service(Hold, "~/hold", self.gate.request(self._hold))
        self.start_listening(own, self._body.name, command_name(self._body.name))

    # ---- the body

    def _passive(self) -> Array:
        return np.zeros(self._count)

    def _row_of(self, command: Command) -> Array | None:
        checked = followed(command, self._count)
        return None if checked is None or checked.mode != VsaCommand.MOTOR_TORQUE else checked.motor

    def _step_of(self, torque: Array) -> Any:
        return self._body.step(self._state, torque, 1.0 / self._chosen.rate)

    def _advance(self, command: Array) -> None:
        if self._held_until and self.ticks >= self._held_until:
            self._body, self._held_until = self._body.released(), 0
        self._torque = self._body.limited(self._state, command)
        try:
            after = self._step_of(command)
        except ParameterError:
            self._stops += 1
            after = self._body.stopped(self._state)
        if not np.isfinite(after.q).all():
            self._failures += 1
            after = self._body.stopped(self._state)
        self._state = after

    def _sample(self, stamp: int) -> None:
        if self._contacts.get_subscription_count():
            set_stamp(self._contact.header.stamp, stamp)
            force = self._contact.wrench.force
            force.x, force.y, force.z = self._body.contact_force(self._state).tolist()
            self._contacts.publish(self._contact)
        base = self._body.base(self._state)
        if base is not None:
            set_stamp(self._base.header.stamp, stamp)
            at, turn = self._base.pose.position, self._base.pose.orientation
            at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = base.tolist()
            self._bases.publish(self._base)
        state, samples = self._state, self._samples
        links, motors = samples.links, samples.motors
        samples.position[links], samples.position[motors] = state.q, state.theta
        samples.velocity[links], samples.velocity[motors] = state.velocity, state.motor_velocity
        samples.effort[motors] = self._torque
        if self._chosen.torque_sensors:
            noise = self._noise.normal(0.0, self._chosen.torque_noise, self._count)
            samples.effort[links] = self._body.spring_torque(state) + noise

    def _diagnose(self) -> tuple[dict[str, int], dict[str, Any]]:
        held = self._held_until > 0
        events = {"springs at their stops": self._stops, "numerical failures": self._failures}
        return events, {"stops": self._stops, "numerical failures": self._failures, "held": held}

    # ---- disturbances

    def _push(self, request: Push.Request, answer: Push.Response) -> Push.Response:
        impulse, deflection = np.array(request.impulse), np.array(request.deflection)
        answer.success = False
        for name, values in (("impulse", impulse), ("deflection", deflection)):
            fits = len(values) in (0, self._count)
            if not fits or not np.isfinite(values).all():
                given = values.tolist() if fits else f"{len(values)} numbers"
                answer.message = f"{name} must hold {self._count} finite numbers or none, got {given}"
                return answer
        none = np.zeros(self._count)
        try:
            self._state = self._body.pushed(
                self._state, impulse if len(impulse) else none, deflection if len(deflection) else none
            )
        except ParameterError as error:
            answer.message = str(error)
            return answer
        answer.success, answer.message = True, f"pushed at tick {self.ticks}"
        return answer

    def _hold(self, request: Hold.Request, answer: Hold.Response) -> Hold.Response:
        answer.success = 0.0 <= request.duration <= LONGEST
        if not answer.success:
            answer.message = f"duration must lie in [0, {LONGEST:g}] s, got {request.duration}"
        elif request.duration == 0.0:
            self._body, self._held_until = self._body.released(), 0
            answer.message = "released"
        else:
            try:
                self._body = self._body.held(self._state)
            except ParameterError as error:
                answer.success, answer.message = False, str(error)
                return answer
            self._held_until = self.ticks + max(1, round(request.duration * self._chosen.rate))
            answer.message = f"held from tick {self.ticks} to {self._held_until}"
        return answer
