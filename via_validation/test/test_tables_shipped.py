"""Rows at shipped settings: planted errors, methods whose inputs are measured, limits and reasons."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.signals import Signals
from via_estimators.methods import methods_for
from via_validation.tables import shipped, shipped_rows
from via_validation.tables.cubic_joint import TAU, TORQUE_RATIO, cubic_log
from via_validation.tables.vsa2 import QUANTUM, TORQUE_NOISE

DEVICE = load_device("cubic_aa_vsa")


@pytest.fixture(name="plant", scope="module")
def _plant():
    log = cubic_log("E2")
    noise = log.noise_sd(TAU, TORQUE_RATIO)
    device = shipped.with_sensors(DEVICE, None, noise, None)

    def signals(seed):
        return shipped_rows._without_velocity(log.noisy(seed, noise))

    return shipped.Plant(device, signals, log.stiffness, True)


def test_methods_that_need_what_the_table_does_not_measure_are_left_out(plant):
    found = shipped.measured_methods(plant)
    assert found[0] == "modulated_torque" and "signal_based" not in found
    assert set(found) == set(methods_for(DEVICE)) - {"signal_based"}

    def with_velocity(seed):
        given = plant.signals(seed)
        units = {**given.units, "theta_velocity": "rad/s"}
        return Signals(given.time, {**given.channels, "theta_velocity": given["theta"]}, units)

    assert set(shipped.measured_methods(replace(plant, signals=with_velocity))) == set(methods_for(DEVICE))


def test_errors_are_those_of_the_estimator_as_shipped(plant):
    found = shipped.errors(plant, "modulated_torque", 2)
    assert 0.0 < found.mse_2 < 25.0 and found.outside < 15.0 and found.ok > 95.0 and found.seeds == 2
    assert found.inertia.shape == found.damping.shape == (2, 2)
    lied = shipped.errors(replace(plant, truth=1.5 * plant.truth), "modulated_torque", 1)
    assert lied.outside > 90.0 and lied.mse_2 > 100.0 * found.mse_2
    assert np.isnan(shipped.errors(plant, "residual", 1).inertia).all()


def test_a_missed_interval_has_its_reason_and_no_ok_estimate_is_a_miss():
    good = shipped.Errors(3.0, 98.0, 1.0, 1.0, 1.0, np.ones((1, 2)), np.ones((1, 2)), 5)
    row = shipped.outside_row("3.shipped.x", "what", good, "settings", "the reason")
    assert (row.id, row.ours, row.limit, row.ok, row.seeds) == ("3.shipped.x.outside", 3.0, 15.0, True, 5)
    assert row.remark == "status OK in 98 % of the samples"
    assert shipped.outside_row("x", "", replace(good, outside=15.1), "", "the reason").remark.endswith("; the reason")
    never = shipped.outside_row("x", "", replace(good, outside=nan), "", "the reason")
    assert never.ok is False and never.ours is None and "the reason" in never.remark


def test_errors_of_4_4_are_judged_for_its_method_and_the_default():
    motor = np.array([[shipped_rows.INERTIA, 1.002 * shipped_rows.INERTIA]])
    errors = shipped.Errors(3.0, 98.0, 2e-4, 4e-6, 1e-6, motor, np.full((1, 2), shipped_rows.DAMPING), 5)
    found = shipped_rows._error_rows("4.modulated_torque", "what", errors, "", "v1", True)
    rows = {row.id.removeprefix("4.modulated_torque."): row for row in found}
    assert {name: row.limit for name, row in rows.items()} == {"mse_5": 6.0, "mse_2": 100.0, "B.rms": 0.1, "D.rms": 2.0}
    assert rows["mse_2"].ours == pytest.approx(200.0) and "for the first time" in rows["mse_2"].remark
    assert rows["mse_5"].ok and rows["B.rms"].ours == pytest.approx(0.2) and rows["D.rms"].ours == 0.0
    assert "dry friction" in rows["B.rms"].remark
    shown = shipped_rows._error_rows("4.modulated_torque", "what", errors, "", "v1", False)
    assert all(row.limit is None for row in shown)
    unknown = replace(errors, inertia=np.full((1, 2), nan), damping=np.full((1, 2), nan))
    assert len(shipped_rows._error_rows("4.modulated_torque", "what", unknown, "", "v1", True)) == 2


def test_the_shipped_files_of_the_vsa2_have_the_sensors_of_4_4():
    for name in ("vsa2", "vsa2_v2", "vsa2_v3"):
        sensors = load_device(name).sensors
        assert sensors.motor_quantum == pytest.approx(QUANTUM, rel=1e-3) and sensors.torque_noise == TORQUE_NOISE
