"""The nominal model beside a live joint: a comparison at every tick, and diagnoses in a process of their own.

monitor = Monitor(device, MonitorParameters(), "/joint_states")
monitor.sample(stamp, row, now)         # row (c,) of monitor.columns
monitor.rolling.command(stamp, mode, equilibrium, preset, damping, motor)
monitor.request("", 10.0)               # a diagnosis of the last 10 s; monitor.request("my_bag", 0.0) of a file
for event in monitor.poll():            # progress of that diagnosis, then its report or the reason of its failure
    ...
status, text = monitor.compare(now)     # results: monitor.comparison, monitor.report
monitor.diagnose_if_due(now)            # starts a diagnosis of the whole window every now and then

Times `now` are seconds of a steady clock. A report's fitted device parameters replace those of the model. From then on
every comparison also tests whether the gap is still that of the report (`via_gap.run.change`). Automatic diagnoses
never mix motion before and after a change: the next one waits for `least` seconds of motion after it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from via_core.devices import Device, load_device
from via_core.errors import ParameterError, SignalError, ViaError
from via_core.parameters import parameter
from via_core.signals import Array
from via_core.status import Status

from via_gap.logs.log import JointLog
from via_gap.logs.rolling import RollingLog, columns_of
from via_gap.report.report import GapReport, read_report
from via_gap.run.change import Expectation
from via_gap.run.comparison import Comparator, Comparison, warm_up
from via_gap.run.fitted import fitted_device
from via_gap.run.worker import Failed, Finished, Job, Progress, Worker

STALE = 0.5  # [s] without a sample after which samples count as missing
LIVE = "live"  # name of the window in its report


@dataclass(frozen=True)
class MonitorParameters:
    """Parameters of the node `gap_monitor`."""

    device: str = parameter("cubic_demo", "device name or path to its YAML")
    joint_topic: str = parameter("joint_states", "topic of the samples")
    rate: float = parameter(10.0, "gap messages and diagnostics", "Hz", (0.1, 50.0))
    recent: float = parameter(2.0, "time compared with the model at every tick", "s", (0.5, 60.0), live=True)
    window: float = parameter(20.0, "time that is diagnosed", "s", (2.0, 600.0))
    least: float = parameter(8.0, "time that suffices for a first diagnosis", "s", (1.0, 600.0), live=True)
    own_effects: str = parameter("", "modules or files that add effects, separated by commas; their code is executed")
    every: float = parameter(20.0, "period of automatic diagnoses; 0: only on request", "s", (0.0, 86400.0), live=True)

    def described(self) -> Device:
        """The device. Raises ParameterError if there is none of this name, or its file is wrong."""
        return load_device(self.device)


class Monitor:
    """One joint's samples, the model they are compared with, and the diagnosis under way.

    joint_topic  topic of the samples, in messages and in the bags of goals

    columns     names of the channels of a sample
    model       the device, with the fitted parameters of the last report
    comparison  the latest comparison; None where there is none
    report      the latest report on the live window, `diagnosed` [ns] the stamp of its last sample
    change      [ns] stamp of the sample at which the gap was found to have changed since that report; None: it has not
    doing       stage of the diagnosis under way; '': none
    trouble     why the last automatic diagnosis failed
    samples     number of samples so far, `foreign` of messages about other devices
    """

    def __init__(self, device: Device, parameters: MonitorParameters, joint_topic: str) -> None:
        self.changed(parameters)()
        self._joint_topic = joint_topic
        warm_up(device)
        self.device = self.model = device
        self.columns = columns_of(device)
        self.rolling = RollingLog(device, parameters.window)
        self.worker = Worker(filter(None, parameters.own_effects.split(",")))
        self.comparison: Comparison | None = None
        self.report: GapReport | None = None
        self.diagnosed = 0
        self.change: int | None = None
        self.doing = self.trouble = ""
        self.samples = self.foreign = 0
        self._comparator = Comparator()
        self._requested = self._from_file = False  # whether the diagnosis under way was requested, of a file
        self._log: JointLog | None = None  # of the diagnosis under way
        self._stamp = 0  # [ns] of its last sample
        self._expected: Expectation | None = None  # levels of the residual in the motion of the report
        self._restarts = self._compared = 0  # restarts of the clock handled, samples at the last comparison
        self._received = self._due = float("-inf")  # [s] last sample, next automatic diagnosis

    def changed(self, parameters: MonitorParameters) -> Callable[[], None]:
        """Returns what puts these parameters into effect. Raises ParameterError if `recent` exceeds the window."""
        if parameters.recent > parameters.window:
            raise ParameterError(
                f"parameter recent must lie in [0.5, {parameters.window:g}] s, got {parameters.recent:g}"
            )

        def put_into_effect() -> None:
            self._parameters = parameters

        return put_into_effect

    def sample(self, stamp: int, row: Array, now: float) -> None:
        """Take a sample (c,) with its stamp [ns], received at `now` [s]."""
        self.rolling.sample(stamp, row)
        self._received = now
        self.samples += 1

    def request(self, path: str, seconds: float) -> None:
        """Start a diagnosis of a recording, or of the last `seconds` [s] of the window (0: all of it).

        It ends an automatic diagnosis. Raises ViaError where there is nothing to diagnose.
        """
        job = Job(self.device, self._source(path, seconds), self._joint_topic)
        if self.worker.busy:
            self.worker.cancel()
        self._requested, self._from_file, self.doing = True, bool(path), "starting"
        self.worker.begin(job)

    def cancel(self) -> None:
        """End the diagnosis under way."""
        self.worker.cancel()
        self._requested, self._from_file, self.doing = False, False, ""

    def poll(self) -> Iterator[Progress | Failed | GapReport]:
        """What a requested diagnosis has sent since the last call; results of automatic ones are kept here."""
        if self.rolling.restarts != self._restarts:
            self._restart()
        while (event := self.worker.poll()) is not None:
            requested = self._requested
            if isinstance(event, Progress):
                self.doing = event.doing
                result: Progress | Failed | GapReport = event
            else:
                result = self._finish(event)
            if requested:
                yield result

    def compare(self, now: float) -> tuple[Status, str]:
        """Compare the most recent samples with the model: whether that was possible, and a sentence about it."""
        topic, recent = self._joint_topic, self._parameters.recent
        if self.rolling.newest is None:
            others = " of this device, others only" if self.foreign else ""
            return Status.WARMING_UP, f"no samples{others} yet on {topic}"
        if self._stale(now):
            return Status.BAD_SAMPLE, f"no samples for {now - self._received:.1f} s on {topic}"
        if self.rolling.duration < recent:
            why = "the clock ran back, the window restarted" if self.rolling.restarts else "warming up"
            return Status.WARMING_UP, f"{why}: {self.rolling.duration:.1f} of {recent:g} s"
        if self.samples != self._compared:
            self._compared = self.samples
            try:
                log = self.rolling.log(LIVE, recent)
                assert log is not None
                known = () if self.report is None else self.report.repair()
                self.comparison = self._comparator.compare(log, self.model, known)
            except ViaError as error:
                self.comparison = None
                return Status.BAD_SAMPLE, str(error)
            self._look_for_change(self.comparison)
        if self.comparison is None:
            return Status.BAD_SAMPLE, self.trouble or "no comparison was possible"
        if not self.comparison.moves:
            return Status.NOT_EXCITED, "the link does not move"
        return Status.OK, self._words(self.comparison)

    def _words(self, found: Comparison) -> str:
        """A comparison in one sentence."""
        text = f"the residual of the equations is {found.residual_ratio:.3g} times the noise"
        if np.isnan(found.residual_ratio):
            text = f"these signals allow no equation; the simulated link is off by {found.error:.2g} rad"
        elif found.sites:
            text += f", most of it at the {found.sites[0].site}"
        if self.change is not None:
            text = f"the gap has changed since the last diagnosis, {self.rolling.age(self.change):.0f} s ago: {text}"
        return text

    def _look_for_change(self, found: Comparison) -> None:
        """Note a change of the gap; a diagnosis of motion before and after it would mix two joints."""
        if self.change is not None or self._expected is None or not found.moves:
            return
        if self._expected.exceeded(np.array(found.levels), 1.0 / self._parameters.rate):
            self.change, self._due = self.rolling.newest, float("-inf")
            if self.worker.busy and not self._requested:
                self.cancel()

    def diagnose_if_due(self, now: float) -> None:
        """Start an automatic diagnosis of the whole window, if it is time for one and the joint moves."""
        own = self._parameters
        moves = self.comparison is not None and self.comparison.moves and not self._stale(now)
        enough = self._unchanged >= min(own.least, own.window)
        if own.every == 0.0 or self.worker.busy or now < self._due or not (moves and enough):
            return
        self._due = now + own.every
        try:
            log = self._window(self._unchanged)
        except ViaError as error:
            self.trouble = str(error)
            return
        self.doing, self.trouble = "starting", ""
        self.worker.begin(Job(self.device, log))

    @property
    def _unchanged(self) -> float:
        """[s] of the window after the last change of the gap."""
        duration = self.rolling.duration
        return duration if self.change is None else min(duration, self.rolling.age(self.change))

    def _stale(self, now: float) -> bool:
        return now - self._received > STALE

    def _source(self, path: str, seconds: float) -> JointLog | Path:
        if path:
            if seconds != 0.0:
                raise ParameterError(f"seconds must be 0 with a path, got {seconds:g}")
            return Path(path)
        if not 0.0 <= seconds <= self._parameters.window:
            raise ParameterError(f"seconds must lie in [0, {self._parameters.window:g}], got {seconds:g}")
        return self._window(seconds or None)

    def _window(self, seconds: float | None = None) -> JointLog:
        log = self.rolling.log(LIVE, seconds)
        if log is None:
            raise SignalError(f"no samples of '{self.device.name}' yet on {self._joint_topic}")
        self._log, self._stamp = log, self.rolling.newest or 0
        return log

    def _finish(self, event: Finished | Failed) -> Failed | GapReport:
        requested, of_file = self._requested, self._from_file
        self._requested, self._from_file, self.doing = False, False, ""
        if isinstance(event, Failed):
            if not requested:
                self.trouble = event.reason
            return event
        report = read_report(event.report, "diagnosis")
        if not of_file:
            self.report, self.diagnosed = report, self._stamp
            self.model = fitted_device(self.device, report)
            self._expect(report)
        return report

    def _expect(self, report: GapReport) -> None:
        """Learn what the model of the report leaves of the motion that was diagnosed."""
        assert self._log is not None
        begin = self.rolling.age(self._stamp) + self._log.duration  # [s ago]
        if self.change is not None and self.rolling.age(self.change) < begin:
            return  # a requested diagnosis that includes motion before the change
        try:
            levels = self._comparator.compare(self._log, self.model, report.repair()).levels
        except ViaError:
            levels = ()
        self.change, self._expected = None, Expectation.of(np.array(levels))

    def _restart(self) -> None:
        """The clock ran backward: earlier results belong to another run."""
        self._restarts = self.rolling.restarts
        self.report, self.model, self.comparison, self._due = None, self.device, None, float("-inf")
        self._comparator, self.change, self._expected = Comparator(), None, None
        if self.worker.busy and not self._requested:
            self.cancel()
