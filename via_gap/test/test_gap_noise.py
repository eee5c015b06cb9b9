"""Noise of channels: planted noise is recovered, rounding is separated from it, and motion does not leak in."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of
from scipy.signal import chirp, savgol_filter
from via_core.signals import Signals
from via_gap.logs import levels
from via_gap.logs.log import JointLog
from via_gap.logs.noise import channel_noise, clock_of, error_correlation, log_noise, stated_noise

COARSE, FINE = 2.9e-3, 9.6e-5  # [rad] steps of 12-bit and 16-bit encoders


def motion(kind: str, time: np.ndarray) -> np.ndarray:
    if kind == "sine":
        return 0.8 * np.sin(np.pi * time) + 0.1 * np.sin(5.8 * np.pi * time)
    if kind == "chirp":
        return 0.5 * chirp(time, 0.1, time[-1], 8.0)
    moving = np.where((time % 4.0) < 2.0, 0.0, 1.0)
    return 0.1234 + 0.5 * moving * np.sin(np.pi * (time % 2.0)) ** 2


def measured(kind: str, rate: float, step: float, noise: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Time stamps and values of an encoder with a step [rad] and noise before it [steps]."""
    time = np.arange(0.0, 20.0, 1.0 / rate)
    blurred = motion(kind, time) + noise * step * np.random.default_rng(seed).normal(size=time.size)
    return time, step * np.rint(blurred / step)


@pytest.mark.parametrize("kind", ["sine", "chirp", "stops"])
@pytest.mark.parametrize("rate", [100.0, 500.0])
@pytest.mark.parametrize("noise", [0.01, 0.1, 0.25, 0.5, 1.0, 5.0])
def test_noise_before_rounding_is_found(kind, rate, noise):
    for step in (COARSE, FINE):
        found = channel_noise(*measured(kind, rate, step, noise), step)
        assert found.sd == pytest.approx(step * np.hypot(noise, 1 / np.sqrt(12.0)), rel=0.15)
        if noise >= 0.25:
            assert found.white == pytest.approx(noise * step, rel=0.25 if noise < 0.5 else 0.2)


@pytest.mark.parametrize("step", [COARSE, FINE])
def test_a_perfect_encoder_has_rounding_only(step):
    found = channel_noise(*measured("sine", 1000.0, step, 0.0), step)
    assert found.sd == pytest.approx(step / np.sqrt(12.0), rel=0.02)
    assert (found.how, found.jitter) == ("rounding only", 0.0)


def test_a_step_that_the_file_does_not_state_is_seen():
    found = channel_noise(*measured("sine", 500.0, COARSE, 0.5))
    assert found.quantum == pytest.approx(COARSE, rel=1e-3)
    assert found.white == pytest.approx(0.5 * COARSE, rel=0.1)


def test_noise_at_standstill_is_found():
    rng = np.random.default_rng(3)
    time = np.arange(5000) / 500.0
    found = channel_noise(time, FINE * np.rint((0.12345 + 0.5 * FINE * rng.normal(size=5000)) / FINE), FINE)
    assert found.how == "standstill"
    assert found.white == pytest.approx(0.5 * FINE, rel=0.15)


def test_an_angle_that_never_moves_has_the_noise_of_its_step():
    found = channel_noise(np.arange(500) / 500.0, np.full(500, 0.3), COARSE)
    assert found.sd == pytest.approx(COARSE / np.sqrt(12.0))


@pytest.mark.parametrize("ar1", [0.0, 0.3, 0.6, 0.8])
def test_correlated_noise_is_found(ar1):
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 20.0, 1e-3)
    drive = rng.normal(size=time.size) * np.sqrt(1.0 - ar1**2)
    noise = np.zeros(time.size)
    for i in range(1, time.size):
        noise[i] = ar1 * noise[i - 1] + drive[i]
    found = channel_noise(time, motion("sine", time) + 2e-4 * noise, 0.0)
    assert found.ar1 == pytest.approx(ar1, abs=0.1)
    assert found.sd == pytest.approx(2e-4, rel=0.2)


def test_stamps_that_are_wrong_show_as_jitter_and_those_that_are_right_do_not():
    rng = np.random.default_rng(7)
    regular = np.arange(10000) / 500.0
    taken = regular + 1e-4 * rng.normal(size=regular.size)
    values = FINE * np.rint(motion("sine", taken) / FINE)
    wrong, right = channel_noise(regular, values, FINE), channel_noise(taken, values, FINE)
    assert wrong.jitter == pytest.approx(1e-4, rel=0.15)
    assert wrong.sd < 3.0 * right.sd  # while jitter makes six times as much
    assert (right.jitter, right.how) == (0.0, "rounding only")
    assert clock_of(taken).jitter == pytest.approx(1e-4, rel=0.1)
    assert clock_of(regular).jitter < 1e-9


