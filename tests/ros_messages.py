"""Reading and writing of whole message objects, the reference for the serialised messages that the nodes use."""

import array

from sensor_msgs.msg import JointState
from via_core.devices import Device
from via_core.signals import Array
from via_interfaces.msg import VsaCommand
from via_ros.conversions import Command, Names, RowReader, joints_of, set_stamp


class SampleReader:
    """Converts JointState and VsaCommand messages of one device to sample rows: a `RowReader` of one row.

    columns  columns after time, e.g. ('q', 'theta_1', 'tau_1', 'theta_2', 'tau_2')
    """

    def __init__(self, device: Device, columns: tuple[str, ...]) -> None:
        self._reader = RowReader([(device, columns)])
        self._names = Names(())

    @property
    def malformed(self) -> int:
        """Number of arrays whose length differs from that of the names."""
        return self._reader.malformed[0]

    def hold(self, message: VsaCommand) -> bool:
        """Store a command for the following rows; False for an invalid one, which is ignored."""
        return self._reader.hold(0, message)

    def read(self, message: JointState) -> Array | None:
        """The row (1 + k,) of a message, time [s] first; None unless it names the link. The array is reused."""
        joints = joints_of(message, self._names)
        self._names = joints.names
        return self._reader.rows[0][0] if self._reader.read(joints) else None


class CommandWriter:
    """Writes the VsaCommands of a device, numbered from 0, into one reused message object."""

    def __init__(self, device: Device) -> None:
        self._message = VsaCommand()
        self._message.header.frame_id = device.name
        self._sequence = 0

    def numbered(self, time: int, command: Command) -> VsaCommand:
        """The message of `command` with stamp `time` [ns] and the next sequence number."""
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
