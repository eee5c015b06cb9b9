"""A serial joint: motor 1 drives the link through a spring whose stiffness motor 2 sets."""

import numpy as np
import pytest
from via_core.devices import parse_device
from via_core.status import Status
from via_estimators.methods import estimator_for

DEVICE = parse_device(
    """
name: wound_spring
title: Serial joint with a spring that motor 2 winds up
source: [test]
confidence: assumed
arrangement: serial
drive: torque
link: {inertia: 0.03, viscous_friction: 0.02}
motors:
  - {inertia: 0.02, viscous_friction: 0.15, torque_limit: 20.0}
  - {inertia: 0.01, viscous_friction: 0.15, torque_limit: 20.0}
springs:
  - {law: maccepa, k: 4000.0, lever: 0.04, base: 0.12, free_length: 0.08, drum_radius: 0.015, max_deflection: 1.2}
sensors: {rate: 500.0, link_quantum: 1.0e-4, motor_quantum: 1.0e-4, torque_noise: 0.02}
""",
    "wound_spring.yaml",
)
PERIOD, COUNT = 2e-3, 3000
COLUMNS = ("q", "theta_1", "tau_1", "theta_2")


def motion(preset):
    """Rows (COUNT, 5) of time and COLUMNS, and the true stiffness; preset [rad], constant or a function of time."""
    motor, spring, random = DEVICE.motors[0], DEVICE.springs[0], np.random.default_rng(2)

    def preset_at(t):
        return preset(t) if callable(preset) else np.full_like(t, preset)

    def at(t):
        return 0.2 * np.sin(5.0 * t) + 0.1 * np.sin(11.0 * t), 0.4 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)

    t = PERIOD * np.arange(COUNT)
    middle = t - 0.5 * PERIOD
    q, theta = at(middle)
    rate = 2.8 * np.cos(7.0 * middle) + 2.6 * np.cos(13.0 * middle + 1.0)
    bend = -19.6 * np.sin(7.0 * middle) - 33.8 * np.sin(13.0 * middle + 1.0)
    torque = motor.inertia * bend + motor.viscous_friction * rate - spring.torque(q - theta, preset_at(middle))
    q, theta = at(t)
    rows = np.column_stack([t, q, theta, torque + 0.02 * random.standard_normal(COUNT), preset_at(t)])
    return rows, spring.stiffness(q - theta, preset_at(t))


@pytest.mark.parametrize("preset", [0.4, 1.5, 4.0])
@pytest.mark.parametrize("method", ["modulated_torque", "residual", "extended_kalman"])
def test_signals_of_a_serial_joint_are_plausible_at_any_preset(preset, method):
    rows, truth = motion(preset)
    estimator = estimator_for(DEVICE, method)
    assert estimator.inputs == COLUMNS
    _, estimates = estimator.run_rows(rows)
    later = rows[:, 0] > 2.0
    assert not (estimates.status == Status.IMPLAUSIBLE).any()
    assert (estimates.status == Status.OK)[later].mean() > 0.9
    value, sd = estimates.column("stiffness")
    assert (np.abs(value - truth) < 1.96 * sd)[later].mean() > 0.8


def test_a_preset_that_swings_is_no_change_of_the_spring():
    """Stiffness between half and twice its mean, by a motion of motor 2 that other estimators take for a change."""
    inside = []
    for pace in (0.5, 1.0, 2.0, 3.0, 6.0):
        rows, truth = motion(lambda t, pace=pace: 2.0 + 1.5 * np.sin(pace * t))
        _, estimates = estimator_for(DEVICE).run_rows(rows)
        later = rows[:, 0] > 2.0
        assert (estimates.status == Status.OK)[later].mean() > 0.9
        value, sd = estimates.column("stiffness")
        error = np.abs(value - truth)[later]
        assert np.median(error / truth[later]) < 0.005
        inside.append(np.mean(error < 1.96 * sd[later]))
    assert np.mean(inside) > 0.85


def test_a_reversed_torque_of_a_serial_joint_is_not():
    rows, _ = motion(1.5)
    rows[:, 3] *= -1.0
    state, estimates = (estimator := estimator_for(DEVICE)).run_rows(rows)
    assert not (estimates.status == Status.OK)[rows[:, 0] > 2.0].any()
    assert "sign" in estimator.fault(state)


def test_a_preset_that_is_not_measured_prevents_only_the_check():
    rows, truth = motion(1.5)
    rows[:, 4] = np.nan
    _, estimates = estimator_for(DEVICE).run_rows(rows)
    later = rows[:, 0] > 2.0
    assert (estimates.status == Status.OK)[later].all()
    assert np.abs(estimates.value[:, 0] - truth)[later].max() < 0.05 * truth.max()


def test_one_sample_at_a_time_gives_the_bits_of_a_run():
    rows, _ = motion(1.5)
    estimator = estimator_for(DEVICE)
    state, together = estimator.run_rows(rows[:800])
    alone = estimator.init()
    for k, row in enumerate(rows[:800]):
        alone, estimate = estimator.step(alone, row)
        assert estimate.status == together.status[k] and np.array_equal(estimate.value, together.value[k])
    assert np.array_equal(alone, state, equal_nan=True)
