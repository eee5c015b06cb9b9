"""Node `dynamic_joint_states`: stiffness and damping of a joint as state interfaces in the terms of ros2_control.

ros2 run via_estimators dynamic_joint_states --ros-args -p device:=qbmove_a

subscribes  /<device>/stiffness    via_interfaces/StiffnessEstimate, of node `estimator`
            /<device>/damping      via_interfaces/DampingEstimate
publishes   /dynamic_joint_states  control_msgs/DynamicJointState, the joint of the link with the interfaces `stiffness`
                                   [N m/rad], `damping` [N m s/rad] and their standard deviations

One message per sample, with its stamp. A value is NaN unless its estimate of this sample has status OK.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from math import nan
from typing import Any

from rclpy.node import Node
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.parameters import parameter
from via_core.status import Status
from via_interfaces.msg import DampingEstimate, StiffnessEstimate
from via_ros import qos
from via_ros.conversions import nanoseconds
from via_ros.gate import Gate
from via_ros.parameters import declare
from via_ros.spin import run

try:
    from control_msgs.msg import DynamicJointState, InterfaceValue
except ImportError:
    DynamicJointState = None

MISSING = "control_msgs is not installed; on a stock Jazzy: sudo apt install ros-jazzy-control-msgs (there is no wheel)"
QUANTITIES = {"stiffness": StiffnessEstimate, "damping": DampingEstimate}


@dataclass(frozen=True)
class DynamicJointStatesParameters:
    device: str = parameter("cubic_demo", "device name or path to its YAML")


class DynamicJointStatesNode(Node):
    """Publishes the estimates of one device. Raises ViaError without control_msgs."""

    def __init__(self, **options: Any) -> None:
        super().__init__("dynamic_joint_states", **options)
        device = load_device(declare(self, DynamicJointStatesParameters).device)
        if DynamicJointState is None:
            raise ViaError(MISSING)
        gate = Gate(self.get_logger())
        self._joint, self._stamp, self._estimates = device.link_joint, 0, dict[str, Any]()
        self._publisher = self.create_publisher(DynamicJointState, "dynamic_joint_states", qos.SAMPLES)
        self._inputs = [
            self.create_subscription(
                kind, f"{device.name}/{name}", gate.message(partial(self._take, name)), qos.SAMPLES
            )
            for name, kind in QUANTITIES.items()
        ]

    def _take(self, name: str, message: StiffnessEstimate | DampingEstimate) -> None:
        """Publish once a sample has the estimates of all quantities that have a publisher."""
        stamp = nanoseconds(message.header.stamp)
        if stamp != self._stamp:
            self._stamp, self._estimates = stamp, {}
        self._estimates[name] = message
        if len(self._estimates) < sum(each.get_publisher_count() > 0 for each in self._inputs):
            return
        interfaces, values = list[str](), list[float]()
        for quantity in QUANTITIES:
            estimate = self._estimates.get(quantity)
            interfaces += [quantity, f"{quantity}_standard_deviation"]
            if estimate is not None and estimate.status == Status.OK:
                values += [estimate.value, estimate.standard_deviation]
            else:
                values += [nan, nan]
        made = DynamicJointState(joint_names=[self._joint])
        made.header.stamp = message.header.stamp
        made.interface_values = [InterfaceValue(interface_names=interfaces, values=values)]
        self._publisher.publish(made)


def main() -> int:
    return run(DynamicJointStatesNode)


if __name__ == "__main__":
    sys.exit(main())
