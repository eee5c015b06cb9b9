"""Conversion between messages and sample rows, and between stamps and times.

Columns of a row are named as in Signals: q, q_velocity, tau_link; theta_i, theta_velocity_i, tau_i for motor i; and the
last command equilibrium, preset, damping, motor_i (zero-order hold). Joints are found by the names in the device file.
Missing values are NaN, never 0. Values keep every bit.
"""

from __future__ import annotations

import array
import re
from collections.abc import Sequence
from math import isfinite
from struct import Struct
from typing import NamedTuple, Protocol

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.wire import FIELDS, LINK, MOTOR, REFERENCES, SECOND, seconds
from via_interfaces.msg import VsaCommand

STAMP = Struct("=iI")  # builtin_interfaces/Time
MOST_NAMES = 64  # largest number of different name lists cached


def nanoseconds(stamp: Time) -> int:
    """[ns] of a stamp, exact."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_stamp(stamp: Time, time: int) -> None:
    """Write `time` [ns] into a stamp, exact; seconds are rounded down, so that nanosec is not negative."""
    stamp.sec, stamp.nanosec = divmod(time, SECOND)


class Named(Protocol):
    """A device or an arm."""

    @property
    def name(self) -> str: ...


class Command(NamedTuple):
    """The numbers of one VsaCommand."""

    mode: int
    equilibrium: float  # [rad]
    preset: float  # [rad]
    damping: float  # [-]
    motor: Array  # (m,) [rad] or [N m]; (0,) in EQUILIBRIUM_PRESET


def command_of(message: VsaCommand, n_drives: int) -> Command | None:
    """The command of a message, or None for an invalid one, see `followed`."""
    motor = np.array(message.motor, dtype=np.float64)
    return followed(Command(message.mode, message.equilibrium, message.preset, message.damping, motor), n_drives)


def followed(command: Command, n_drives: int) -> Command | None:
    """The command without the motors that its mode does not use; None for an invalid one.

    Invalid: unknown mode, a number used in this mode that is not finite, or a wrong number of motors.
    """
    mode, equilibrium, preset, damping, motor = command
    if mode == VsaCommand.EQUILIBRIUM_PRESET:
        used = [equilibrium, preset, damping]
        command = command._replace(motor=motor[:0])
    elif mode in (VsaCommand.MOTOR_POSITION, VsaCommand.MOTOR_TORQUE) and len(motor) == n_drives:
        used = [damping, *motor.tolist()]
    else:
        return None
    return command if all(map(isfinite, used)) else None


class Names:
    """Joint names in a stream of messages; hashed by identity, so that a lookup per stream suffices."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints = joints


class Joints(NamedTuple):
    """Contents of one JointState; an empty array is missing, any other length than that of the names malformed."""

    names: Names
    stamp: int  # [ns]
    stamp_bytes: bytes  # (8,) received stamp, not necessarily normalised
    position: Array
    velocity: Array
    effort: Array


