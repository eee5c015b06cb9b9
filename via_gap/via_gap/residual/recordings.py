"""The recordings of one diagnosis: checked, cut into segments, and split into those fitted and those to judge on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.errors import SignalError

from via_gap.logs.checks import check_log
from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog, believed
from via_gap.logs.noise import LogNoise, log_noise
from via_gap.logs.quality import Quality, assess
from via_gap.residual.rollout import settled
from via_gap.residual.segments import Segments, cut_log, whole_log

FEWEST = 8  # segments: with fewer there is nothing to hold out


@dataclass(frozen=True, eq=False)
class Recordings:
    """Logs of one device.

    first     the first log given, usable or not
    logs      of those to fit that can be used
    names     of all logs to fit, `holdout` of those to judge on
    fitted    segments of the logs to fit; `judged` of those to judge on
    findings  everything noticed about the data, refusals included
    noise     of the channels of each log, by its name
    unusable  why a log answers nothing and what to record instead; empty where each can answer
    """

    device: Device
    first: JointLog
    logs: tuple[JointLog, ...]
    names: tuple[str, ...]
    holdout: tuple[str, ...]
    fitted: tuple[Segments, ...]
    judged: tuple[Segments, ...]
    findings: tuple[Finding, ...]
    noise: Mapping[str, LogNoise]
    unusable: str

    @staticmethod
    def of(logs: Sequence[JointLog], holdout: Sequence[JointLog] | None, device: Device) -> Recordings:
        """Checks every log; those that cannot be used are findings."""
        every = believed([*logs, *(holdout or ())])
        findings = [finding for log in every for finding in check_log(log)]
        refused = {finding.log for finding in findings if finding.severity == "refuse"}
        quality = {log.name: assess(log, log_noise(log)) for log in every if log.name not in refused}
        findings += [finding for each in quality.values() for finding in each.findings]
        refused |= {name for name, each in quality.items() if each.cannot_tell}
        cut = whole_log if holdout and follows(device) else cut_log
        sides: list[tuple[Segments, ...]] = []
        for side in (every[: len(logs)], every[len(logs) :]):
            segments, failures = _cut([log for log in side if log.name not in refused], cut, quality)
            sides.append(tuple(segments))
            findings += failures
        fitted, judged = sides
        if cut is cut_log and fitted and sum(int(np.sum(each.valid)) for each in (*fitted, *judged)) < FEWEST:
            findings.append(_few(fitted[0]))
            fitted = ()
        usable = tuple(each.log for each in fitted)
        names = [tuple(log.name for log in side) for side in (logs, holdout or ())]
        noise = {log.name: quality[log.name].noise for log in usable}
        unusable = next((each.cannot_tell for each in quality.values() if each.cannot_tell), "")
        return Recordings(
            device, every[0], usable, names[0], names[1], fitted, judged, tuple(findings), noise, unusable
        )

    @property
    def refused(self) -> bool:
        """Whether nothing can be fitted, or nothing judged."""
        return not self.fitted or bool(self.holdout and not self.judged)


def follows(device: Device) -> bool:
    """Whether motors follow their commands, so that a joint can be simulated over a whole log."""
    return device.drive == "servo" and device.n_motors > 0


def _cut(
    logs: Sequence[JointLog], cut: Callable[..., Segments], quality: Mapping[str, Quality]
) -> tuple[list[Segments], list[Finding]]:
    segments, findings = [], []
    for log in logs:
        try:
            segments.append(settled(cut(log, quality=quality[log.name])))
        except SignalError as error:
            findings.append(
                Finding(log=log.name, check="usable", signal="all", severity="refuse", value=0.0, text=str(error))
            )
    return segments, findings


def _few(segments: Segments) -> Finding:
    return Finding(
        log=segments.log.name, check="length", signal="time", severity="refuse", value=float(len(segments)),
        text="too few stretches of data to fit on some and judge on others: record for longer",
    )  # fmt: skip
