"""Claims of Section 6.1 that do not hold: (82) tracks every smooth q_d, (93) is stable for all q."""

import numpy as np
import pytest
from via_controllers.arms.modal_transform import first_basis
from via_core.vsa_arms import load_vsa_arm

ARM = load_vsa_arm("reference_4dof")
REST, SWING = np.array([0.2, 0.4, 0.3, 1.2]), np.array([0.0, 0.0, 0.0, 1.0])
K = np.diag([100.0, 100.0, 60.0, 60.0])
XI, FAST = 0.01, 22.0  # [-], [rad/s] of q_d: about twice the softest mode's


def wanted(t: float, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q_d and its derivatives: an oscillation of the elbow."""
    return (
        REST + SWING * np.sin(rate * t),
        SWING * rate * np.cos(rate * t),
        -SWING * rate**2 * np.sin(rate * t),
    )


def damping(q: np.ndarray) -> np.ndarray:
    """D_d of (86)."""
    M = ARM.inertia(q)
    basis = first_basis(M, K)
    inverse = basis.W.T @ M
    return inverse.T @ np.diag(2.0 * XI * np.sqrt(basis.eigenvalues)) @ inverse


def largest_multiplier(rate: float, cancelled: bool, steps: int = 100) -> float:
    """Of (83) about q_d, u_q = 0, by Runge-Kutta over one period. `cancelled`: C qd as printed, else C qd_d."""
    h = 2.0 * np.pi / rate / steps

    def system(t):
        q, v, _ = wanted(t, rate)
        lossy = damping(q) + (0.0 if cancelled else ARM.coriolis(q, v))
        lower = -np.linalg.solve(ARM.inertia(q), np.hstack([K, lossy]))
        return np.vstack([np.eye(4, 8, 4), lower])

    at = [system(0.5 * k * h) for k in range(2 * steps + 1)]
    X = np.eye(8)
    for before, middle, after in zip(at[:-1:2], at[1::2], at[2::2], strict=True):
        k1 = before @ X
        k2 = middle @ (X + 0.5 * h * k1)
        k3 = middle @ (X + 0.5 * h * k2)
        k4 = after @ (X + h * k3)
        X = X + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return float(np.abs(np.linalg.eigvals(X)).max())


def test_a_fast_smooth_motion_is_not_tracked():
    """'Able to asymptotically track any smooth q_d' when u_q = 0: with C qd cancelled nothing compensates Mdot / 2."""
    assert largest_multiplier(FAST, cancelled=True) > 1.8
    assert largest_multiplier(6.0, cancelled=True) < 1.0


@pytest.mark.parametrize("rate", [6.0, 16.0, FAST, 26.0, 32.0])
def test_with_the_coriolis_term_of_the_error_it_is_tracked(rate):
    """C (qd - qd_d) in the error equation makes Mdot - 2 C skew-symmetric: every multiplier is below 1."""
    assert largest_multiplier(rate, cancelled=False) < 1.0


def test_the_arm_departs_from_the_motion():
    """The controller (82) on the arm's equation of motion, started a tenth of a milliradian from q_d."""
    steps, periods = 100, 6
    h = 2.0 * np.pi / FAST / steps

    def rate(t, x):
        q, v = x
        q_d, v_d, a_d = wanted(t, FAST)
        M = ARM.inertia(q)
        torque = ARM.coriolis(q, v) @ v + ARM.gravity(q) + M @ a_d - damping(q) @ (v - v_d) - K @ (q - q_d)
        return np.array([v, ARM.link_acceleration(q, v, torque)])

    x = np.array(wanted(0.0, FAST)[:2])
    x[0] += 1e-4
    errors = []
    for k in range(periods * steps):
        t = k * h
        if k % steps == 0:
            errors.append(np.abs(x[0] - wanted(t, FAST)[0]).max())
        k1 = rate(t, x)
        k2 = rate(t + 0.5 * h, x + 0.5 * h * k1)
        k3 = rate(t + 0.5 * h, x + 0.5 * h * k2)
        k4 = rate(t + h, x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    assert errors[-1] > 10.0 * errors[0]
    assert errors[-1] / errors[-2] == pytest.approx(largest_multiplier(FAST, cancelled=True), rel=0.05)


def constants_exist(xi: float, largest: float) -> bool:
    """Whether some c_1, c_2 of (94) make (96) positive definite for every lambda in [1, largest]."""
    values = np.geomspace(1.0, largest, 200)
    roots = np.sqrt(values)
    for c1 in np.linspace(0.0, 4.0 * xi, 82)[1:-1]:
        # (98): |lambda + c_1 xi sqrt(lambda) - c_2| < sqrt(c_1 lambda (4 xi sqrt(lambda) - c_1)), an interval of c_2
        half = np.sqrt(c1 * values * (4.0 * xi * roots - c1))
        middle = values + c1 * xi * roots
        if max((middle - half).max(), 0.25 * c1**2) < (middle + half).min():
            return True
    return False


def swinging_multiplier(xi: float, depth: float) -> float:
    """Multipliers of (93) with lambda = 1 + depth cos(2 t), over its period."""
    h, X = np.pi / 400, np.eye(2)

    def system(t):
        value = 1.0 + depth * np.cos(2.0 * t)
        return np.array([[0.0, 1.0], [-value, -2.0 * xi * np.sqrt(value)]])

    for k in range(400):
        before, middle, after = system(k * h), system((k + 0.5) * h), system((k + 1.0) * h)
        k1 = before @ X
        k2 = middle @ (X + 0.5 * h * k1)
        k3 = middle @ (X + 0.5 * h * k2)
        k4 = after @ (X + h * k3)
        X = X + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return float(np.abs(np.linalg.eigvals(X)).max())


def test_the_lyapunov_function_needs_a_small_variation_of_lambda():
    """(95)-(98) 'for all q': there are constants for a bounded variation, and none for a wide one."""
    assert constants_exist(0.1, 1.3) and constants_exist(0.7, 3.0)
    assert not constants_exist(0.1, 3.0) and not constants_exist(0.7, 100.0)
    assert not constants_exist(1e-9, 1.01)  # xi > 0, not >= 0


def test_a_damped_mode_can_be_unstable():
    """Not only the proof fails: xi > 0, lambda > 0, and the motion grows; a bounded variation is stable."""
    assert swinging_multiplier(0.1, 0.8) > 1.1 and not constants_exist(0.1, 1.8 / 0.2)
    assert swinging_multiplier(0.1, 0.1) < 1.0 and constants_exist(0.1, 1.1 / 0.9)
