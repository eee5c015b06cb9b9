"""Principal components sample by sample: known covariances, gradients by differences, and printing errors."""

import numpy as np
import pytest
from scipy.linalg import eigh, sqrtm
from via_controllers.arms.principal_components import adapted

GAIN = 0.02


def turned(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two directions [deg]."""
    return float(np.degrees(np.arccos(min(1.0, abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b)))))


def learned(motion: np.ndarray, start: np.ndarray, gain: float = GAIN) -> np.ndarray:
    directions = start.copy()
    for sample in motion:
        directions = adapted(directions, gain, sample)
    return directions


def orthonormal(n: int, seed: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))[0]


def printed_step(w: np.ndarray, gain: float, motion: np.ndarray) -> np.ndarray:
    """(119) as printed: twice the preceding directions."""
    y = w.T @ motion
    steps = [y[i] * (motion - y[i] * w[:, i] - 2.0 * w[:, :i] @ y[:i]) for i in range(w.shape[1])]
    return w + gain * np.stack(steps, axis=1)


def gram_schmidt(w: np.ndarray, gain: float, motion: np.ndarray) -> np.ndarray:
    """(117), (118), then the two displayed formulas after them, with w_j from before."""
    y, out = w.T @ motion, np.empty_like(w)
    for i in range(w.shape[1]):
        moved = w[:, i] + gain * y[i] * (motion - y[i] * w[:, i])
        moved -= w[:, :i] @ (w[:, :i].T @ moved)
        out[:, i] = moved / np.linalg.norm(moved)
    return out


def test_it_finds_known_directions_in_their_order():
    """Covariance U diag(1, .3, .05, .01) U': two directions, of unit length, the most dominant first."""
    U, random = orthonormal(4, 1), np.random.default_rng(2)
    motion = random.normal(size=(20000, 4)) * np.sqrt([1.0, 0.3, 0.05, 0.01]) @ U.T
    found = learned(motion, orthonormal(4, 3)[:, :2], 2e-3)
    assert turned(found[:, 0], U[:, 0]) < 3.0 and turned(found[:, 1], U[:, 1]) < 5.0
    assert np.linalg.norm(found, axis=0) == pytest.approx([1.0, 1.0], abs=0.02)


def test_the_gradient_belongs_to_half_the_squared_error():
    """(116) is printed with a quarter, whose gradient is half of (118)."""
    w, motion, h = orthonormal(4, 4)[:, 0], np.array([0.3, -0.1, 0.2, 0.4]), 1e-6

    def error(share: float, direction: np.ndarray) -> float:
        return share * float(np.sum((motion - direction * (direction @ motion)) ** 2))

    y = w @ motion
    stated = -y * (motion - y * w)  # (118)
    across = [e - w * (w @ e) for e in np.eye(4)]  # where |w| stays 1
    for share, factor in ((0.5, 1.0), (0.25, 0.5)):
        slopes = [(error(share, w + h * e) - error(share, w - h * e)) / (2.0 * h) for e in across]
        assert slopes == pytest.approx([factor * stated @ e for e in across], abs=1e-9)
    step = adapted(w[:, None], GAIN, motion)[:, 0] - w
    assert step == pytest.approx(-GAIN * stated)


def test_the_factor_is_one_with_directions_from_before():
    """(119) is the limit gamma -> 0 of (117) with Gram-Schmidt; the printed factor two is not."""
    w, motion, gain = orthonormal(4, 5)[:, :3], np.array([0.3, -0.1, 0.2, 0.4]), 1e-6
    exact = (gram_schmidt(w, gain, motion) - w) / gain
    assert (adapted(w, gain, motion) - w) / gain == pytest.approx(exact, abs=1e-6)
    off = np.abs((printed_step(w, gain, motion) - w) / gain - exact).max()
    assert off > 0.01


def test_a_mean_is_no_motion():
    """Swings of .15 rad about q_0; an offset of .1 rad in each joint rotates the result from q itself."""
    w = np.array([0.2, 0.8, -0.1, 0.5]) / np.linalg.norm([0.2, 0.8, -0.1, 0.5])
    motion = 0.15 * np.sin(0.013 * np.arange(60000))[:, None] * w
    right, wrong = (learned(motion + offset, w[:, None], 0.05)[:, 0] for offset in (0.0, np.array([0.1, 0, -0.1, 0])))
    assert turned(right, w) < 0.1
    assert turned(wrong, w) > 30.0


def test_gamma_much_less_than_one_is_not_enough():
    """gamma = .1, but angles are large: the printed step loses the direction, the corrected one keeps it."""
    w, motion = np.array([1.0, 0.0]), np.array([9.0, 4.0])
    thrown = w
    for _ in range(4):
        thrown = thrown + 0.1 * (thrown @ motion) * (motion - (thrown @ motion) * thrown)
    assert np.linalg.norm(thrown) > 1e6
    kept = learned(np.tile(motion, (50, 1)), w[:, None], 0.1)[:, 0]
    assert turned(kept, motion) < 0.1 and np.linalg.norm(kept) == pytest.approx(1.0, abs=1e-3)


def test_components_are_modes_of_weighted_angles_only():
    """Two modes at once, (112): orthonormal in K^(1/2) q and M^(1/2) q; in plain q components are no modes."""
    M = np.array([[0.5, 0.3], [0.3, 0.3]])
    K = np.diag([40.0, 30.0])
    values, modes = eigh(K, M)
    time = 0.01 * np.arange(40_000)
    y = np.sin(np.sqrt(values) * time[:, None]) * [0.15, 0.3]
    q = y @ modes.T

    def worst(weight: np.ndarray) -> float:
        data = q @ weight
        wanted, found = weight @ modes, learned(data / np.abs(data).max(), np.eye(2), 0.01)
        return max(min(turned(found[:, i], wanted[:, j]) for j in range(2)) for i in range(2))

    assert worst(np.real(sqrtm(K))) < 1.0
    assert worst(np.real(sqrtm(M))) < 1.0
    assert worst(np.eye(2)) > 5.0
    alone = learned(np.outer(y[:, 0], modes[:, 0]), np.eye(2)[:, :1], 0.01)[:, 0]
    assert turned(alone, modes[:, 0]) < 0.5
