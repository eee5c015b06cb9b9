"""The recordings of one diagnosis: checked, and cut into segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.errors import SignalError

from via_gap.logs.checks import check_log
from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog, believed
from via_gap.logs.noise import LogNoise
from via_gap.logs.quality import assessed
from via_gap.residual.segments import Segments, cut_log, whole_log

FEWEST = 8  # segments: with fewer, none can be held out


@dataclass(frozen=True, eq=False)
class Recordings:
    """Logs of one device.

    first     the first log given, usable or not
    logs      usable logs to fit
    names     of all logs to fit; `holdout` of the held-out logs
    fitted    segments of the usable logs to fit; `held_out` of the held-out logs
    findings  of all data checks, refusals included
    noise     of the channels of each usable log, by its name
    unusable  why a log cannot be diagnosed and what to record instead; empty if each can
    """

    device: Device
    first: JointLog
    logs: tuple[JointLog, ...]
    names: tuple[str, ...]
    holdout: tuple[str, ...]
    fitted: tuple[Segments, ...]
    held_out: tuple[Segments, ...]
    findings: tuple[Finding, ...]
    noise: Mapping[str, LogNoise]
    unusable: str

    @staticmethod
    def of(logs: Sequence[JointLog], holdout: Sequence[JointLog] | None, device: Device) -> Recordings:
        """The checked recordings; a log that cannot be used is a finding. Raises SignalError without a log to fit."""
        if not logs:
            raise SignalError("no log to diagnose")
        every = believed([*logs, *(holdout or ())])
        findings = [each for log in every for each in check_log(log)]
        refused = {each.log for each in findings if each.severity == "refuse"}
        quality = {log.name: assessed(log) for log in every if log.name not in refused}
        findings += [found for each in quality.values() for found in each.findings]
        refused |= {name for name, each in quality.items() if each.cannot_tell}
        cut = whole_log if holdout and follows(device) else cut_log
        sides: tuple[list[Segments], list[Segments]] = ([], [])  # to fit, held out
        for number, log in enumerate(every):
            if log.name not in refused:
                try:
                    known = quality[log.name]
                    sides[number >= len(logs)].append(cut(known.log, quality=known))
                except SignalError as error:
                    findings.append(log.finding("usable", "all", "refuse", 0.0, str(error)))
        fitted, held_out = map(tuple, sides)
        if cut is cut_log and fitted and sum(int(np.sum(each.valid)) for each in (*fitted, *held_out)) < FEWEST:
            text = "too few segments to fit some and hold out others: record for longer"
            findings.append(fitted[0].log.finding("length", "time", "refuse", len(fitted[0]), text))
            fitted = ()
        usable = tuple(each.log for each in fitted)
        names = [tuple(log.name for log in side) for side in (logs, holdout or ())]
        noise = {log.name: quality[log.name].noise for log in usable}
        unusable = next((each.cannot_tell for each in quality.values() if each.cannot_tell), "")
        return Recordings(
            device, every[0], usable, names[0], names[1], fitted, held_out, tuple(findings), noise, unusable
        )

    @property
    def refused(self) -> bool:
        """Whether there is nothing to fit, or no usable held-out log although some were given."""
        return not self.fitted or bool(self.holdout and not self.held_out)


def follows(device: Device) -> bool:
    """Whether motors follow their commands, so that the simulation of a whole log does not drift."""
    return device.drive == "servo" and device.n_motors > 0