def test_stamps_without_any_clock_do():
    rng = np.random.default_rng(8)
    time = np.sort(rng.uniform(0.0, 20.0, 10000))
    values = FINE * np.rint((motion("sine", time) + 0.5 * FINE * rng.normal(size=time.size)) / FINE)
    assert channel_noise(time, values, FINE).white == pytest.approx(0.5 * FINE, rel=0.1)


def test_outliers_jumps_and_lost_samples_do_not_count():
    rng = np.random.default_rng(9)
    time = np.arange(10000) / 500.0
    values = motion("sine", time) + 1e-4 * rng.normal(size=time.size)
    values[rng.integers(0, 10000, 30)] += 0.5
    values[5000:] += 0.3
    values[rng.integers(0, 10000, 500)] = np.nan
    assert channel_noise(time, values, 0.0).sd == pytest.approx(1e-4, rel=0.2)


def test_an_observers_estimate_is_not_free_of_noise():
    time = np.arange(10000) / 500.0
    smooth = np.convolve(FINE * np.rint(motion("sine", time) / FINE), np.ones(15) / 15.0, "same")[20:-20]
    found = channel_noise(time[20:-20], smooth, FINE)
    assert found.how == "smoothed"
    assert found.sd == pytest.approx(FINE / np.sqrt(12.0), rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.15, 0.5])
def test_errors_are_correlated_as_the_formula_says(noise):
    rng = np.random.default_rng(11)
    step, slow = 1.0, 0.1 * np.arange(20000) + 0.3 * np.sin(0.01 * np.arange(20000))  # a tenth of a step per sample
    error = np.rint(slow + noise * rng.normal(size=slow.size)) - slow
    known = replace(channel_noise(np.arange(20000.0), slow + error, step), white=noise * step, ar1=0.0)
    found = error_correlation(known, slow, 4)
    counted = [np.mean(error[: -lag or None] * error[lag:]) for lag in range(4)]
    assert found == pytest.approx(np.array(counted) / counted[0], abs=0.03)


def test_a_log_has_its_noise_beside_what_the_file_declares():
    log = log_of(flexible(), (), seed=11, duration=6.0)
    found = log_noise(log)
    assert found.channels.keys() == {"q", "theta_1", "tau_1"} == found.declared.keys()
    for name in ("q", "theta_1"):
        assert found.channels[name].sd == pytest.approx(found.declared[name], rel=0.1)
    assert found.channels["tau_1"].sd == pytest.approx(found.declared["tau_1"], rel=0.15)
    assert found.floor("q", np.array([0.0, 3.0])) == pytest.approx(found.channels["q"].sd, rel=0.05)


def test_noise_that_no_file_states_is_found_in_a_log():
    log = log_of(flexible(), (), seed=12, duration=6.0)
    q = log.measured["q"]
    noisy = FINE * np.rint((q + 3.0 * FINE * np.random.default_rng(1).normal(size=q.size)) / FINE)
    channels = {**log.measured.channels, "q": noisy}
    found = log_noise(JointLog("noisy", log.device, Signals(log.measured.time, channels, log.measured.units), None))
    assert found.channels["q"].white == pytest.approx(3.0 * FINE, rel=0.1)


@pytest.mark.parametrize(("samples", "wide"), [(33, 33), (400, 17), (400, 73)])
def test_speeds_are_slopes_of_straight_lines_up_to_both_ends(samples, wide):
    values = np.cumsum(np.random.default_rng(wide).normal(size=samples))
    assert levels._slopes(values, wide) == pytest.approx(savgol_filter(values, wide, 1, deriv=1), abs=1e-12)


def test_a_simulated_log_has_the_noise_that_the_device_file_states():
    """What the log itself shows agrees."""
    log = log_of(flexible(), (), seed=4, duration=20.0)
    stated, shown = stated_noise(log), log_noise(log)
    assert stated.channels.keys() == shown.channels.keys() == {"q", "theta_1", "tau_1"}
    for name, each in stated.channels.items():
        found = shown.channels[name]
        assert each.sd == pytest.approx(found.sd, rel=0.1) and each.quantum == pytest.approx(found.quantum, rel=1e-3)
    assert stated.clock.period == pytest.approx(shown.clock.period) and stated.jitter == 0.0
