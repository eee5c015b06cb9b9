"""A log of one joint: measured and commanded signals, and which parts of the model they allow to evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from via_core.bags.joints import JointRecording, joint_signals
from via_core.bags.reader import Bag, read_bag
from via_core.devices import Device
from via_core.encoder_steps import step_of
from via_core.errors import SignalError, ViaError
from via_core.recordings.channels import read_joint
from via_core.recordings.tables import is_bag
from via_core.signals import Array, Signals

from via_gap.logs.breaks import without_breaks
from via_gap.logs.findings import Finding, Severity

Level = Literal["full", "no torque", "link only", "commands only", "encoder and command"]
LINK_SUFFIX = "_shaft_joint"  # of link names, which motor names do not have
ERRATIC = 0.002  # share of jumping samples beyond which an encoder is not used
FAR = 8.0  # times the 90 % quantile of the steps between samples: a jump


@dataclass(frozen=True, eq=False)
class JointLog:
    """Recording of one joint."""

    name: str  # file or run
    device: Device  # the nominal one
    # q (N,) [rad], optional theta (N, m), tau (N, m), q_velocity, theta_velocity; NaN: not measured
    measured: Signals
    # Zero-order hold: motor (N, m), or equilibrium and preset [rad]; damping [-]; external_torque [N m];
    # neighbour [rad], the angle of another joint that acts through coupling. None: not recorded
    commands: Signals | None
    dropped: tuple[int, int] = (0, 0)  # number of samples left out: repeated stamps, stamps that ran backward
    passed: Mapping[str, int] = field(default_factory=dict)  # by channel: ends of turns that were made continuous
    hint: str = ""  # columns that may hold the commands of a log without, see `StampReport.hint`
    breaks: tuple[tuple[float, float], ...] = ()  # [s] begin and length of breaks that were made short
    restamped: float = 0.0  # [s] root mean square change of stamps that an even clock replaced
    disbelieved: tuple[int, ...] = ()  # motors whose encoder jumps: their angles count as not measured
    # [s] delay of commands (or torques in their place) that are interpolated linearly between samples;
    # None: zero-order hold (`via_gap.logs.between`)
    lined: float | None = None

    @staticmethod
    def of(name: str, device: Device, recording: JointRecording) -> JointLog:
        """The log of messages."""
        measured, commands, reports = recording
        measured, commands, breaks = without_breaks(measured, commands)
        dropped = (sum(report.repeated for report in reports), sum(report.backward for report in reports))
        passed = {channel: count for report in reports for channel, count in report.passed.items()}
        return JointLog(name, device, measured, commands, dropped, passed, reports[0].hint, breaks)

    def __post_init__(self) -> None:
        if len(self.measured) < 2:
            raise SignalError(f"{self.name}: has {len(self.measured)} samples, at least 2 are needed")
        if "q" not in self.measured or not np.isfinite(self.measured["q"]).any():
            raise SignalError(f"{self.name}: the link angle of '{self.device.name}' was not recorded")

    def finding(self, check: str, signal: str, severity: Severity, value: float, text: str) -> Finding:
        """A result of the data check on this log."""
        return Finding(log=self.name, check=check, signal=signal, severity=severity, value=float(value), text=text)

    @property
    def duration(self) -> float:
        """[s] from first to last sample."""
        return float(self.measured.time[-1] - self.measured.time[0])

    @cached_property
    def motors_seen(self) -> tuple[bool, ...]:
        """Per motor: whether its angle was measured in 90 % of the samples or more, without jumps of the encoder."""
        if "theta" not in self.measured:
            return (False,) * self.device.n_motors
        shares = np.mean(np.isfinite(self.measured["theta"]), axis=0)
        return tuple(bool(share >= 0.9) and i not in self.disbelieved for i, share in enumerate(shares, 1))

    @property
    def angles(self) -> list[tuple[str, Array, float | None]]:
        """Name, measurements (N,) and filed encoder step [rad] of the link's angle and of each measured motor angle."""
        sensors = self.device.sensors
        motors = self.measured["theta"].T if "theta" in self.measured else ()
        found = [(f"theta_{i}", column, sensors.motor_quantum) for i, column in enumerate(motors, 1)]
        measured = [each for each in found if np.isfinite(each[1]).sum() >= 2]
        return [("q", self.measured["q"], sensors.link_quantum), *measured]

    def motor_commands(self, late: float) -> Array | None:
        """Motor commands (N, m) that act on the samples, if these follow `late` samples after them."""
        if self.commands is None or "motor" not in self.commands:
            return None
        period = float(np.median(np.diff(self.measured.time)))
        return self.commands.select(["motor"]).resample(self.measured.time - (late + 0.5) * period)["motor"]

    @property
    def torque_seen(self) -> bool:
        """Whether motor torques were measured in at least 90 % of the samples."""
        return "tau" in self.measured and bool(np.mean(np.isfinite(self.measured["tau"])) >= 0.9)

    @property
    def command_measured(self) -> bool:
        """Whether the command of a rigid joint is a measured torque, which contains noise."""
        entry = self.device.wire.columns.get("external_torque")
        return not self.device.n_motors and "tau" not in self.measured and entry is not None and entry.measured

    @cached_property
    def torque(self) -> Array | None:
        """(N, m) [N m] of the drives at the samples: measured, or for a rigid joint as commanded; None: neither."""
        if "tau" in self.measured:
            return self.measured["tau"]
        if self.device.n_motors or self.device.drive != "torque":
            return None
        if self.commands is None or "external_torque" not in self.commands:
            return None
        return self.commands.resample(self.measured.time)["external_torque"][:, None]

    @property
    def motors_commanded(self) -> bool:
        """Whether commands of the motors were recorded."""
        names = {"equilibrium"} if self.device.drive in ("servo", "position") else set()
        return self.commands is not None and bool(self.commands.channels.keys() & ({"motor"} | names))

    @property
    def level(self) -> Level:
        """Signal set, which determines the parts of the model that can be evaluated."""
        seen = self.motors_seen
        if self.device.drive == "position":
            return "full" if self.torque_seen else "encoder and command"
        if self.device.drive == "servo" or not seen:
            return "full" if all(seen) else "commands only"
        if all(seen):
            return "full" if self.torque_seen else "no torque"
        return "link only"

    @property
    def drivable(self) -> bool:
        """Whether the log contains what drives a simulation."""
        if self.motors_commanded or self.device.drive == "position":
            return self.motors_commanded
        return self.device.n_motors == 0 or (self.device.drive == "torque" and self.torque_seen)


