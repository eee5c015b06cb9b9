"""The process that diagnoses: the same answer as here, an end at once when asked, a reason where there is none."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from gap_logs import flexible, log_of
from via_core.signals import Signals
from via_gap.design.proposal import with_proposal
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.logs.noise import log_noise
from via_gap.run.comparison import Comparator, compare, warm_up
from via_gap.run.fitted import fitted_device
from via_gap.run.worker import Failed, Finished, Job, Progress, Worker
from via_sim.effects import Effect

DEADLINE = 600.0  # [s]
LINK = Effect("coulomb_friction", "link", {"torque": 0.02})


@pytest.fixture
def worker():
    worker = Worker()
    yield worker
    worker.close()


def until(worker, kind):
    """Everything said up to the first of `kind`."""
    heard, deadline = [], time.monotonic() + DEADLINE
    while (said := worker.poll(max(deadline - time.monotonic(), 0.0))) is not None:
        heard.append(said)
        if isinstance(said, kind):
            return heard
    pytest.fail(f"no {kind} within {DEADLINE} s, but {heard}")


def ended(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_the_report_is_that_of_this_process_and_files_are_read_there(worker, tmp_path):
    log = log_of(flexible(), (LINK,), seed=31, duration=4.0)
    expected = with_proposal(diagnose([log], log.device), log.device).to_json()
    worker.begin(Job(log.device, log))
    heard = until(worker, (Finished, Failed))
    assert heard[-1].report == expected
    assert [each.share for each in heard[:-1]] == sorted(each.share for each in heard[:-1])
    assert {type(each) for each in heard[:-1]} == {Progress} and not worker.busy
    first = worker.pid
    worker.begin(Job(log.device, Path(tmp_path / "none.csv")))
    assert "cannot be read" in until(worker, (Finished, Failed))[-1].reason
    assert worker.pid == first


def test_own_effects_are_loaded_in_the_process(worker, tmp_path):
    own, mark = tmp_path / "own.py", tmp_path / "loaded"
    own.write_text(f"open({str(mark)!r}, 'w').close()\n1 / 0\n")
    log = log_of(flexible(), (LINK,), seed=31, duration=4.0)
    worker.begin(Job(log.device, log, own_effects=(str(own),)))
    assert "line 2: ZeroDivisionError" in until(worker, (Finished, Failed))[-1].reason and mark.exists()


def test_a_job_ends_when_told_and_the_next_one_is_done(worker):
    log = log_of(flexible(), (LINK,), seed=31, duration=4.0)
    worker.begin(Job(log.device, log))
    until(worker, Progress)
    pid = worker.pid
    worker.cancel()
    assert ended(pid) and worker.poll() is None and not worker.busy
    worker.begin(Job(log.device, log))
    until(worker, Progress)
    os.kill(worker.pid, 9)
    assert "before it was finished" in until(worker, Failed)[-1].reason


def test_a_look_tells_the_gap_and_its_place_and_the_tuned_device_has_less(worker):
    log = log_of(flexible(), (LINK,), seed=23, duration=4.0, tolerance=0.0)
    nominal = log_of(flexible(), (), seed=23, duration=4.0, tolerance=0.0)
    warm_up(log.device)
    seen, fine = compare(log, log.device), compare(nominal, log.device)
    assert seen.sites[0].site == "link" and seen.sites[0].share > 0.5
    assert seen.residual_ratio > 5.0 * fine.residual_ratio
    assert fine.residual_ratio < 1.5
    assert seen.error > 3.0 * fine.error
    off = log_of(flexible(), (), seed=23, duration=4.0)
    report = diagnose([off], off.device)
    assert report.verdict == "no_gap"
    assert compare(off, fitted_device(off.device, report)).error < 0.3 * compare(off, off.device).error


def test_a_link_that_stands_tells_nothing():
    log = log_of(flexible(), (), seed=23, duration=4.0, tolerance=0.0)
    still = {name: np.zeros_like(values) for name, values in log.measured.channels.items()}
    standing = JointLog("", log.device, Signals(log.measured.time, still, log.measured.units), log.commands)
    assert not compare(standing, log.device).moves


def test_noise_is_estimated_at_rest_and_once_in_motion(monkeypatch):
    log = log_of(flexible(), (), seed=23, duration=4.0, tolerance=0.0)
    still = {name: np.zeros_like(values) for name, values in log.measured.channels.items()}
    standing = JointLog("", log.device, Signals(log.measured.time, still, log.measured.units), log.commands)
    asked = []
    monkeypatch.setattr("via_gap.run.comparison.log_noise", lambda log: asked.append(log) or log_noise(log))
    comparator = Comparator()
    for each in (standing, standing, log, log, standing, log):
        seen = comparator.compare(each, log.device)
    assert [each is log for each in asked] == [False, True]
    assert seen == compare(log, log.device)
