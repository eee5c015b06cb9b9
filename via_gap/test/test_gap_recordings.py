"""The recordings of one diagnosis: a refusal states the reason and the remedy; other logs are fitted or held out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of
from via_core.signals import Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.residual.recordings import FEWEST, Recordings


def log() -> JointLog:
    return log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)


def without_drive(each: JointLog) -> JointLog:
    alone = Signals(each.measured.time, {"q": each.measured["q"]}, {"q": "rad"})
    return replace(each, name="without drive", measured=alone, commands=None)


def short(each: JointLog) -> JointLog:
    return replace(each, name="short", measured=each.measured.between(0.0, 1.0))


def still(each: JointLog) -> JointLog:
    zeros = {name: np.zeros_like(values) for name, values in each.measured.channels.items()}
    return replace(each, name="still", measured=Signals(each.measured.time, zeros, each.measured.units))


@pytest.mark.parametrize(
    ("spoil", "remedy"),
    [(without_drive, "record the commands"), (short, "record for longer"), (still, "check that the joint moves")],
)
def test_what_is_refused_says_why_and_what_to_do(spoil, remedy):
    spoiled = spoil(log())
    recordings = Recordings.of([spoiled], None, spoiled.device)
    assert recordings.refused and not recordings.fitted
    refusals = [each for each in recordings.findings if each.severity == "refuse"]
    assert refusals and all(each.log == spoiled.name and each.text for each in refusals)
    report = diagnose([spoiled], spoiled.device)
    assert report.verdict == "cannot_tell" and remedy in report.reason
    assert report.gap is None and not report.effects and not report.equivalence_set


def test_one_refused_log_does_not_spoil_the_others():
    good, bad = log(), without_drive(log())
    recordings = Recordings.of([bad, good], None, good.device)
    assert not recordings.refused
    assert [each.log.name for each in recordings.fitted] == [good.name]
    assert recordings.names == (bad.name, good.name) and recordings.first.name == bad.name
    assert set(recordings.noise) == {good.name}


def test_logs_to_judge_on_that_cannot_be_used_are_no_answer():
    good, bad = log(), without_drive(log())
    recordings = Recordings.of([good], [bad], good.device)
    assert recordings.refused and recordings.fitted and not recordings.held_out
    both = Recordings.of([good], [replace(good, name="held out")], good.device)
    assert not both.refused and [each.log.name for each in both.held_out] == ["held out"]


def test_short_logs_are_pooled():
    each = log()
    parts = [replace(each, name=f"part {k}", measured=each.measured.between(1.3 * k, 1.3 * (k + 1))) for k in range(3)]
    assert Recordings.of(parts[:1], None, each.device).refused
    pooled = Recordings.of(parts, None, each.device)
    assert not pooled.refused
    assert sum(int(np.sum(segments.valid)) for segments in pooled.fitted) >= FEWEST
