"""Message layout: which member holds which channel, command modes, units, and conversion of stamps to seconds.

One sensor_msgs/JointState holds link and motors of a device under the names of its device file. Live messages
(via_ros.conversions) and recorded columns (via_core.bags.joints) are read by the same tables.
"""

from __future__ import annotations

from typing import overload

import numpy as np
from numpy.typing import NDArray

from via_core.signals import Array

JOINT_STATE = "sensor_msgs/msg/JointState"
VSA_COMMAND = "via_interfaces/msg/VsaCommand"
FIELDS = ("position", "velocity", "effort")  # arrays of a JointState
LINK = {"q": "position", "q_velocity": "velocity", "tau_link": "effort"}  # channel of the link -> array
MOTOR = {"theta": "position", "theta_velocity": "velocity", "tau": "effort"}  # channel of the motors -> array
DRIVE = {"tau": "effort"}  # of the drive of a rigid joint: its own joint name, no angle
REFERENCES = ("equilibrium", "preset", "damping")  # members of a VsaCommand that are channels
EQUILIBRIUM_PRESET, MOTOR_POSITION, MOTOR_TORQUE = 0, 1, 2  # VsaCommand.mode
UNITS = {
    "q": "rad", "q_velocity": "rad/s", "tau_link": "N m", "theta": "rad", "theta_velocity": "rad/s", "tau": "N m",
    "equilibrium": "rad", "preset": "rad", "damping": "-", "external_torque": "N m", "neighbour": "rad",
}  # of all channels but `motor`, which are angles or torques by the mode  # fmt: skip
SECOND = 1_000_000_000  # [ns]


@overload
def seconds(time: int, origin: int = 0) -> float: ...
@overload
def seconds(time: NDArray[np.int64], origin: int = 0) -> Array: ...
def seconds(time: int | NDArray[np.int64], origin: int = 0) -> float | Array:
    """[s] since `origin`; both in [ns], subtracted as integers and rounded once.

    A float resolves epoch times to 240 ns only; relative to the first stamp of a stream it is exact for days.
    """
    return (time - origin) / SECOND


def link_name(device: str) -> str:
    """Default name of a device's link in a JointState."""
    return f"{device}_shaft_joint"


def motor_name(device: str, number: int) -> str:
    """Default name of motor `number`, counted from 1."""
    return f"{device}_motor_{number}_joint"


def command_name(name: str) -> str:
    """Default topic of the commands of a device or an arm, relative to the namespace of its nodes."""
    return f"{name}/command"
