"""Nuisance parameters: a bounded minimum that is one, and a repaired device whose rows are those of the fit."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from via_core.devices import Device, device_names, load_device
from via_gap.candidates.fit import fit_device_parameters
from via_gap.residual.nuisance import apply_all, descend, nuisances, repaired_device
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.selection.numbers import NUMBERS
from via_sim.effects import Effect
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
    known = device.tolerances.model_copy(update={"torque_scale": 0.05 if device.drive == "torque" else 0.0})
    device = device.model_copy(update={"tolerances": known})
    plant = JointPlant.from_device(device)
    each = nuisances(plant)
    assert [n.name for n in each if n.name == "torque scale"] == ["torque scale"] * (device.drive == "torque")
    offsets = np.linspace(-1.0, 1.0, len(each))
    row = plant.parameters.copy()
    apply_all(row, each, offsets)
    assert JointPlant.from_device(repaired_device(device, each, offsets)).parameters == pytest.approx(row, rel=1e-12)


def test_numbers_that_are_zero_are_no_nuisance():
    names = [nuisance.name for nuisance in nuisances(JointPlant.from_device(flexible()))]
    assert names == [
        "link inertia", "link viscous friction", "motor 1 inertia", "motor 1 viscous friction", "spring 1 torque",
        "spring 1 shape", "gravity torque",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["qbmove_a", "flexible"])
def test_a_spring_may_stiffen_otherwise_than_filed_within_the_tolerance_of_its_torque(name):
    device = flexible() if name == "flexible" else load_device(name)
    each = nuisances(JointPlant.from_device(device))
    offsets = np.array([float(n.name == "spring 1 shape") for n in each])
    filed, other = device.springs[0], repaired_device(device, each, offsets).springs[0]
    stop, tolerance = device.springs[0].max_deflection, device.tolerances.spring
    moved = np.array([other.torque(at * stop) / filed.torque(at * stop) - 1.0 for at in (0.1, 0.5, 1.0)])
    assert np.all(np.diff(moved) > 0.0) and 0.5 * tolerance < moved[-1] < 1.1 * tolerance


def test_a_spring_of_one_coefficient_has_no_shape_of_its_own():
    names = [n.name for n in nuisances(JointPlant.from_device(load_device("cubic_aa_vsa")))]
    assert "spring 1 torque" in names and "spring 1 shape" not in names


@pytest.mark.parametrize("kind", ["odd_polynomial", "sinh"])
def test_a_spring_that_stiffens_otherwise_than_filed_within_its_tolerance_leaves_noise(kind):
    """Coefficients off in opposite directions, or an exponent off: factors on the torque alone leave ten times it."""
    filed, other = {
        "odd_polynomial": ({"odd_coefficients": (1.0, 60.0)}, {"odd_coefficients": (1.02, 58.8)}),
        "sinh": ({"k": 0.4, "a": 6.0}, {"k": 0.4, "a": 6.06}),
    }[kind]
    device = flexible().model_dump(mode="python")
    spring = {"law": kind, "max_deflection": 0.7}
    device, true = (Device.model_validate(device | {"springs": [spring | numbers]}) for numbers in (filed, other))
    log = log_of(true, (), seed=2, duration=6.0, tolerance=0.0)
    segments = cut_log(replace(log, device=device))
    model = ResidualModel.of([segments], [np.arange(1, len(segments))])
    every = fit_device_parameters(model)
    torque = fit_device_parameters(replace(model, nuisances=tuple(n for n in model.nuisances if "shape" not in n.name)))
    assert model.per_segment(every.residual).mean() < NUMBERS.no_gap < model.per_segment(torque.residual).mean()


def test_a_slope_is_taken_on_the_side_where_the_effect_has_a_meaning():
    """Friction that is less by nearly all there is: a step down makes no joint."""
    segments = cut_log(log_of(rigid(), (), seed=3, duration=6.0, tolerance=0.0))
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    (friction,) = (k for k, each in enumerate(problem.nuisances) if each.name == "link viscous friction")
    here = np.zeros(len(problem.nuisances))
    here[friction] = 0.5
    there = problem.nuisances[friction].value * (1.0 + 0.5 * problem.nuisances[friction].tolerance)
    edge = [Effect("asymmetric_viscous", "link", {"forward": 0.05, "backward": -(there - 1e-5)}, 0)]
    more = here.copy()
    more[friction] += 0.01 / problem.nuisances[friction].tolerance
    before, after = problem.residual([problem.row(edge, here), problem.row(edge, more)])
    slope = problem.nuisance_jacobian(edge, here, before)[:, friction]
    np.testing.assert_allclose(slope, (after - before) / (more - here)[friction], rtol=1e-9, atol=1e-9)
    assert np.linalg.norm(slope) > 0.0
    less = 2.0 * here - more
    assert problem.row_or_none(edge, less) is None
    problem.fit_nuisances(edge, here)


def test_the_weights_of_a_robust_loss_are_its_slopes_and_their_squares_lie_above_it():
    """By finite differences over every value, and for steps of any size: lowering the squares lowers the loss."""
    segments = cut_log(log_of(rigid(), (), seed=3, duration=4.0, tolerance=0.0))
    plain = ResidualModel.of([segments], [np.arange(1, 8)])
    problem = replace(plain, robust=True)
    rng = np.random.default_rng(2)
    size = np.repeat([0.2, 0.7, 1.5, 4.0, 30.0, 0.9, 200.0], plain.size // 7)  # of noise and far above it
    at = size * rng.normal(size=plain.size)
    weights = problem.weights(at)
    for k in rng.choice(plain.size, 20, replace=False):
        step = np.zeros(plain.size)
        step[k] = 1e-5 * size[k]
        slope = (problem.loss(at + step) - problem.loss(at - step)) / (2.0 * step[k])
        assert slope == pytest.approx(2.0 * weights[k] ** 2 * at[k], rel=1e-4, abs=1e-6)
    for _ in range(50):
        other = at + 10.0 ** rng.uniform(-2.0, 1.0) * size * rng.normal(size=plain.size)
        gain = np.sum(weights**2 * (other**2 - at**2))
        assert problem.loss(other) - problem.loss(at) <= gain + 1e-9 * abs(gain)
    assert plain.loss(at) == pytest.approx(at @ at) and np.all(plain.weights(at) == 1.0)
    assert problem.by_squares.loss(at) == plain.loss(at) and plain.by_squares is plain
