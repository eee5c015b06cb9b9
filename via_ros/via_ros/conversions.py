"""Conversion between messages and sample rows, and between stamps and times.

Columns of a row are named as in Signals: q, q_velocity, tau_link; theta_i, theta_velocity_i, tau_i for motor i; and the
last command equilibrium, preset, damping, motor_i (zero-order hold). Joints are found by the names in the device file.
Missing values are NaN, never 0. Values keep every bit.
"""

from __future__ import annotations

import array
from collections.abc import Iterable, Sequence
from math import isfinite, isnan
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.text_files import shown
from via_core.wire import FIELDS, LINK, MOTOR, REFERENCES, SECOND, link_name, motor_name, seconds
from via_interfaces.msg import VsaCommand

from via_ros.interfaces import STAMP

MOST_NAMES = 64  # largest number of different name lists cached
MOST_SHOWN = 20  # joints in a warning


def nanoseconds(stamp: Time) -> int:
    """[ns] of a stamp, exact."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_stamp(stamp: Time, time: int) -> None:
    """Write `time` [ns] into a stamp, exact; seconds are rounded down, so that nanosec is not negative."""
    stamp.sec, stamp.nanosec = divmod(time, SECOND)


class Command(NamedTuple):
    """The numbers of one VsaCommand."""

    mode: int
    equilibrium: float  # [rad]
    preset: float  # [rad]
    damping: float  # [-]
    motor: Array  # (m,) [rad] or [N m]; (0,) in EQUILIBRIUM_PRESET


def unchecked_command(message: VsaCommand) -> Command:
    """The command of a message, not validated."""
    motor = np.array(message.motor, dtype=np.float64)
    return Command(message.mode, message.equilibrium, message.preset, message.damping, motor)


def command_of(message: VsaCommand, n_drives: int) -> Command | None:
    """The command of a message, or None for an invalid one, see `followed`."""
    return followed(unchecked_command(message), n_drives)


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


class JointReader:
    """Copies numbers of named joints from JointStates into rows.

    wanted     per row the joints that a message must name, and the (field, joint) of each number; None: set elsewhere
    rows       (1, 1 + k) each, time [s] since the first message and the numbers, NaN where missing; overwritten by
               every message that names the wanted joints: copy to keep
    malformed  per row the number of arrays whose length differs from that of the names; their values become NaN
    origins    [ns] per row the stamp of the first message
    foreign    number of messages that updated no row
    """

    def __init__(self, wanted: Sequence[tuple[Sequence[str], Sequence[tuple[str, str] | None]]]) -> None:
        self._wanted = wanted
        self._starts = np.cumsum([0, *(1 + len(entries) for _, entries in wanted)]).tolist()
        self._flat = np.full(self._starts[-1], np.nan)
        self.rows = np.split(self._flat[None], self._starts[1:-1], axis=1)
        self.malformed = [0] * len(wanted)
        self.origins: list[int | None] = [None] * len(wanted)
        self.foreign = 0
        self._latest_foreign = Names(())
        self._plans: dict[Names, _Plan] = {}

    def read(self, joints: Joints) -> list[int]:
        """Indices of the rows updated: those whose wanted joints the message names."""
        plan = self._plans.get(joints.names)
        if plan is None:
            if len(self._plans) >= MOST_NAMES:
                self._plans.clear()
            plan = self._plans[joints.names] = self._planned(joints.names.joints)
        if not plan.rows:
            self.foreign += 1
            self._latest_foreign = joints.names
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

    def absent(self) -> str:
        """What the last message that updated no row lacks, beside what it has; '' without such a message."""
        if not self.foreign:
            return ""
        there = self._latest_foreign.joints
        lacks = dict.fromkeys(joint for needed, _ in self._wanted for joint in needed if joint not in there)
        return shown(f"no {_listed(lacks)} in {_listed(there) or 'a message without joints'}")

    def missing(self, row: int, required: int | None = None) -> str:
        """The values that the last message of a row lacks among the first `required` ones, '' if it has them."""
        if self.origins[row] is None:
            return ""
        pairs = list(zip(self._wanted[row][1], self.rows[row][0, 1:], strict=True))[:required]
        lacks = [entry for entry, value in pairs if entry and isnan(value)]
        return shown(_listed([f"{field} of {joint}" for field, joint in lacks]))

    def _planned(self, names: tuple[str, ...]) -> _Plan:
        first = {name: at for at, name in reversed(list(enumerate(names)))}
        rows = [row for row, (needed, _) in enumerate(self._wanted) if first.keys() >= set(needed)]
        entries = [
            (row, at, *entry)
            for row in rows
            for at, entry in enumerate(self._wanted[row][1], self._starts[row] + 1)
            if entry is not None
        ]
        fields = []
        for field in FIELDS:
            there = [(row, at, first[joint]) for row, at, kind, joint in entries if kind == field and joint in first]
            if there:
                of, places, indices = zip(*there, strict=True)
                fields.append((field, np.array(places), np.array(indices), sorted(set(of))))
        absent = np.array([at for _, at, _, joint in entries if joint not in first], dtype=np.intp)
        return _Plan(rows, fields, absent)


def _listed(names: Iterable[str]) -> str:
    """The first MOST_SHOWN names."""
    names = list(names)
    return ", ".join([*names[:MOST_SHOWN], *(["..."] if len(names) > MOST_SHOWN else [])])


class _Plan(NamedTuple):
    """Index tables for messages with the same joint names."""

    rows: list[int]  # rows whose wanted joints are named
    fields: list[tuple[str, np.ndarray, np.ndarray, list[int]]]  # field, indices in the flat array, in the field, rows
    absent: np.ndarray  # indices in the flat array of joints not named


class RowReader(JointReader):
    """A reader for the links of devices that also holds their commands.

    wanted  device and columns after time of each row, e.g. ('q', 'theta_1', 'tau_1', 'theta_2', 'tau_2')
    """

    def __init__(self, wanted: Sequence[tuple[Device, Sequence[str]]]) -> None:
        super().__init__(
            [((device.link_joint,), [_place(device, each) for each in columns]) for device, columns in wanted]
        )
        self._drives = [device.n_drives for device, _ in wanted]
        self._commands = [
            [(at, each) for at, each in enumerate(columns, 1) if each in REFERENCES or each.startswith("motor_")]
            for _, columns in wanted
        ]

    def forget(self, row: int) -> None:
        """Reset the row: no origin of time, no command."""
        self.origins[row] = None
        self.rows[row][0, [at for at, _ in self._commands[row]]] = np.nan

    def hold(self, row: int, message: VsaCommand) -> bool:
        """Store a command for the following rows; False for an invalid one, which is ignored."""
        command = command_of(message, self._drives[row])
        if command is None:
            return False
        motors = {f"motor_{i}": value for i, value in enumerate(command.motor, 1)}
        for at, column in self._commands[row]:
            self.rows[row][0, at] = getattr(command, column) if column in REFERENCES else motors.get(column, np.nan)
        return True


def _place(device: Device, column: str) -> tuple[str, str] | None:
    """Field and joint of a column; None for one of the command. Raises ParameterError where there is no such column."""
    if column in LINK:
        return LINK[column], device.link_joint
    if column in REFERENCES:
        return None
    channel, _, number = column.rpartition("_")
    for i, joint in enumerate(device.drive_joints, 1):
        if number == str(i) and channel in (*device.drive_channels, "motor"):
            return (MOTOR[channel], joint) if channel != "motor" else None
    raise ParameterError(f"device '{device.name}' with {device.n_motors} motors has no column '{column}'")


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


def efforts_of(message: JointState, joints: Sequence[str]) -> Array:
    """Efforts (n,) of the named joints in a command, in the order of `joints`; NaN where there is none.

    The topic hardware interface of ros2_control names all its joints, but lists efforts only of those with an effort
    command: as many efforts as `joints` therefore belong to these, in the order of their names.
    """
    names, effort = list(message.name), message.effort
    if len(effort) == len(joints) < len(names):
        names = [each for each in names if each in joints]
    given = dict(zip(names, effort, strict=True)) if len(effort) == len(names) else {}
    return np.array([given.get(each, np.nan) for each in joints])


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

    @property
    def names(self) -> list[str]:
        """Names of the joints."""
        return list(self._message.name)

    def stamped(self, time: int) -> JointState:
        """The message with the stamp `time` [ns]."""
        set_stamp(self._message.header.stamp, time)
        return self._message


class JointStateWriter(StateWriter):
    """Writer for a device: link first, then the motors or the drive of a rigid joint, (1 + m,) each."""

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, [device.link_joint, *device.drive_joints])


class ArmStateWriter(StateWriter):
    """Writer for an arm: `links` and `motors` select (n,) entries each, e.g. `position[links]`."""

    links = slice(0, None, 2)
    motors = slice(1, None, 2)

    def __init__(self, name: str, joints: Sequence[str]) -> None:
        super().__init__(name, [each for joint in joints for each in (link_name(joint), motor_name(joint, 1))])
