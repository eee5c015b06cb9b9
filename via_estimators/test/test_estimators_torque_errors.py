"""Tolerances of torque scale and timing in the intervals: twins, their kernels, and the evidence of the inertia."""

from dataclasses import replace

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.devices import load_device
from via_core.status import Status
from via_estimators.checked import Checked
from via_estimators.methods import estimator_for
from via_estimators.modulated_torque import ModulatedTorque
from via_estimators.residual import Residual
from via_estimators.torque_errors import WithTorqueErrors, _lagged, with_torque_errors

DEVICE = load_device("cubic_demo")


def stated(scale=0.0, timing=0.0, inertia=0.05):
    given = {"torque_scale": scale, "torque_timing": timing, "motor_inertia": inertia}
    return DEVICE.model_copy(update={"tolerances": DEVICE.tolerances.model_copy(update=given)})


def moved(count=4000, gain=1.0, late=0):
    """Rows of the joint in prescribed motion, and the true total stiffness; torques from the motor equations."""
    t = np.arange(-50, count + 50) * 1e-3
    q = 0.3 * np.sin(5.0 * t)
    columns, stiffness = [q], 0.0
    for i, (sign, rate) in enumerate(((1.0, 7.0), (-1.0, 9.0))):
        motor, spring = DEVICE.motors[i], DEVICE.springs[i]
        theta = sign * 0.8 + 0.2 * np.sin(rate * t)
        speed, bend = 0.2 * rate * np.cos(rate * t), -0.2 * rate**2 * np.sin(rate * t)
        tau = motor.inertia * bend + motor.viscous_friction * speed - spring.torque(q - theta)
        tau[1:] = 0.5 * (tau[1:] + tau[:-1])  # over the interval that ends at the stamp
        columns += [theta, gain * np.roll(tau, late)]
        stiffness = stiffness + spring.stiffness(q - theta)
    return np.column_stack([t, *columns])[50:-50], stiffness[50:-50]


def inside(estimates, truth, begin=1.5):
    good = (estimates.status == Status.OK) & (estimates.time > begin)
    assert good.mean() > 0.3
    value, sd = estimates.column("stiffness")
    return float(np.mean(np.abs(value - truth)[good] <= 1.96 * sd[good]))


@pytest.mark.parametrize("method", ["modulated_torque", "modulated_stiffness", "residual"])
def test_a_stated_torque_scale_is_in_the_interval_of_every_method(method):
    rows, truth = moved(gain=1.1)
    estimates = estimator_for(stated(scale=0.1), method).run_rows(rows)[1]
    assert inside(estimates, truth) > 0.85
    plain = estimator_for(stated(inertia=0.65), method).run_rows(rows)[1]
    assert inside(plain, truth) < 0.5


def test_a_stated_delay_widens_the_interval_by_the_error_that_it_causes():
    """The variance added on punctual torques is the squared shift that torques really 5 ms late cause."""
    punctual, late = moved()[0], moved(late=5)[0]
    value, sd = estimator_for(stated(), "modulated_stiffness").run_rows(punctual)[1].column("stiffness")
    same, wide = estimator_for(stated(timing=0.005), "modulated_stiffness").run_rows(punctual)[1].column("stiffness")
    shifted = estimator_for(stated(), "modulated_stiffness").run_rows(late)[1].column("stiffness")[0]
    np.testing.assert_array_equal(same, value)
    later = punctual[:, 0] > 2.0
    added = np.sqrt(np.mean(wide[later] ** 2 - sd[later] ** 2))
    assert added == pytest.approx(np.sqrt(np.mean((shifted - value)[later] ** 2)), rel=0.3)


def test_an_inertia_beside_the_file_s_is_evidence_of_a_wrong_scale():
    """Nothing is stated: 10 % too much torque is 10 % too much inertia, twice the tolerance."""
    rows, truth = moved(gain=1.1)
    assert inside(estimator_for(stated()).run_rows(rows)[1], truth) > 0.85
    weak, truth = moved(gain=0.48)  # then the stiffness is off by 52 %, which is more than itself
    assert inside(estimator_for(stated()).run_rows(weak)[1], truth) > 0.85
    sound = moved()[0]
    checked = estimator_for(stated()).run_rows(sound)[1]
    bare = ModulatedTorque.from_device(stated()).run_rows(sound)[1]
    later = bare.time > 1.5
    np.testing.assert_array_equal(checked.standard_deviation[later], bare.standard_deviation[later])


