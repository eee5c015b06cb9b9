"""Recorders of the sealed benchmark: rates, noise before rounding, stamps, late ticks, gaps, short recordings."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from via_core.devices import Device
from via_core.signals import Array
from via_validation.sealed.excitation import excite, start_of
from via_validation.sealed.joints import POSITIONED, device_of, draw_joint, servo_of
from via_validation.sealed.loop import read_angles
from via_validation.sealed.physics import Physics
from via_validation.sealed.recorder import Recorder, acting, draw_recorder, in_gaps
from via_validation.sealed.recording import cut, sense
from via_validation.sealed.stepping import Drive, Run, simulate

STEP = 2.0 * np.pi / 2**14


def ran(family: str, acts: Array | None = None) -> tuple[Device, Drive, Run]:
    """A joint of `family` at 1000 Hz for 4 s."""
    rng = np.random.default_rng(7)
    true = draw_joint(rng, family)
    device = device_of(true)
    drive = replace(excite(rng, device, 4.0, 1.0, 1000.0, servo_of(true)), acts=acts)
    start = start_of(device, drive)
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), start)
    assert run is not None
    return device, drive, run


@pytest.fixture(scope="module")
def flexible() -> tuple[Device, Drive, Run]:
    return ran("series_elastic")


def logged(each: tuple[Device, Drive, Run], recorder: Recorder, seed: int = 3):  # type: ignore[no-untyped-def]
    device, drive, run = each
    return sense(np.random.default_rng(seed), device, Physics(), drive, run, recorder)


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0])
def test_noise_before_rounding_has_the_variance_of_both(flexible: tuple[Device, Drive, Run], noise: float) -> None:
    """Of a moving angle, the error of a rounded reading is noise and rounding together: sd^2 + 1/12 steps."""
    device, _, run = flexible
    step = device.sensors.link_quantum
    assert step is not None
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1.0, 1.0, 40_000)
    read = read_angles(run.row, 0, angles, noise * step * rng.standard_normal(40_000))
    assert np.std(read - angles) / step == pytest.approx(np.sqrt(noise**2 + 1.0 / 12.0), rel=0.02)
    np.testing.assert_allclose(np.rint(read / step), read / step, atol=1e-6)  # rounded after the noise
    clean, noisy = (logged(flexible, Recorder(encoder_noise=each)) for each in (0.0, noise))
    expected = np.sqrt(noise**2 + 1.0 / 12.0) * step
    assert np.std(noisy.q - run.angle[:, 0]) == pytest.approx(expected, rel=0.1)
    assert (np.array_equal(clean.q, noisy.q)) == (noise == 0.0)


@pytest.mark.parametrize("every", [1, 2, 4, 10])
def test_a_slower_log_holds_samples_of_the_loop(flexible: tuple[Device, Drive, Run], every: int) -> None:
    device, _, run = flexible
    mean, last = (logged(flexible, Recorder(every=every, snapshot=each)) for each in (False, True))
    np.testing.assert_allclose(np.diff(mean.time), every * 1e-3, atol=1e-12)
    step = device.sensors.link_quantum
    assert step is not None and np.abs(mean.q - run.angle[::every, 0]).max() <= 0.501 * step
    over = run.commands[: 4000 // every * every, 0].reshape(-1, every)
    noise = 5.0 * device.sensors.torque_noise
    assert np.abs(mean.tau[1:, 0] - over.mean(axis=1)).max() < noise
    assert np.abs(last.tau[1:, 0] - over[:, -1]).max() < noise
    assert len(mean.commands) == 4000 and len(last.commands) == 4000 // every
    np.testing.assert_array_equal(last.commands, run.commands[::every])


def test_a_table_holds_one_command_per_sample() -> None:
    each = ran("rigid")
    _, _, run = each
    one, four, last = (logged(each, Recorder(every=n, snapshot=s)) for n, s in ((1, False), (4, False), (4, True)))
    np.testing.assert_array_equal(one.commands[:-1, 0], run.commands[:, 0])
    np.testing.assert_allclose(four.commands[:-1, 0], run.commands[:, 0].reshape(-1, 4).mean(axis=1))
    np.testing.assert_array_equal(last.commands[:-1, 0], run.commands[::4, 0])
    for log in (one, four, last):
        assert len(log.time) == len(log.q) == len(log.commands)
        np.testing.assert_array_equal(log.time, log.command_time)
    device, drive, positioned = ran(POSITIONED)
    goals = logged((device, drive, positioned), Recorder())
    np.testing.assert_array_equal(goals.commands[:-1, 0], drive.references[:, 0])


def test_stamps_that_are_off_leave_the_samples_where_they_were(flexible: tuple[Device, Drive, Run]) -> None:
    right, off = logged(flexible, Recorder()), logged(flexible, Recorder(stamp_jitter=0.05))
    np.testing.assert_array_equal(right.q, off.q)
    error = off.time - right.time
    assert np.std(error) == pytest.approx(0.05e-3, rel=0.05) and np.all(np.diff(off.time) > 0.0)
    moved = logged(flexible, Recorder(jitter=0.05))
    assert np.std(moved.time - right.time) == pytest.approx(0.05e-3, rel=0.05)
    assert not np.array_equal(moved.q, right.q)  # sampled when the stamp says


def test_late_ticks_hold_the_command_before(flexible: tuple[Device, Drive, Run]) -> None:
    recorder = Recorder(late=0.3, latest=4.0)
    acts = acting(np.random.default_rng(5), recorder, 4000, 1000.0)
    assert acts is not None and acts[0] == 0.0
    missed = np.isnan(acts)
    assert 0.15 < missed.mean() < 0.6 and np.nanmax(acts) < 1e-3
    lengths = np.diff(np.flatnonzero(~missed))
    assert lengths.max() > 3 and 0.2 < np.mean(acts[~missed] > 0.0) < 0.8
    each = ran("series_elastic", acts)
    _, _, run = each
    assert np.isnan(run.commands[missed]).all() and np.isfinite(run.commands[~missed]).all()
    for k in np.flatnonzero(missed)[:50]:
        before = run.commands[:k][np.isfinite(run.commands[:k, 0])][-1]
        np.testing.assert_array_equal(run.mean[k], run.last[k])
        np.testing.assert_allclose(run.mean[k], before)
    partly = next(k for k in np.flatnonzero(~missed) if acts[k] >= 0.5e-3)  # the old one first, then the new one
    share = np.floor(acts[partly] / 0.25e-3) / 4.0
    expected = share * run.last[partly - 1] + (1.0 - share) * run.commands[partly]
    np.testing.assert_allclose(run.mean[partly], expected)
    acted, due = (logged(each, replace(recorder, stamped_due=due)) for due in (False, True))
    np.testing.assert_allclose(acted.command_time, run.acted[~missed])
    np.testing.assert_allclose(due.command_time, np.flatnonzero(~missed) * 1e-3)
    held = acted.commands[np.searchsorted(acted.command_time, run.time[1:], side="left") - 1]
    np.testing.assert_array_equal(held, run.last)  # a command holds from its stamp to the next


def test_lost_commands_leave_gaps_of_some_milliseconds(flexible: tuple[Device, Drive, Run]) -> None:
    recorder = Recorder(gaps=3.0, gap=0.02, gaps_in_log=True)
    time = np.arange(40_000) * 1e-3
    lost = in_gaps(np.random.default_rng(2), recorder, time)
    assert lost.mean() == pytest.approx(3.0 * 0.02 * 0.625, rel=0.25)  # gaps of .25 to 1 times their longest
    kept = time[~lost]
    assert 0.015 < np.diff(kept).max() <= 0.05  # two may meet
    whole, less = logged(flexible, Recorder()), logged(flexible, recorder)
    assert 0.5 * len(whole.commands) < len(less.commands) < len(whole.commands)
    np.testing.assert_array_equal(whole.q, less.q)  # they acted all the same
    assert acting(np.random.default_rng(2), recorder, 100, 1000.0) is None
    never = acting(np.random.default_rng(2), replace(recorder, gaps_in_log=False), 4000, 1000.0)
    assert never is not None and np.isnan(never).any()


def test_short_recordings_are_parts_of_the_long_one(flexible: tuple[Device, Drive, Run]) -> None:
    whole = logged(flexible, Recorder())
    parts = cut(whole, [(0.5, 1.5), (2.0, 3.0)])
    assert [len(part.time) for part in parts] == [1000, 1000] and [len(part.commands) for part in parts] == [1000, 1000]
    np.testing.assert_array_equal(parts[1].q, whole.q[2000:3000])
    assert parts[1].time[0] == pytest.approx(2.0)


def test_faults_are_in_a_minority_and_a_fault_makes_a_recording_degraded() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw_recorder(rng, 4, bool(k % 2)) for k in range(2000)]
    for name, low, high in (
        ("encoder_noise", 0.45, 0.55), ("stamp_jitter", 0.08, 0.16), ("late", 0.08, 0.16), ("gaps", 0.08, 0.16),
        ("snapshot", 0.25, 0.35),
    ):  # fmt: skip
        assert low < np.mean([bool(getattr(each, name)) for each in drawn]) < high, name
    assert 0.4 < np.mean([each.quality == "good" for each in drawn]) < 0.6
    assert not any(each.jitter or each.lost for each in drawn[1::2])  # a table's rows are written by the loop
    assert all(each.encoder_noise <= 1.0 and each.stamp_jitter <= 0.05 and each.gap <= 0.02 for each in drawn)
    assert Recorder(every=4).quality == Recorder(jitter=0.1, lost=0.01, encoder_noise=1.0).quality == "good"
    for fault in ({"late": 0.1}, {"gaps": 1.0}, {"stamp_jitter": 0.01}, {"every": 4, "snapshot": True}):
        assert Recorder(**fault).quality == "degraded"  # type: ignore[arg-type]
    assert Recorder(snapshot=True).quality == "good" and set(asdict(Recorder())) >= {"late", "gaps"}