class RowReader:
    """Converts JointStates and VsaCommands to sample rows of several devices at once.

    wanted     device and columns after time of each row, e.g. ('q', 'theta_1', 'tau_1', 'theta_2', 'tau_2')
    rows       (1, 1 + k) each, overwritten by every message that names the link of the device: copy to keep
    malformed  per row the number of arrays whose length differs from that of the names; their values become NaN
    """

    def __init__(self, wanted: Sequence[tuple[Device, Sequence[str]]]) -> None:
        self._links = [device.link_joint for device, _ in wanted]
        self._drives = [device.n_drives for device, _ in wanted]
        lengths = [1 + len(columns) for _, columns in wanted]
        self._starts = np.cumsum([0, *lengths]).tolist()
        self._flat = np.full(self._starts[-1], np.nan)
        self.rows = [self._flat[at : at + n].reshape(1, n) for at, n in zip(self._starts, lengths, strict=False)]
        self.malformed = [0] * len(wanted)
        self.origins: list[int | None] = [None] * len(wanted)  # [ns] stamp of the first sample
        self._places: list[list[tuple[str, int, str]]] = []  # per row: field, index in the flat array, joint
        self._commands: list[list[tuple[int, str]]] = []  # per row: index in the flat array, member of the command
        for (device, columns), start in zip(wanted, self._starts, strict=False):
            self._places.append([])
            self._commands.append([])
            for at, column in enumerate(columns, start=start + 1):
                self._place(at, column, device)
        self._plans: dict[Names, _Plan] = {}

    def _place(self, at: int, column: str, device: Device) -> None:
        drives = device.drive_joints
        numbered = re.fullmatch(r"(\w+?)_(\d+)", column)
        number = int(numbered[2]) if numbered else 0
        if column in LINK:
            self._places[-1].append((LINK[column], at, device.link_joint))
        elif column in REFERENCES:
            self._commands[-1].append((at, column))
        elif numbered and numbered[1] in (*device.drive_channels, "motor") and 1 <= number <= len(drives):
            if numbered[1] == "motor":
                self._commands[-1].append((at, column))
            else:
                self._places[-1].append((MOTOR[numbered[1]], at, drives[number - 1]))
        else:
            raise ParameterError(f"device '{device.name}' with {device.n_motors} motors has no column '{column}'")

    def forget(self, row: int) -> None:
        """Reset the row: no origin of time, no command."""
        self.origins[row] = None
        self._flat[[at for at, _ in self._commands[row]]] = np.nan

    def hold(self, row: int, message: VsaCommand) -> bool:
        """Store a command for the following rows; False for an invalid one, which is ignored."""
        command = command_of(message, self._drives[row])
        if command is None:
            return False
        for at, column in self._commands[row]:
            if column in REFERENCES:
                self._flat[at] = getattr(command, column)
            else:
                number = int(column.rpartition("_")[2])
                self._flat[at] = command.motor[number - 1] if len(command.motor) else np.nan
        return True

    def read(self, joints: Joints) -> list[int]:
        """Indices of the rows updated: those whose link the message names. Times are [s] since the first message."""
        plan = self._plans.get(joints.names)
        if plan is None:
            if len(self._plans) >= MOST_NAMES:
                self._plans.clear()
            plan = self._plans[joints.names] = self._planned(joints.names.joints)
        if not plan.rows:
            return plan.rows
        for row in plan.rows:
            origin = self.origins[row]
            if origin is None:
                origin = self.origins[row] = joints.stamp
            self._flat[self._starts[row]] = seconds(joints.stamp, origin)
        count = len(joints.names.joints)
        for field, places, indices, rows in plan.fields:
            values = getattr(joints, field)
            if len(values) == count:
                self._flat[places] = values[indices]
                continue
            self._flat[places] = np.nan
            if len(values):
                for row in rows:
                    self.malformed[row] += 1
        if len(plan.absent):
            self._flat[plan.absent] = np.nan
        return plan.rows

    def _planned(self, names: tuple[str, ...]) -> _Plan:
        first = {name: at for at, name in reversed(list(enumerate(names)))}
        rows = [row for row, link in enumerate(self._links) if link in first]
        entries = [(row, *entry) for row in rows for entry in self._places[row]]
        fields = []
        for field in FIELDS:
            there = [(row, at, first[joint]) for row, kind, at, joint in entries if kind == field and joint in first]
            if there:
                of, places, indices = zip(*there, strict=True)
                fields.append((field, np.array(places), np.array(indices), sorted(set(of))))
        absent = np.array([at for _, _, at, joint in entries if joint not in first], dtype=np.intp)
        return _Plan(rows, fields, absent)


class _Plan(NamedTuple):
    """Index tables for messages with the same joint names."""

    rows: list[int]  # rows whose link is named
    fields: list[tuple[str, np.ndarray, np.ndarray, list[int]]]  # field, indices in the flat array, in the field, rows
    absent: np.ndarray  # indices in the flat array of joints not named


def joints_of(message: JointState, last: Names) -> Joints:
    """Contents of a message; `last` are the names in the previous one, reused if equal."""
    names = tuple(message.name)
    stamp = message.header.stamp
    return Joints(
        last if names == last.joints else Names(names),
        nanoseconds(stamp),
        STAMP.pack(stamp.sec, stamp.nanosec),
        *(np.frombuffer(getattr(message, field)) for field in FIELDS),
    )


class StateWriter:
    """One reused JointState: write into the views, then publish `stamped(time)`.

    position, velocity, effort  views of the message buffers, one value per name [rad], [rad/s], [N m], initially NaN;
                                fifty times faster than assigning arrays
    """

    def __init__(self, frame: str, names: Sequence[str]) -> None:
        self._message = JointState(name=list(names))
        self._message.header.frame_id = frame
        for field in FIELDS:
            setattr(self._message, field, array.array("d", [np.nan] * len(names)))
        self.position: Array = np.frombuffer(self._message.position)
        self.velocity: Array = np.frombuffer(self._message.velocity)
        self.effort: Array = np.frombuffer(self._message.effort)

    def stamped(self, time: int) -> JointState:
        """The message with the stamp `time` [ns]."""
        set_stamp(self._message.header.stamp, time)
        return self._message


class JointStateWriter(StateWriter):
    """Writer for a device: link first, then the motors or the drive of a rigid joint, (1 + m,) each."""

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, [device.link_joint, *device.drive_joints])
