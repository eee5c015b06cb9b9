"""A device in a node: the methods that run on it, the commands that wait for their samples, and what went wrong."""

from __future__ import annotations

from bisect import insort

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from via_interfaces.msg import VsaCommand
from via_ros import qos
from via_ros.conversions import RowReader, command_of, nanoseconds

from via_estimators.nodes.line import Line

REPORT = 1.0  # [s] between two diagnostics of a device
MOST_PENDING = 2 * qos.SAMPLES.depth  # commands that wait for a sample as late as they are
COMMANDS = {"equilibrium", "preset", "damping"}
NEVER = -(2**63)  # [ns] before every stamp


class Station:
    """The lines of one device; `rows` are theirs in `reader`."""

    def __init__(self, lines: list[Line], rows: list[int], reader: RowReader) -> None:
        self.device, self.lines = lines[0].device, lines
        self.commanded = any(COMMANDS & set(line.live.estimator.inputs) for line in lines)
        self.pending: list[VsaCommand] = []  # by stamp
        self._late = self._refused = 0
        self._rows, self._reader = rows, reader
        self._newest = NEVER  # [ns] latest stamp taken

    def hold(self, message: VsaCommand) -> None:
        """Keep a command for the samples that are not before it."""
        if message.mode != VsaCommand.EQUILIBRIUM_PRESET or command_of(message, self.device.n_motors) is None:
            self._refused += 1
            return
        stamp = nanoseconds(message.header.stamp)
        self._late += stamp <= self._newest
        # By stamp, so that one from a far future does not hold back those that come after it.
        insort(self.pending, message, key=lambda each: nanoseconds(each.header.stamp))
        if len(self.pending) > MOST_PENDING:
            self.pending.pop()
            self._refused += 1

    def reach(self, stamp: int) -> None:
        """The next sample is stamped so [ns]: commands up to there hold in it."""
        while self.pending and nanoseconds(self.pending[0].header.stamp) <= stamp:
            message = self.pending.pop(0)
            for row in self._rows:
                self._reader.hold(row, message)
        self._newest = max(self._newest, stamp)

    def restart(self) -> int:
        """Forget samples, commands and the origin of time: what comes next may be another log. Returns the samples."""
        samples = max([line.restart() for line in self.lines])
        for row in self._rows:
            self._reader.forget(row)
        self.pending.clear()
        self._newest = NEVER
        return samples

    def report(self, node: str, foreign: int, broken: int, share: float) -> list[DiagnosticStatus]:
        """One status per line.

        foreign  messages that named no device of the node
        broken   messages that were none
        share    of one core that the process used
        """
        malformed = broken + max(self._reader.malformed[row] for row in self._rows)
        found = []
        for line in self.lines:
            health = line.live.health()
            count, cost = line.cost()
            troubles = {
                "no samples": count == 0,
                "joints of other devices only": foreign > 0 and line.sequence == 0,
                "bad samples": health.bad > 0,
                "gaps": health.gaps > 0,
                "late commands": self._late > 0,
                "refused commands": self._refused > 0,
                "malformed messages": malformed > 0,
            }
            told = [text for text, holds in troubles.items() if holds]
            values: dict[str, str | float] = {
                "status": health.status.name, "rate [Hz]": count / REPORT, "samples": health.samples,
                "bad samples": health.bad, "gaps": health.gaps, "motion in the window [rad]": health.motion,
                "condition number": health.condition, "late commands": self._late, "refused commands": self._refused,
                "foreign messages": foreign, "malformed messages": malformed, "time per sample [us]": cost,
                "share of a core, this method [%]": 1e-4 * cost * count / REPORT,
                "share of a core, whole process [%]": 100.0 * share,
            }  # fmt: skip
            found.append(
                DiagnosticStatus(
                    level=DiagnosticStatus.WARN if told else DiagnosticStatus.OK,
                    name=f"{node}: {self.device.name} {line.method}",
                    message=", ".join(told) or health.status.name,
                    hardware_id=self.device.name,
                    values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
                )
            )
        return found


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"
