"""Messages of arms: one JointState with all links and motors, joint by joint, base first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from via_core.signals import Array
from via_core.wire import link_name, motor_name

from via_ros.conversions import JointReader, Joints, StateWriter


class ArmRow(NamedTuple):
    """State of an arm of n joints from one JointState; NaN where missing. Arrays (n,) are copies."""

    time: float  # [s] since the first one
    stamp: int  # [ns]
    q: Array  # [rad]
    q_velocity: Array  # [rad/s]
    theta: Array  # [rad]
    theta_velocity: Array  # [rad/s]
    spring_torque: Array  # [N m]


class ArmStateWriter(StateWriter):
    """Writer for an arm: `links` and `motors` select (n,) entries each, e.g. `position[links]`."""

    links = slice(0, None, 2)
    motors = slice(1, None, 2)

    def __init__(self, name: str, joints: Sequence[str]) -> None:
        super().__init__(name, [each for joint in joints for each in (link_name(joint), motor_name(joint, 1))])


class ArmReader:
    """Reads the joints of an arm from JointStates, by name."""

    def __init__(self, joints: Sequence[str]) -> None:
        links, motors = [link_name(joint) for joint in joints], [motor_name(joint, 1) for joint in joints]
        entries = [(field, link) for field in ("position", "velocity") for link in links]
        entries += [(field, motor) for field in ("position", "velocity") for motor in motors]
        entries += [("effort", link) for link in links]
        self._reader = JointReader([((*links, *motors), entries)])

    @property
    def malformed(self) -> int:
        """Number of arrays so far whose length differs from that of the names."""
        return self._reader.malformed[0]

    def read(self, joints: Joints) -> ArmRow | None:
        """State from a message; None unless it names every link and motor of the arm."""
        if not self._reader.read(joints):
            return None
        (row,) = self._reader.rows
        return ArmRow(float(row[0]), joints.stamp, *row[1:].reshape(5, -1).copy())