def believed(logs: Sequence[JointLog]) -> list[JointLog]:
    """The logs without the motor angles whose encoder jumps in any of them, because all logs have the same encoder."""
    columns = [each for log in logs if "theta" in log.measured for each in enumerate(log.measured["theta"].T, 1)]
    jumpy = {number for number, column in columns if jumps(column) > ERRATIC}
    return [replace(log, disbelieved=tuple(sorted(jumpy))) for log in logs] if jumpy else list(logs)


def jumps(values: Array) -> float:
    """Share of single samples that jump away from their neighbours and back."""
    there = values[np.isfinite(values)]
    if there.size < 3:
        return 0.0
    steps = np.diff(there)
    apart = np.abs(steps) > FAR * (np.quantile(np.abs(steps), 0.9) + 1e-12)
    away = apart[1:] & apart[:-1] & (np.sign(steps[1:]) != np.sign(steps[:-1]))
    return float(np.sum(away) / there.size)


def read_log(path: str | Path, device: Device, joint_topic: str = "/joint_states") -> JointLog:
    """The log in a bag or in a file of any format of `via_core.recordings`. Raises ViaError if it cannot be read.

    A bag is read by the names of the joints, unless the device file assigns columns of topics under `wire.columns`.
    """
    where = Path(path)
    if not is_bag(where) or device.wire.topics_of_columns:
        return JointLog.of(where.name, device, read_joint(where, device))
    bag = read_bag(where)
    log = JointLog.of(where.name, device, joint_signals(bag, device, joint_topic))
    if log.commands is None:
        return log
    return replace(log, commands=_with_neighbour(log.commands, bag, device, joint_topic))


def _with_neighbour(commands: Signals, bag: Bag, device: Device, joint_topic: str) -> Signals:
    """The commands with the angle [rad] of the neighbour as channel `neighbour`; unchanged if there is none.

    The neighbour is the only other link in the joint states; with several others it is not known.
    """
    names = {name for names in bag[joint_topic]["name"].tolist() for name in names}
    own = {device.link_joint, *device.drive_joints}
    others = [name for name in names - own if name.endswith(LINK_SUFFIX)]
    if len(others) != 1:
        return commands
    wire = device.wire.model_copy(update={"link": others[0]})
    try:
        other, _, _ = joint_signals(bag, device.model_copy(update={"wire": wire}), joint_topic)
    except ViaError:
        return commands
    seen = np.isfinite(other["q"]) if "q" in other else np.zeros(0, dtype=np.bool_)
    if seen.sum() < 2:
        return commands
    angle = np.interp(commands.time, other.time[seen], other["q"][seen])
    return commands.joined(Signals(commands.time, {"neighbour": angle}, {"neighbour": "rad"}, frozenset({"neighbour"})))


def angle_of(log: JointLog, axis: int) -> Array:
    """(N,) [rad] as measured at an axis: 0 link, 1, 2 motors."""
    return log.measured["q"] if axis == 0 else log.measured["theta"][:, axis - 1]


def quantum(log: JointLog, axis: int) -> float:
    """[rad] step of an encoder: of the device file, or of the grid of its measurements if that is coarser."""
    sensors = log.device.sensors
    return max((sensors.motor_quantum if axis else sensors.link_quantum) or 0.0, step_of(angle_of(log, axis)))


def read_logs(paths: Sequence[str | Path], device: Device) -> list[JointLog]:
    """The logs of several files; for files of the same name, the log names include folders until they differ."""
    parts = [Path(path).absolute().parts for path in paths]
    depth = 1
    while len({each[-depth:] for each in parts}) < len(set(parts)):
        depth += 1
    last = [each[-1] for each in parts]
    names = [str(Path(*each[-depth:])) if last.count(each[-1]) > 1 else each[-1] for each in parts]
    return [replace(read_log(path, device), name=name) for path, name in zip(paths, names, strict=True)]
