"""Modal coordinates: closed-form rates against finite differences, and mode numbers through crossings."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from via_controllers.arms.modal_transform import ModalBasis, first_basis, next_basis, rates_along, second_along
from via_core.vsa_arms import load_vsa_arm

ARM = load_vsa_arm("reference_4dof")
K = np.diag([100.0, 100.0, 60.0, 60.0])
H = 1e-5  # [s] of the finite differences


def path(seed: int):
    """A smooth q(t) with its rate and acceleration at t = 0."""
    random = np.random.default_rng(seed)
    q, v, a = random.uniform([-1.0, -1.0, -1.0, 0.2], [1.0, 1.0, 1.0, 2.2]), *random.uniform(-2.0, 2.0, (2, 4))
    return lambda t: q + v * t + 0.5 * a * t * t, q, v, a


def apart(basis: ModalBasis) -> bool:
    """Whether vectors turn slowly enough for differences over 2 H to be accurate to a millionth."""
    return bool(np.diff(np.sort(basis.eigenvalues)).min() > 30.0)


def inertia_second(q, v, a):
    """Mdd along q + v t + a t^2 / 2, differenced from exact Mdot along the motion."""
    ahead, behind = (ARM.inertia_rate(q + s * v + 0.5 * s * s * a, v + s * a) for s in (H, -H))
    return (ahead - behind) / (2.0 * H)


def test_basis_solves_the_generalized_eigenvalue_problem():
    M = ARM.inertia(np.array([0.2, 0.4, 0.3, 1.2]))
    basis = first_basis(M, K)
    assert_allclose(basis.W.T @ M @ basis.W, np.eye(4), atol=1e-12)
    assert_allclose(basis.W.T @ K @ basis.W, np.diag(basis.eigenvalues), atol=1e-9)
    assert np.all(np.diff(basis.eigenvalues) > 0.0)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 9999))
def test_rates_are_the_finite_differences(seed):
    at, q, v, _ = path(seed)
    basis = first_basis(ARM.inertia(q), K)
    assume(apart(basis))
    A, eigenvalue_rates = rates_along(basis.W, basis.eigenvalues, ARM.inertia_rate(q, v))
    ahead, behind = (next_basis(basis, ARM.inertia(at(s)), K) for s in (H, -H))
    Wdot = (ahead.W - behind.W) / (2.0 * H)
    ldot = (ahead.eigenvalues - behind.eigenvalues) / (2.0 * H)
    assert np.abs(basis.W @ A - Wdot).max() < 1e-6 * max(1.0, np.abs(Wdot).max())
    assert np.abs(eigenvalue_rates - ldot).max() < 1e-6 * max(1.0, np.abs(ldot).max())


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 9999))
def test_second_derivative_is_the_finite_difference_of_the_first(seed):
    at, q, v, a = path(seed)
    basis = first_basis(ARM.inertia(q), K)
    assume(apart(basis))
    second = basis.W @ second_along(basis.W, basis.eigenvalues, ARM.inertia_rate(q, v), inertia_second(q, v, a))
    first = []
    for s in (H, -H):
        there = next_basis(basis, ARM.inertia(at(s)), K)
        first.append(there.W @ rates_along(there.W, there.eigenvalues, ARM.inertia_rate(at(s), v + s * a))[0])
    slow = (first[0] - first[1]) / (2.0 * H)
    assert np.abs(second - slow).max() < 1e-6 * max(1.0, np.abs(slow).max())


def crossing(t: float, coupling: float = 0.0) -> np.ndarray:
    """M(t) whose modes (0, 1) and 2 exchange places at t = 0; `coupling` keeps them apart."""
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    block = np.diag([1.0 + 0.5 * t, 3.0, 1.0 - 0.5 * t])
    block[0, 2] = block[2, 0] = coupling
    return turn @ block @ turn.T


def walk(coupling: float, printed_order: bool = False) -> tuple[list[ModalBasis], float]:
    """Bases along t = -1 .. 1 in 2001 steps (one of them at the crossing), and the largest step of W."""
    times = np.linspace(-1.0, 1.0, 2001)
    bases = [first_basis(crossing(times[0], coupling), np.eye(3))]
    for t in times[1:]:
        M = crossing(t, coupling)
        bases.append(first_basis(M, np.eye(3)) if printed_order else next_basis(bases[-1], M, np.eye(3)))
    return bases, max(np.abs(b.W - a.W).max() for a, b in pairwise(bases))


def test_a_true_crossing_passes_smoothly():
    bases, largest = walk(0.0)
    assert largest < 0.02
    assert bases[0].eigenvalues == pytest.approx([1.0 / 3.0, 2.0 / 3.0, 2.0])
    assert bases[-1].eigenvalues == pytest.approx([1.0 / 3.0, 2.0, 2.0 / 3.0])


def test_sorting_by_eigenvalue_jumps_at_a_true_crossing():
    assert walk(0.0, printed_order=True)[1] > 0.5


def test_modes_rotate_through_a_resolved_near_crossing():
    """Modes that repel each other exchange their directions, not their order."""
    bases, largest = walk(0.05)
    assert largest < 0.02
    assert np.argsort(bases[0].eigenvalues).tolist() == np.argsort(bases[-1].eigenvalues).tolist()


def test_equal_eigenvalues_keep_the_previous_basis():
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    found = next_basis(ModalBasis(turn, np.ones(3)), np.eye(3), np.eye(3))
    assert_allclose(found.W.T @ found.W, np.eye(3), atol=1e-12)
    pair = ModalBasis(np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 1.0, 2.0]))
    assert_allclose(next_basis(pair, np.eye(3), np.diag([1.0, 1.0, 2.0])).W, pair.W, atol=1e-12)


def test_rates_stay_finite_where_eigenvalues_agree():
    basis = ModalBasis(np.eye(3), np.ones(3))
    Mdot = np.array([[0.1, 0.2, 0.0], [0.2, 0.3, 0.1], [0.0, 0.1, 0.0]])
    assert_allclose(rates_along(basis.W, basis.eigenvalues, Mdot)[0], -0.5 * Mdot)
    assert np.isfinite(second_along(basis.W, basis.eigenvalues, Mdot, Mdot)).all()
