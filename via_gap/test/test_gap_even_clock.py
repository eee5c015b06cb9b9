"""Times of samples: which share of uneven stamps a motion shows, and stamps that are corrected by it."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import log_of, rigid
from via_core.signals import Signals
from via_gap.logs.even_clock import even_times, evened, share_in
from via_gap.logs.log import JointLog
from via_gap.logs.quality import assessed
from via_gap.report.report import LogInterval
from via_gap.report.withheld import compared_segments
from via_gap.residual.recordings import Recordings

PERIOD = 0.004  # [s]
NOISE = 2e-5  # [rad]


def recorded(late, wrong, seed=1, count=5000, lost=0.0, drift=0.0, speed=1.0):
    """(times, log): samples uneven by `late` [s] with stamps wrong by another `wrong` [s]; standard deviations."""
    random = np.random.default_rng(seed)
    kept = np.sort(random.choice(count, round(count * (1.0 - lost)), replace=False))
    clock = PERIOD * kept + drift * np.sin(0.3 * PERIOD * kept)
    times = clock + late * random.normal(size=len(kept))
    angle = speed * (0.6 * np.sin(5.0 * times) + 0.2 * np.sin(13.0 * times)) + NOISE * random.normal(size=len(kept))
    stamps = times + wrong * random.normal(size=len(kept))
    sent = {"external_torque": np.zeros(len(kept))}
    commands = Signals(stamps, sent, {"external_torque": "N m"}, frozenset(sent))
    return times, JointLog("log", rigid(), Signals(stamps, {"q": angle}, {"q": "rad"}), commands)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("lost", "drift"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.01)])
def test_stamps_of_even_samples_are_corrected(lost, drift):
    """Also with lost samples, and with a clock that drifts."""
    times, log = recorded(0.0, 2e-4, lost=lost, drift=drift)
    even = evened(log)
    assert rms(even.measured.time - times) < 0.25 * rms(log.measured.time - times)
    assert even.restamped == pytest.approx(2e-4, rel=0.1)
    assert np.array_equal(even.measured["q"], log.measured["q"])
    assert np.allclose(even.commands.time, even.measured.time)


def test_true_stamps_of_uneven_samples_are_kept():
    kept = [evened(log) is log for log in (recorded(2e-4, 0.0, seed)[1] for seed in range(40))]
    assert sum(kept) >= 36


def test_samples_that_are_late_with_stamps_that_are_wrong_are_best_known_between_both():
    times, log = recorded(3e-4, 2e-4)
    even = evened(log)
    best = rms(even.measured.time - times)
    assert best < 0.9 * rms(log.measured.time - times)
    assert best < 0.7 * rms(even_times(log.measured.time) - times)
    assert best == pytest.approx(2e-4 * 3e-4 / np.hypot(2e-4, 3e-4), rel=0.1)  # of the best linear estimate


@pytest.mark.parametrize(("late", "wrong"), [(0.0, 2e-4), (2e-4, 0.0), (3e-4, 2e-4)])
def test_the_share_is_right_within_its_standard_error(late, wrong):
    """Over 60 recordings: errors as large as stated, and a bias of .01 at most, by the speed in windows of 28 ms."""
    found = []
    for seed in range(60):
        _, log = recorded(late, wrong, seed, count=2000)
        time = log.measured.time
        number = np.arange(len(time), dtype=float)
        found.append(share_in(log.measured["q"], number, (time - even_times(time)) / PERIOD))
    share, error = np.array(found).T
    right = late**2 / (late**2 + wrong**2)
    assert 0.75 < np.std((share - right) / error) < 1.4
    assert np.mean(share) == pytest.approx(right, abs=0.01)


def test_what_shows_nothing_keeps_its_stamps():
    """A joint at rest, one that is slow beside its noise, a short log, even stamps."""
    for log in (
        recorded(0.0, 2e-4, speed=0.0)[1], recorded(0.0, 2e-4, speed=1e-3)[1],
        recorded(0.0, 2e-4, count=60)[1], recorded(0.0, 0.0)[1], log_of(rigid(), (), seed=1),
    ):  # fmt: skip
        assert evened(log) is log


def test_a_slow_joint_shows_nothing_by_chance():
    """Shares of its noise are large, of either sign, and a few of two hundred lie below 1 by two standard errors."""
    logs = [recorded(0.0, 2e-4, seed, count=500, speed=1e-3)[1] for seed in range(200)]
    assert all(evened(log) is log for log in logs)


def test_missing_angles_and_commands_with_stamps_of_their_own():
    times, log = recorded(0.0, 2e-4)
    angle = log.measured["q"].copy()
    angle[::50] = np.nan
    sent = Signals(times[::2] + 1e-3, {"external_torque": np.zeros(2500)}, {"external_torque": "N m"})
    log = replace(log, measured=Signals(log.measured.time, {"q": angle}, {"q": "rad"}), commands=sent)
    even = evened(log)
    assert rms(even.measured.time - times) < 0.25 * rms(log.measured.time - times)
    assert even.commands is sent


def test_a_diagnosis_uses_the_corrected_stamps_and_says_so():
    log = log_of(rigid(), (), seed=1)
    time = log.measured.time + 2e-4 * np.random.default_rng(3).normal(size=len(log.measured))
    wrong = replace(log, measured=replace(log.measured, time=time))
    quality = assessed(wrong)
    (note,) = [each for each in quality.findings if each.check == "clock"]
    assert note.severity == "note" and note.value == pytest.approx(0.2, rel=0.1)
    assert quality.noise.jitter < 1e-4 and not [each for each in assessed(log).findings if each.check == "clock"]
    (segments,) = Recordings.of([wrong], None, log.device).fitted
    assert segments.log.restamped > 0.0
    ((as_held_out,), _) = compared_segments([wrong], [LogInterval(log=wrong.name, begin=1.0, end=5.0)])
    assert as_held_out.log.restamped > 0.0
