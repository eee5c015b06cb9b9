"""Noise on angles enters a row through psi' times the motor's damping and psi'' times its inertia: two colours."""

import numpy as np
import pytest
from via_estimators.modulated_torque import ModulatedTorque, ModulatedTorqueParameters

PERIOD, COUNT, NOISE, STIFFNESS = 2e-3, 1200, 1e-3, 8.0


def log(inertia, damping):
    """Rows (COUNT, 4) of one motor behind a linear spring in prescribed motion, the torque held as a drive holds it."""
    t = PERIOD * np.arange(COUNT)
    middle = t - 0.5 * PERIOD
    motion = [(0.3, 7.0), (0.2, 13.0), (0.05, 31.0)]

    def theta(at, order):
        return sum(a * w**order * np.sin(w * at + order * 0.5 * np.pi) for a, w in motion)

    torque = (
        inertia * theta(middle, 2)
        + damping * theta(middle, 1)
        - STIFFNESS * (0.5 * np.sin(4.0 * middle) - theta(middle, 0))
    )
    return np.column_stack([t, 0.5 * np.sin(4.0 * t), theta(t, 0), torque])


@pytest.mark.parametrize(("inertia", "damping", "torque_noise"), [(0.2, 0.0, 0.1), (1e-3, 2.0, 0.03)])
def test_standard_deviations_match_empirical_ones_with_encoder_noise(inertia, damping, torque_noise):
    """60 runs: psi'' dominates for heavy motors, psi' for viscous ones."""
    rows = log(inertia, damping)
    estimator = ModulatedTorque(
        ModulatedTorqueParameters(
            transmissions=1,
            window=80,
            order=1,
            memory=1e9,
            truncation=0.0,
            steadiness=1.0,
            delay_deviation=1e-9,  # times the damping, it acts as inertia: doubt about it would widen the interval
            creep_deviation=1e-9,  # so would doubt about these
            play_deviation=1e-9,
            inertia_deviation=1.0,
            torque_noise=torque_noise,
            position_noise=NOISE,
        )
    )
    errors, sds = [], []
    for seed in range(60):
        rng, noisy = np.random.default_rng(seed), rows.copy()
        noisy[:, 2] += NOISE * rng.normal(size=COUNT)
        noisy[:, 3] += torque_noise * rng.normal(size=COUNT)
        _, estimates = estimator.run_rows(noisy)
        errors.append(estimates.value[-1, 1:] - [STIFFNESS, inertia, damping])
        sds.append(estimates.standard_deviation[-1, 1:])
    ratio = np.sqrt(np.mean(np.square(sds), axis=0)) / np.std(errors, axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.3))
