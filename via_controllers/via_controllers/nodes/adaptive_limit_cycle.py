"""Node `modal_limit_cycle`: limit cycle of an arm on one of its modes, with a model that estimators may correct.

ros2 run via_controllers modal_limit_cycle --ros-args -p arm:=reference_4dof -p adapt:=true

subscribes with `adapt`  /<arm>/payload       via_interfaces/PayloadEstimate, of node `payload`
                         /<joint>/stiffness   via_interfaces/StiffnessEstimate of each joint, of node `estimator` with
                                              devices `<arm>:<joint>`

Other topics and the lifecycle: see `controller`. /<arm>/control also reports payload, friction of links and scales of
springs in the model. The correction starts anew whenever the controller is activated. An estimate that is not OK, or
none for .1 s, takes the model back to that of the file.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from via_core.status import Status
from via_interfaces.msg import PayloadEstimate, StiffnessEstimate
from via_ros import qos

from via_controllers.arm_methods import ModalLimitCycleParameters
from via_controllers.arms.adaptive_limit_cycle import AdaptiveLimitCycle
from via_controllers.nodes.controller import ControllerNode, Input
from via_controllers.robot import ControlledArm


class AdaptiveLimitCycleNode(ControllerNode):
    """The controller node, with inputs for estimates of payload and stiffness if `adapt` is set."""

    def __init__(self, **options: Any) -> None:
        super().__init__("modal_limit_cycle", self._connected, **options)

    def _connected(self, parameters: ModalLimitCycleParameters) -> tuple[ControlledArm, tuple[Input, ...]]:
        robot = parameters.build()
        controller = robot.supervisor.controller
        if not isinstance(controller, AdaptiveLimitCycle):
            return robot, ()
        self._controller = controller
        inputs: list[Input] = [(PayloadEstimate, f"{robot.name}/payload", self._payload, qos.SAMPLES)]
        for joint, name in enumerate(robot.joints):
            inputs.append((StiffnessEstimate, f"{name}/stiffness", partial(self._stiffness, joint), qos.SAMPLES))
        return robot, tuple(inputs)

    def _payload(self, message: PayloadEstimate) -> None:
        time, status = self.time_of(message.header.stamp), Status(message.status)
        value, sd = np.full((2, 1 + self._controller.arm.n), np.nan)  # what a message lacks is not used
        value[0], sd[0] = message.value, message.standard_deviation
        if len(message.link_friction) == len(message.link_friction_standard_deviation) == len(value) - 1:
            value[1:], sd[1:] = message.link_friction, message.link_friction_standard_deviation
        self.update(lambda state: self._controller.with_payload(state, time, status, value, sd))

    def _stiffness(self, joint: int, message: StiffnessEstimate) -> None:
        time, status = self.time_of(message.header.stamp), Status(message.status)
        given = (time, status, message.value, message.standard_deviation)
        self.update(lambda state: self._controller.with_stiffness(state, joint, *given))
