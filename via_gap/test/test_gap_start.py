"""Motion at the first sample of a log: planted motions, rest as exactly rest, spikes and lost samples left out."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.logs.replay import gap_to, simulated_log
from via_gap.logs.start import motion_at_start
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

UNITS = {"equilibrium": "rad", "preset": "rad", "damping": "-", "q": "rad", "theta": "rad"}


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


# Slower than a step in some tens of samples, a coarse encoder shows rest.
@pytest.mark.parametrize(
    ("rate", "noise", "step", "speed"),
    [(1000.0, 1e-3, 0.0, 0.05), (1000.0, 0.0, 1e-3, 0.2), (100.0, 2e-4, 0.0, 0.05)]
    + [
        (*each, speed)
        for each in ((1000.0, 1e-3, 0.0), (1000.0, 0.0, 1e-3), (100.0, 2e-4, 0.0))
        for speed in (1.0, 8.0)
    ],
)
def test_planted_velocities_are_found_within_the_noise(rate, noise, step, speed):
    random, pace, errors, angles, speeds = np.random.default_rng(1), 6.0, [], [], []
    time = 7.0 + np.arange(500) / rate
    for phase in random.uniform(-1.5, 1.5, 40):
        exact = speed / pace * np.sin(pace * (time - 7.0) + phase)
        seen = exact + noise * random.standard_normal(len(time))
        seen = step * np.rint(seen / step) if step else seen
        angle, velocity = motion_at_start(time, seen)
        angles.append(angle - exact[0])
        speeds.append(speed * np.cos(phase))
        errors.append(velocity - speeds[-1])
    sd = max(noise, step / np.sqrt(12.0))
    line = sd * rate * np.sqrt(12.0 / 9**3)  # standard deviation of the slope of a line through nine samples
    assert rms(angles) < 1.5 * sd
    assert rms(errors) < 0.02 * speed + min(
        3.0 * line, 0.9 * rms(speeds)
    )  # zero, the velocity at rest, has rms(speeds)


def test_a_joint_at_rest_has_no_velocity_although_its_encoder_is_noisy():
    random, time = np.random.default_rng(2), np.arange(1000) / 1000.0
    found = [motion_at_start(time, 0.3 + 1e-3 * random.standard_normal(len(time))) for _ in range(100)]
    assert np.mean([velocity == 0.0 for _, velocity in found]) >= 0.9
    assert np.std([angle for angle, _ in found]) < 0.5e-3


def test_a_spike_at_the_start_moves_nothing():
    time = np.arange(500) / 1000.0
    values = 0.2 + 1e-4 * np.random.default_rng(3).standard_normal(len(time))
    values[0] += 0.5
    assert motion_at_start(time, values) == (pytest.approx(0.2, abs=3e-4), 0.0)


def test_angles_that_were_lost_are_left_out():
    time = np.arange(200) / 1000.0
    values = 0.1 + 2.0 * time
    values[[0, 3, 4]] = np.nan
    assert motion_at_start(time, values) == (pytest.approx(0.1, abs=1e-9), pytest.approx(2.0, rel=1e-6))
    values[:9] = np.nan
    assert np.all(np.isnan(motion_at_start(time, values)))


def test_a_log_cut_out_of_a_motion_has_no_gap_against_the_model_itself():
    device, time = load_device("maccepavd"), 0.02 * np.arange(150)
    commands = Signals(
        time,
        {"equilibrium": 0.5 * np.sin(4.0 * time), "preset": np.full(150, 0.5), "damping": np.full(150, 0.1)},
        UNITS,
        frozenset({"equilibrium", "preset", "damping"}),
    )
    truth = simulate(JointPlant.from_device(device), commands, 2.98, 1000.0).truth
    for begin in range(300, 1500, 200):
        part = slice(begin, begin + 1200, 4)
        measured = Signals(truth.time[part], {"q": truth["q"][part], "theta": truth["theta"][part]}, UNITS)
        assert np.abs(truth["q_velocity"][begin]) > 0.01
        assert gap_to(simulated_log(device, measured, commands), measured).nrmse < 0.005