@pytest.mark.parametrize(("late", "fits"), [(1, True), (6, False)])
def test_a_link_angle_one_sample_late_makes_the_damping_negative_but_no_fault(late, fits):
    """A stiff joint with little damping: k d is 600 N m/rad x .5 ms."""
    motor, spring = {"inertia": 0.2, "viscous_friction": 0.1}, {"stiffness": 600.0, "max_deflection": 0.1}
    device = elastic(0.5, motor, spring, link_quantum=1e-6, motor_quantum=1e-6, torque_noise=0.02)
    t = np.arange(-50, 6050) * 1e-3
    theta, phi = 0.3 * np.sin(9.0 * t) + 0.1 * np.sin(23.0 * t), 0.03 * np.sin(14.0 * t + 1.0)
    speed, bend = np.gradient(theta, t), np.gradient(np.gradient(theta, t), t)
    tau = 0.2 * bend + 0.1 * speed - 600.0 * phi
    tau[1:] = 0.5 * (tau[1:] + tau[:-1])
    rows = np.column_stack([t, np.roll(theta + phi, late), theta, tau])[50:-50]
    estimates = estimator_for(device).run_rows(rows)[1]
    later = estimates.time > 2.5
    assert estimates.column("motor_damping_1")[0][later].max() < 0.0
    assert (np.mean(estimates.status[later] == Status.IMPLAUSIBLE) < 0.05) == fits


def test_only_stated_tolerances_of_measured_torques_cost_a_twin():
    inner = Residual.from_device(DEVICE)
    assert with_torque_errors(inner, stated()) is inner
    assert isinstance(with_torque_errors(inner, stated(timing=0.001)), WithTorqueErrors)
    default = ModulatedTorque.from_device(stated(0.1, 0.004))
    assert with_torque_errors(default, stated(0.1, 0.004)) is default
    assert default.parameters.delay_deviation == 0.004 and default.parameters.torque_scale_deviation == 0.1
    assert isinstance(estimator_for(DEVICE, "residual"), Checked)


def test_one_sample_at_a_time_gives_the_bits_of_a_run():
    rows = moved(count=600)[0]
    rows[100, 3], rows[200, 0] = np.nan, rows[199, 0]
    estimator = estimator_for(stated(0.05, 0.003), "residual")
    estimator = replace(estimator, inner=estimator.inner.with_parameters(estimator.parameters))
    whole = estimator.run_rows(rows)[1]
    state = estimator.init()
    for k, row in enumerate(rows):
        state, one = estimator.step(state, row)
        assert one.status == whole.status[k]
        np.testing.assert_array_equal(one.standard_deviation, whole.standard_deviation[k])


def test_the_lag_delays_a_slow_torque_by_its_time_constant():
    t = np.arange(4000) * 1e-3
    rows = np.column_stack([t, np.sin(2.0 * t)])
    changed = np.empty_like(rows)
    _lagged(rows, np.array([1]), 0.005, np.array([-1e300, 0.0]), changed)
    later = t > 1.0  # a torque is held over the interval that ends at its stamp, hence half a step less
    np.testing.assert_allclose(changed[later, 1], np.sin(2.0 * (t - 0.0045))[later], atol=2e-4)


@pytest.mark.parametrize(("gain", "words"), [(2.9, "2.9 x the file"), (0.35, "0.35 x the file")])
def test_an_inertia_many_times_that_of_the_file_is_implausible_and_says_so(gain, words):
    """The wider interval that this inertia causes does not hide it."""
    estimator = estimator_for(stated())
    rows, _ = moved(gain=gain)
    state, estimates = estimator.run_rows(rows)
    assert np.mean(estimates.status[rows[:, 0] > 2.5] == Status.OK) < 0.05
    assert words in estimator.fault(state) and "motor_inertia" in estimator.fault(state)
