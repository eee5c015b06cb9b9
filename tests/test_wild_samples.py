"""Wild numbers in single samples: they are bad samples, and have no other effect on an estimator."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.status import Status
from via_estimators.checked import LONGEST
from via_estimators.contract import rows_of
from via_estimators.methods import estimator_for, methods_for
from via_validation.compare.faults import moved

AT = 3000  # sample
QBMOVE = load_device("qbmove_a")
CASES = [(QBMOVE, method) for method in methods_for(QBMOVE)]
CASES += [(load_device(name), "auto") for name in ("dlr_bavs", "maccepavd", "visco_elastic_demo")]
IDS = [f"{device.name}, {method}" for device, method in CASES]


@pytest.fixture(scope="module")
def recorded():
    return {device.name: moved(device) for device in {device.name: device for device, _ in CASES}.values()}


@pytest.mark.parametrize(("device", "method"), CASES, ids=IDS)
def test_a_wild_number_acts_like_a_missing_one(recorded, device, method):
    signals = recorded[device.name]
    estimator = estimator_for(device) if method == "auto" else estimator_for(device, method)
    at = min(AT, len(signals) // 2)
    for column, name in enumerate(estimator.inputs, 1):
        angle = name == "q" or (name.startswith("theta_") and name[6:].isdigit())
        if not angle and not name.startswith("tau"):
            continue
        wild, missing = rows_of(signals, estimator.inputs), rows_of(signals, estimator.inputs)
        if not np.isfinite(wild[at - 1 : at + 1, column]).all():
            continue  # not measured
        wild[at, column], missing[at, column] = (30.0 if angle else 1e3), np.nan
        (_, found), (_, expected) = estimator.run_rows(wild), estimator.run_rows(missing)
        assert np.array_equal(found.status, expected.status), name
        assert np.array_equal(found.value, expected.value), name


def test_the_given_samples_are_not_changed(recorded):
    estimator, signals = estimator_for(QBMOVE), recorded["qbmove_a"]
    rows = rows_of(signals, estimator.inputs)
    rows[AT, 1] = 1e3
    before = rows.copy()
    estimator.run_rows(rows)
    assert np.array_equal(rows, before)


def test_a_step_that_stays_is_believed_after_some_time(recorded):
    estimator, signals = estimator_for(QBMOVE), recorded["qbmove_a"]
    rows = rows_of(signals, estimator.inputs)
    rows[AT:, [1, 2, 4]] += 100.0  # the zero of all encoders has moved
    status = estimator.run_rows(rows)[1].status
    bad = np.flatnonzero(status == Status.BAD_SAMPLE)
    assert bad[0] == AT and rows[bad[-1], 0] - rows[AT, 0] < LONGEST + 2e-3
    assert (status[-1000:] == Status.OK).mean() > 0.9


def test_fast_motion_in_coarse_steps_of_time_is_no_fault():
    """An angle of 20 rad/s sampled at 25 Hz, and torques that switch between their limits."""
    estimator = estimator_for(QBMOVE)
    time = np.arange(0.0, 8.0, 0.04)
    rows = np.column_stack([time, *(20.0 * time,) * 2, 6.0 * np.sign(np.sin(9.0 * time)), 20.0 * time, 0.0 * time])
    assert not (estimator.run_rows(rows)[1].status == Status.BAD_SAMPLE).any()
