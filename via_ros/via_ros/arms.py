"""Messages of arms: one JointState with all links and motors, joint by joint, base first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from via_core.signals import Array
from via_core.wire import FIELDS, link_name, motor_name, seconds

from via_ros.conversions import Joints, Names, StateWriter


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
    """Reads the joints of an arm from JointStates, by name.

    malformed  number of arrays so far whose length differs from that of the names
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._links = [link_name(joint) for joint in joints]
        self._motors = [motor_name(joint, 1) for joint in joints]
        self._names = Names(())
        self._places: tuple[np.ndarray, np.ndarray] | None = None
        self._origin: int | None = None
        self.malformed = 0

    def read(self, joints: Joints) -> ArmRow | None:
        """State from a message; None unless it names every link and motor of the arm."""
        if joints.names is not self._names:
            self._names, self._places = joints.names, self._found(joints.names.joints)
        if self._places is None:
            return None
        if self._origin is None:
            self._origin = joints.stamp
        links, motors = self._places
        there = []
        for field in FIELDS:
            values = getattr(joints, field)
            if len(values) != len(joints.names.joints):
                self.malformed += len(values) > 0
                values = np.full(len(joints.names.joints), np.nan)
            there.append(values)
        position, velocity, effort = there
        return ArmRow(
            seconds(joints.stamp, self._origin),
            joints.stamp,
            position[links],
            velocity[links],
            position[motors],
            velocity[motors],
            effort[links],
        )

    def _found(self, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray] | None:
        first = {name: at for at, name in reversed(list(enumerate(names)))}
        if not all(name in first for name in (*self._links, *self._motors)):
            return None
        return np.array([first[name] for name in self._links]), np.array([first[name] for name in self._motors])
