"""The only conversion between messages and sample rows, and between stamps and times.

Columns of a row are named as in Signals: q, q_velocity, tau_link; theta_i, theta_velocity_i, tau_i for motor i; and the
held commands equilibrium, preset, damping, motor_i. Joints are found by the names in the device file. What a message
does not tell is NaN, never 0. Values pass bit by bit.
"""

from __future__ import annotations

import array
import re
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.wire import FIELDS, LINK, MOTOR, REFERENCES, SECOND, seconds
from via_interfaces.msg import VsaCommand


def nanoseconds(stamp: Time) -> int:
    """[ns] of a stamp, exact."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_stamp(stamp: Time, time: int) -> None:
    """Write `time` [ns] into a stamp, exact; whole seconds round down, so that nanosec is never negative."""
    stamp.sec, stamp.nanosec = divmod(time, SECOND)


def to_nanoseconds(time: float, origin: int = 0) -> int:
    """The stamp [ns] nearest to `time` [s] after `origin` [ns]; the inverse of `seconds` for up to 20 days."""
    return origin + round(time * SECOND)


class Command(NamedTuple):
    """One VsaCommand as numbers."""

    mode: int
    equilibrium: float  # [rad]
    preset: float  # [rad]
    damping: float  # [-]
    motor: Array  # (m,) [rad] or [N m]; (0,) in EQUILIBRIUM_PRESET


def command_of(message: VsaCommand, n_motors: int) -> Command | None:
    """The command of a message, or None for one that cannot be followed.

    None: unknown mode, a number that counts in this mode but is not finite, or a wrong number of motors.
    """
    motor = np.array(message.motor, dtype=np.float64)
    if message.mode == VsaCommand.EQUILIBRIUM_PRESET:
        counting = [message.equilibrium, message.preset, message.damping]
        motor = motor[:0]
    elif message.mode in (VsaCommand.MOTOR_POSITION, VsaCommand.MOTOR_TORQUE) and len(motor) == n_motors:
        counting = [message.damping, *motor]
    else:
        return None
    if not np.all(np.isfinite(counting)):
        return None
    return Command(message.mode, message.equilibrium, message.preset, message.damping, motor)


class SampleReader:
    """Turns JointState and VsaCommand messages of one device into sample rows.

    columns  what a row holds after its time, e.g. ('q', 'theta_1', 'tau_1', 'theta_2', 'tau_2')

    origin     [ns] stamp of the first sample: rows count their time from it
    malformed  messages whose arrays do not fit their names; what does not fit is NaN in the row
    """

    def __init__(self, device: Device, columns: tuple[str, ...]) -> None:
        self.device = device
        self.columns = columns
        self.origin: int | None = None
        self.malformed = 0
        self._row = np.full(1 + len(columns), np.nan)
        self._places: dict[str, list[tuple[int, str]]] = {field: [] for field in FIELDS}  # (column, joint)
        self._held: list[tuple[int, str]] = []  # (column, member of the command)
        for at, column in enumerate(columns, start=1):
            self._place(at, column)
        self._names: list[str] | None = None
        self._found = False
        self._take: list[tuple[str, Array, Array]] = []  # (field, columns, indices in the message)

    def _place(self, at: int, column: str) -> None:
        motors = self.device.motor_joints
        numbered = re.fullmatch(r"(\w+?)_(\d+)", column)
        number = int(numbered[2]) if numbered else 0
        if column in LINK:
            self._places[LINK[column]].append((at, self.device.link_joint))
        elif column in REFERENCES:
            self._held.append((at, column))
        elif numbered and numbered[1] in (*MOTOR, "motor") and 1 <= number <= len(motors):
            if numbered[1] == "motor":
                self._held.append((at, column))
            else:
                self._places[MOTOR[numbered[1]]].append((at, motors[number - 1]))
        else:
            raise ParameterError(f"device '{self.device.name}' with {len(motors)} motors has no column '{column}'")

    def hold(self, message: VsaCommand) -> bool:
        """Keep a command for the rows to come; False for one that cannot be followed: the last one stays."""
        command = command_of(message, self.device.n_motors)
        if command is None:
            return False
        for at, column in self._held:
            if column in REFERENCES:
                self._row[at] = getattr(command, column)
            else:
                number = int(column.rpartition("_")[2])
                self._row[at] = command.motor[number - 1] if len(command.motor) else np.nan
        return True

    def read(self, message: JointState) -> Array | None:
        """The row (1 + k,) of a message, its time [s] first; None when the message is not about this device's link.

        The row is the same array every time: copy what you keep.
        """
        if message.name != self._names:
            self._look_up(list(message.name))
        if not self._found:
            return None
        row = self._row
        time = nanoseconds(message.header.stamp)
        if self.origin is None:
            self.origin = time
        row[0] = seconds(time, self.origin)
        for field, at, index in self._take:
            values = np.frombuffer(getattr(message, field))
            if len(values) == len(message.name):
                row[at] = values[index]
            else:
                row[at] = np.nan
                self.malformed += len(values) != 0
        return row

    def _look_up(self, names: list[str]) -> None:
        self._names = names
        self._found = self.device.link_joint in names
        self._take = []
        for field, places in self._places.items():
            self._row[[at for at, _ in places]] = np.nan
            there = [(at, names.index(joint)) for at, joint in places if joint in names]
            if there:
                self._take.append((field, *np.array(there).T))


class JointStateWriter:
    """One reused JointState of a device; write into the views, then publish `stamped(time)`.

    position, velocity, effort  (1 + m,) [rad], [rad/s], [N m]: link first, then the motors; NaN until written.
    Views over the message's own buffers: fifty times cheaper than assigning arrays.
    """

    def __init__(self, device: Device) -> None:
        names = [device.link_joint, *device.motor_joints]
        self._message = JointState(name=names)
        self._message.header.frame_id = device.name
        for field in FIELDS:
            setattr(self._message, field, array.array("d", [np.nan] * len(names)))
        self.position: Array = np.frombuffer(self._message.position)
        self.velocity: Array = np.frombuffer(self._message.velocity)
        self.effort: Array = np.frombuffer(self._message.effort)

    def stamped(self, time: int) -> JointState:
        """The message with the stamp `time` [ns]."""
        set_stamp(self._message.header.stamp, time)
        return self._message


class CommandWriter:
    """One reused VsaCommand of a device, numbered from 0."""

    def __init__(self, device: Device) -> None:
        self._message = VsaCommand()
        self._message.header.frame_id = device.name
        self._sequence = 0

    def numbered(self, time: int, command: Command) -> VsaCommand:
        """The message of `command` with the stamp `time` [ns] and the next number."""
        message = self._message
        set_stamp(message.header.stamp, time)
        message.sequence = self._sequence
        self._sequence += 1
        message.mode = int(command.mode)
        message.equilibrium = float(command.equilibrium)
        message.preset = float(command.preset)
        message.damping = float(command.damping)
        message.motor = array.array("d", command.motor)
        return message
