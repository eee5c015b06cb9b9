"""Shared parts of estimators on the motors' torque equation: columns, device parameters, sample validation."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_estimators import transmissions, window


def test_columns_are_ordered_by_transmission():
    assert transmissions.inputs_of(2) == ("q", "theta_1", "tau_1", "theta_2", "tau_2")
    assert transmissions.outputs_of(1) == ("stiffness", "stiffness_1")
    assert transmissions.outputs_of(2, "b", "d") == (
        "stiffness",
        "stiffness_1",
        "stiffness_2",
        "b_1",
        "b_2",
        "d_1",
        "d_2",
    )


def test_scales_and_sensor_noise_come_from_the_device():
    device = load_device("vsa2")
    known = transmissions.known_of(device)
    quantum = max(device.sensors.link_quantum, device.sensors.motor_quantum)
    assert known["transmissions"] == device.n_transmissions == len(transmissions.motors_of(device))
    assert known["deflection_scale"] == device.springs[0].max_deflection
    assert known["position_noise"] == pytest.approx(quantum / np.sqrt(12.0))
    assert known["minimum_motion"] >= 4.0 * quantum


@pytest.mark.parametrize("name", ["maccepavd", "compact_vpda"])
def test_motors_that_are_not_torque_driven_raise(name):
    with pytest.raises(ParameterError, match="no torque-driven transmission"):
        transmissions.motors_of(load_device(name))


def test_a_sample_with_too_large_a_deflection_of_any_transmission_is_refused():
    state, times = np.zeros(window.HEADER.size), np.zeros(5)
    window.start(state)
    good = np.array([0.0, 0.5, 0.0, 1.0, 0.2, 1.0])
    answers = []
    for k, (column, value) in enumerate([(0, 0.0), (2, 2.6), (4, -1.6), (4, -1.4), (5, np.nan), (1, 0.4)]):
        row = good.copy()
        row[column] = value
        row[0] = 1e-3 * k
        answers.append(transmissions.enter(state, times, row, 2, 2.0, 0.05))
    taken, skipped = window.TAKEN, window.SKIPPED
    assert answers == [window.RESTARTED, skipped, skipped, taken, skipped, taken]
    header = window.HEADER
    assert state[header.bad] == 3.0 and state[header.samples] == 3.0 and state[header.gaps] == 0.0
    np.testing.assert_allclose(times[:3], [0.0, 3e-3, 5e-3])
