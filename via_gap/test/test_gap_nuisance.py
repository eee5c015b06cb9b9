"""Nuisance parameters: a bounded minimum that is one, and a repaired device whose rows are those of the fit."""

import numpy as np
import pytest
from gap_logs import flexible
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from via_core.devices import device_names, load_device
from via_gap.nuisance import apply_all, descend, nuisances
from via_gap.repaired import repaired_device
from via_sim.plants import JointPlant


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_the_bounded_minimum_is_that_of_a_slow_solver(seed, size):
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(20, size)) * 10.0 ** rng.uniform(-2, 2, size)
    wanted = rng.normal(size=20) * 3.0
    low = -rng.uniform(0.1, 1.5, size)
    high = rng.uniform(0.1, 1.5, size)
    start = np.where(rng.uniform(size=size) < 0.5, rng.choice([-2.0, 2.0], size), 0.0)  # often in a corner
    found = descend(jacobian.T @ jacobian, jacobian.T @ wanted, start, low, high)
    slow = lsq_linear(jacobian, wanted, (low, high), method="bvls", tol=1e-14).x

    def loss(x):
        return np.sum((jacobian @ x - wanted) ** 2)

    assert np.all((found >= low) & (found <= high))
    assert loss(found) <= loss(slow) * (1.0 + 1e-6) + 1e-9


def test_a_coordinate_without_effect_stays_where_it_is():
    normal = np.diag([1.0, 0.0])
    found = descend(normal, np.array([0.5, 0.0]), np.array([0.0, 0.7]), -np.ones(2), np.ones(2))
    assert found == pytest.approx([0.5, 0.7])


@pytest.mark.parametrize("name", [*device_names(), "flexible"])
def test_the_repaired_device_has_the_row_of_the_fit(name):
    device = flexible() if name == "flexible" else load_device(name)
    plant = JointPlant.from_device(device)
    each = nuisances(plant)
    deviations = np.linspace(-1.0, 1.0, len(each))
    row = plant.parameters.copy()
    apply_all(row, each, deviations)
    assert JointPlant.from_device(repaired_device(device, each, deviations)).parameters == pytest.approx(row, rel=1e-12)


def test_numbers_that_are_zero_are_no_nuisance():
    names = [nuisance.name for nuisance in nuisances(JointPlant.from_device(flexible()))]
    assert names == [
        "link inertia", "link viscous friction", "motor 1 inertia", "motor 1 viscous friction", "spring 1 torque",
        "gravity torque",
    ]  # fmt: skip
