"""Times of samples: which share of uneven stamps a motion shows, and stamps that are corrected by it."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import log_of, rigid
from via_core.signals import Signals
from via_gap.logs.even_clock import evened, share_in, unevenness
from via_gap.logs.log import JointLog
from via_gap.logs.quality import assessed
from via_gap.report.report import LogInterval
from via_gap.report.withheld import compared_segments
from via_gap.residual.recordings import Recordings

PERIOD = 0.004  # [s]
NOISE = 2e-5  # [rad]


def log_with(times, stamps, seed=1, speed=1.0, noise=NOISE):
    """A log of a joint that moves with several rad/s, with samples taken at `times` [s] and these stamps."""
    angle = speed * (0.6 * np.sin(5.0 * times) + 0.2 * np.sin(13.0 * times))
    angle = angle + noise * np.random.default_rng(seed).normal(size=len(times))
    sent = {"external_torque": np.zeros(len(times))}
    commands = Signals(stamps, sent, {"external_torque": "N m"}, frozenset(sent))
    return JointLog("log", rigid(), Signals(stamps, {"q": angle}, {"q": "rad"}), commands)


def recorded(late, wrong, seed=1, count=5000, lost=0.0, drift=0.0, speed=1.0):
    """(times, log): samples uneven by `late` [s] with stamps wrong by another `wrong` [s]; standard deviations."""
    random = np.random.default_rng(seed)
    kept = np.sort(random.choice(count, round(count * (1.0 - lost)), replace=False))
    times = PERIOD * kept + drift * np.sin(0.3 * PERIOD * kept) + late * random.normal(size=len(kept))
    stamps = times + wrong * random.normal(size=len(kept))
    return times, log_with(times, stamps, seed, speed)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def improvement(times, log):
    """Error of the times after `evened` over that of the stamps."""
    return rms(evened(log, NOISE).measured.time - times) / rms(log.measured.time - times)


@pytest.mark.parametrize(("lost", "drift"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.01)])
def test_stamps_of_even_samples_are_corrected(lost, drift):
    """Also with lost samples, and with a clock that drifts."""
    times, log = recorded(0.0, 2e-4, lost=lost, drift=drift)
    even = evened(log, NOISE)
    assert improvement(times, log) < (0.4 if lost == 0.0 else 0.8)
    assert even.restamped == pytest.approx(2e-4, rel=0.1)
    assert np.array_equal(even.measured["q"], log.measured["q"])
    assert np.allclose(even.commands.time, even.measured.time)


@pytest.mark.parametrize("jitter", [0.02, 0.05, 0.1, 0.125, 0.15, 0.175, 0.2, 0.3])
@pytest.mark.parametrize("exponential", [False, True])
def test_no_jitter_makes_times_worse(jitter, exponential):
    """Steps beyond half a period between neighbours are no longer certain to be one period."""
    random = np.random.default_rng(2)
    times = PERIOD * np.arange(5000)
    errors = random.exponential(size=5000) - 1.0 if exponential else random.normal(size=5000)
    stamps = np.sort(times + jitter * PERIOD * errors)
    assert improvement(times, log_with(times, stamps)) <= 1.0


@pytest.mark.parametrize("stall", [2, 5, 25])
def test_a_stall_that_ends_in_a_burst_does_not_spoil_its_neighbours(stall):
    times = PERIOD * np.arange(5000)
    stamps = times + 0.05 * PERIOD * np.random.default_rng(3).normal(size=5000)
    for begin in (1000, 3000):
        buffered = slice(begin, begin + stall)
        stamps[buffered] = stamps[begin + stall] - 1e-4 * np.arange(stall, 0, -1)
    even = evened(log_with(times, stamps), NOISE)
    outside = np.abs(stamps - times) < 0.3 * PERIOD
    assert rms((even.measured.time - times)[outside]) < 0.5 * rms((stamps - times)[outside])
    assert np.array_equal(even.measured.time[~outside], stamps[~outside])


def test_pauses_and_a_wrong_first_stamp_stay_where_they_are():
    random = np.random.default_rng(4)
    pauses = np.where(random.uniform(size=5000) < 0.01, random.uniform(0.2, 1.0, 5000), 0.0)
    times = PERIOD * np.arange(5000) + np.cumsum(pauses)
    stamps = times + 0.03 * PERIOD * random.normal(size=5000)
    stamps[0] -= 0.4 * PERIOD
    log = log_with(times, stamps)
    assert improvement(times, log) < 0.7
    first = slice(1, 30)
    assert rms((evened(log, NOISE).measured.time - times)[first]) < 1.2 * rms((stamps - times)[first])


@pytest.mark.parametrize("wrong", [0.0, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("real", ["alternating", "wandering", "slow"])
def test_real_unevenness_of_any_kind_is_kept(real, wrong):
    """Periods that alternate; a sender that sleeps a period, so that its times wander; a rate that sways."""
    random, number = np.random.default_rng(5), np.arange(5000)
    late = {
        "alternating": 0.1 * (-1.0) ** number,
        "wandering": np.cumsum(0.03 * random.normal(size=5000)),
        "slow": 0.3 * np.sin(2.0 * np.pi * number / 40.0),
    }[real]
    times = PERIOD * (number + late)
    log = log_with(times, times + wrong * PERIOD * random.normal(size=5000))
    if wrong > 0.0:
        assert improvement(times, log) <= 1.0
    else:
        assert evened(log, 0.0) is log


def test_right_stamps_are_kept():
    """Also where the noise of each speed is three times the speed itself, in long logs."""
    assert all(evened(log, 0.0) is log for log in (recorded(2e-4, 0.0, seed)[1] for seed in range(40)))
    slow = [recorded(4e-4, 0.0, seed, count=100_000, speed=2e-3)[1] for seed in range(5)]
    assert all(evened(log, 0.0) is log for log in slow)


def test_the_noise_of_the_speed_does_not_make_the_share_smaller():
    """Half of the square of each estimated speed is noise here; of the product of two estimates, none is."""
    found = []
    for seed in range(10):
        _, log = recorded(4e-4, 0.0, seed, count=30_000, speed=1e-2)
        stamps = log.measured.time
        found.append(share_in(log.measured["q"], stamps / PERIOD, unevenness(stamps)[1])[0])
    assert np.mean(found) == pytest.approx(1.0, abs=0.1)


def test_samples_that_are_late_with_stamps_that_are_wrong_are_best_known_between_both():
    times, log = recorded(3e-4, 2e-4)
    stamps = log.measured.time
    on_line = stamps - unevenness(stamps)[0]
    best = rms(evened(log, NOISE).measured.time - times)
    assert best < 0.9 * rms(stamps - times) and best < 0.7 * rms(on_line - times)
    assert best == pytest.approx(2e-4 * 3e-4 / np.hypot(2e-4, 3e-4), rel=0.1)  # of the best linear estimate


@pytest.mark.parametrize(("late", "wrong"), [(0.0, 2e-4), (2e-4, 0.0), (3e-4, 2e-4)])
@pytest.mark.parametrize("bursts", [False, True], ids=["all of it", "a tenth"])
def test_the_share_is_right_within_its_standard_error(late, wrong, bursts):
    """Over 60 recordings, also of motion in a tenth of them: errors about as stated, and a bias of .01 at most."""
    found = []
    for seed in range(60):
        _, log = recorded(late, wrong, seed, count=3000)
        angle = np.where(bursts & (np.arange(3000) // 300 != 4), 0.1, log.measured["q"])
        unknown = np.arange(3000) % 300 < 8  # not the jumps
        _, known = unevenness(log.measured.time)
        found.append(share_in(angle, log.measured.time / PERIOD, known & ~unknown))
    share, error = np.array(found).T
    right = late**2 / (late**2 + wrong**2)
    assert np.std((share - right) / error) < 1.5
    assert np.mean(share) == pytest.approx(right, abs=0.01)


def test_what_shows_nothing_keeps_its_stamps():
    """A joint at rest, one that is slow beside its noise, a short log, even stamps."""
    for log in (
        recorded(0.0, 2e-4, speed=0.0)[1], recorded(0.0, 2e-4, speed=1e-3)[1],
        recorded(0.0, 2e-4, count=60)[1], recorded(0.0, 2e-4, count=5)[1], recorded(0.0, 0.0)[1],
        log_of(rigid(), (), seed=1),
    ):  # fmt: skip
        assert evened(log, NOISE) is log


def test_without_motion_the_share_has_no_standard_error():
    """An angle that never changes, one of noise alone, and one without a window that is known."""
    times = PERIOD * np.arange(500) + 2e-4 * np.random.default_rng(1).normal(size=500)
    _, known = unevenness(times)
    moving = log_with(times, times).measured["q"]
    assert share_in(np.full(500, 0.3), times / PERIOD, known) == (0.0, np.inf)
    assert share_in(moving, times / PERIOD, np.zeros(500, dtype=bool)) == (0.0, np.inf)
    noise = [np.random.default_rng(seed).normal(size=500) for seed in range(20)]
    errors = [share_in(each, times / PERIOD, known)[1] for each in noise]
    assert np.isinf(errors).any() and not np.isnan(errors).any()


def test_stamps_that_disturb_the_angle_by_less_than_its_noise_stay():
    """At 2.4 rad/s, .2 ms are .0005 rad."""
    log = recorded(0.0, 2e-4)[1]
    assert evened(log, 3e-4) is not log
    assert evened(log, 8e-4) is log


def test_a_slow_joint_shows_nothing_by_chance():
    """Shares of its noise are large, of either sign, and a few of two hundred lie below 1 by two standard errors."""
    logs = [recorded(0.0, 2e-4, seed, count=500, speed=1e-3)[1] for seed in range(200)]
    assert all(evened(log, 0.0) is log for log in logs)


@pytest.mark.parametrize("steps", [(1.45,) * 2 + (0.55,) * 4, (0.55,) * 4 + (1.45,) * 2, (1.45, 0.55) * 3])
def test_times_increase_wherever_steps_are_periods(steps):
    """At the limits of what counts as a period, beside a step that is none."""
    time = np.cumsum((*[1.0] * 50, 5.0, *steps, 5.0, *[1.0] * 50))
    late, known = unevenness(time)
    assert np.any(known & (late != 0.0))
    for share in (0.0, 0.5, 1.0):
        assert np.all(np.diff(time - (1.0 - share) * late) > 0.0)


def test_missing_angles_and_commands_with_stamps_of_their_own():
    times, log = recorded(0.0, 2e-4)
    angle = log.measured["q"].copy()
    angle[::50] = np.nan
    sent = Signals(times[::2] + 1e-3, {"external_torque": np.zeros(2500)}, {"external_torque": "N m"})
    log = replace(log, measured=Signals(log.measured.time, {"q": angle}, {"q": "rad"}), commands=sent)
    even = evened(log, NOISE)
    assert improvement(times, log) < 0.4
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
    partly = assessed(recorded(3e-4, 4e-4)[1])
    (left,) = [each for each in partly.findings if each.check == "jitter"]
    assert partly.log.restamped > 0.0 and "are still wrong" in left.text
    for intervals in ([LogInterval(log=wrong.name, begin=1.0, end=5.0)], []):  # held out by a report; a new log
        ((compared,), _) = compared_segments([wrong], intervals)
        assert compared.log.restamped > 0.0
