"""Device pipeline: the estimator channels of one device, its pending commands and its diagnostics."""

from __future__ import annotations

from bisect import insort

from diagnostic_msgs.msg import DiagnosticStatus
from via_core.status import Status
from via_interfaces.msg import VsaCommand
from via_ros import qos
from via_ros.conversions import RowReader, command_of, nanoseconds
from via_ros.gate import SampleStream

from via_estimators.nodes.channel import EstimatorChannel

REPORT = 1.0  # [s] between two diagnostics of a device
MOST_PENDING = 2 * qos.SAMPLES.depth  # commands that wait for a sample with a later stamp
COMMANDS = {"equilibrium", "preset", "damping"}
NEVER = -(2**63)  # [ns] before every stamp


class DevicePipeline:
    """The channels of one device; `rows` are their positions in `reader`."""

    def __init__(self, channels: list[EstimatorChannel], rows: list[int], reader: RowReader) -> None:
        self.device, self.channels = channels[0].device, channels
        self.commanded = any(COMMANDS & set(channel.live.estimator.inputs) for channel in channels)
        self.pending: list[VsaCommand] = []  # in order of stamps
        self._late = self._refused = 0
        self._rows, self._reader = rows, reader
        self._newest = NEVER  # [ns] stamp of the last sample: in a bag that is played again it runs backward

    def hold(self, message: VsaCommand) -> None:
        """Queue a command for the samples that are not before it."""
        if message.mode != VsaCommand.EQUILIBRIUM_PRESET or command_of(message, self.device.n_motors) is None:
            self._refused += 1
            return
        stamp = nanoseconds(message.header.stamp)
        self._late += stamp <= self._newest
        # Ordered by stamp, so that a command with a stamp in the far future does not delay later messages.
        insort(self.pending, message, key=lambda each: nanoseconds(each.header.stamp))
        if len(self.pending) > MOST_PENDING:
            self.pending.pop()
            self._refused += 1

    def reach(self, stamp: int) -> None:
        """Apply the commands up to `stamp` [ns], that of the next sample."""
        while self.pending and nanoseconds(self.pending[0].header.stamp) <= stamp:
            message = self.pending.pop(0)
            for row in self._rows:
                self._reader.hold(row, message)
        self._newest = stamp

    def restart(self) -> int:
        """Forget samples, commands and the origin of time, for another log; returns the number of samples."""
        samples = max([channel.restart() for channel in self.channels])
        for row in self._rows:
            self._reader.forget(row)
        self.pending.clear()
        self._newest = NEVER
        return samples

    def report(self, samples: SampleStream, share: float) -> list[DiagnosticStatus]:
        """One status per channel; `share` of one core is used by the process."""
        malformed = max(map(samples.malformed, self._rows))
        found = []
        for channel, row in zip(self.channels, self._rows, strict=True):
            health = channel.live.health()
            count, cost = channel.cost()
            fault, unusable = channel.fault(), channel.status == Status.BAD_SAMPLE
            conditions = {fault: bool(fault), **samples.conditions(count == 0, row, unusable=unusable)}
            events = {
                "bad samples": health.bad, "gaps": health.gaps, "late commands": self._late,
                "refused commands": self._refused, "malformed messages": malformed,
            }  # fmt: skip
            values: dict[str, str | float] = {
                "status": health.status.name, "suspected fault": fault or "none", "rate [Hz]": count / REPORT,
                "samples": health.samples,
                "bad samples": health.bad, "gaps": health.gaps, "motion in the window [rad]": health.motion,
                "condition number": health.condition, "late commands": self._late, "refused commands": self._refused,
                "foreign messages": self._reader.foreign, "malformed messages": malformed, "time per sample [us]": cost,
                "share of a core, this method [%]": 1e-4 * cost * count / REPORT,
                "share of a core, whole process [%]": 100.0 * share,
            }  # fmt: skip
            found.append(channel.report.status(conditions, events, values, health.status.name))
        return found
