"""Rounding of time after a day or a month, and equal bits of `Live` and `run`."""

import numpy as np
import pytest
from via_core.devices import device_names, load_device
from via_core.status import Status
from via_core.wire import SECOND, seconds
from via_estimators.contract import Live
from via_estimators.methods import METHODS, estimator_for, methods_for

DEVICES = [load_device(name) for name in device_names()]
ESTIMATORS = {
    method: estimator_for(next(device for device in DEVICES if method in methods_for(device)), method)
    for method in METHODS
}
COUNT, PERIOD = (
    2600,
    1_000_700,
)  # samples, [ns]: no horizon is a whole number of them, so that no rounding decides a tie
DAY = 86_400 * SECOND  # [ns]


def rows_from(estimator, first):
    """Rows of smooth motion and noise with the sizes of a real log, from the time `first` [ns] on.

    Torques are those that the device needs for this motion: others would be implausible.
    """
    rng, device = np.random.default_rng(5), estimator.device
    t = 1e-9 * PERIOD * np.arange(COUNT)
    columns = {}
    for at, name in enumerate(estimator.inputs):
        pace = 5.0 + at
        size = 0.6 if name == "q" else 0.25
        columns[name] = size * np.sin(pace * t + at)
        if "velocity" in name:
            columns[name] = 0.25 * (pace - 1.0) * np.cos((pace - 1.0) * t + at - 1.0)
    for i, motor in enumerate(device.motors):
        if f"tau_{i + 1}" in columns:
            theta = columns[f"theta_{i + 1}"]
            velocity = np.gradient(theta, t)
            spring = device.springs[i].torque(columns["q"] - theta)
            columns[f"tau_{i + 1}"] = (
                motor.inertia * np.gradient(velocity, t) + motor.viscous_friction * velocity - spring
            )
    if "tau_link" in columns:
        columns["tau_link"] = 2.0 * np.gradient(columns["q"], t)
    noisy = [values + 1e-4 * rng.normal(size=COUNT) for values in columns.values()]
    return np.column_stack([seconds(first + PERIOD * np.arange(COUNT, dtype=np.int64)), *noisy])


@pytest.mark.parametrize("days", [1, 30])
def test_time_error_is_one_rounding_of_a_float(days):
    stamps = days * DAY + PERIOD * np.arange(1000, dtype=np.int64) + 1
    steps = np.diff(seconds(stamps))
    bound = 2.0**-52 * days * DAY / SECOND  # [s] two roundings of 2^-53 of the time
    assert 0.0 < np.abs(steps - 1e-9 * PERIOD).max() <= bound
    assert bound / 1e-3 < 6e-7


@pytest.mark.parametrize("days", [1, 30])
@pytest.mark.parametrize("name", METHODS)
def test_estimates_after_a_month_are_those_of_the_first_second(name, days):
    estimator = ESTIMATORS[name]
    _, early = estimator.run_rows(rows_from(estimator, 0))
    _, late = estimator.run_rows(rows_from(estimator, days * DAY))
    assert Status.OK in early.status
    np.testing.assert_array_equal(late.status, early.status)
    miss = np.abs(late.value - early.value) / early.standard_deviation
    assert miss.max() < 1e-3
    # A standard error is a small difference of large sums and more sensitive to rounding than a value.
    np.testing.assert_allclose(late.standard_deviation, early.standard_deviation, rtol=0.2)


@pytest.mark.parametrize("name", METHODS)
def test_live_gives_the_bits_of_a_run(name):
    estimator = ESTIMATORS[name]
    rows = rows_from(estimator, 0)
    rows[300, 1] = np.nan
    state, whole = estimator.run_rows(rows)
    live = Live(estimator)
    for _ in range(2):
        for k, row in enumerate(rows):
            assert live.take(row.reshape(1, -1).copy()) == whole.status[k]
            assert np.array_equal(live.value, whole.value[k])
            assert np.array_equal(live.standard_deviation, whole.standard_deviation[k])
        assert live.health() == estimator.health(state)
        live.restart()
