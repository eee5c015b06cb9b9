"""Standard deviations of least squares over overlapping windows: against the double sum, and against repetition."""

import numpy as np
import pytest
from via_core.weak_form import window_weights
from via_estimators import coloured
from via_estimators.qr import inverse_normal

H, N = 30, 3
R_COLOURS = coloured.colours(H, 5)
KERNEL = window_weights(5, np.linspace(0.0, 1.0, H + 1))[0]
WORK = coloured.scratch(N)


def folded(rows, y, keep=1.0, taken=None):
    """One equation's state after rows (k, n); where not `taken`, a step without a row."""
    state = np.zeros(coloured.size(N, H + 1))
    coloured.start(state, N)
    lagged = np.empty((3, H + 1))
    for k, row in enumerate(rows):
        slot = k % (H + 1)
        coloured.forget(state, N, keep, WORK)
        if taken is None or taken[k]:
            coloured.lags(coloured.mirrored(R_COLOURS), slot, keep, lagged)
            coloured.take(state, N, slot, row.copy(), y[k], lagged, WORK)
        else:
            coloured.skip(state, N, slot, H + 1)
    return state


def covariance_of(state, r, first, second, floor, out):
    """Noise found; the covariance of the unknowns into `out` (N, N), by one variance after the other."""
    found = coloured.noise(state, N, r, first, second, floor, WORK)
    coloured.blur(state, N, found, first, second, WORK)
    unit = np.eye(N)
    for i in range(N):
        for j in range(N):
            out[i, j] = 0.5 * coloured.variance(N, unit[i] + unit[j], WORK)
    own = np.array([coloured.variance_of(N, j, WORK) for j in range(N)])
    np.testing.assert_allclose(0.5 * np.diag(out), own, rtol=1e-12)
    out -= 0.5 * (own[:, None] + own)
    return found


def slow_middle(rows, weights, r):
    """sum_k sum_l w_k w_l F_k F_l' r_(k-l), term by term."""
    total = np.zeros((N, N))
    for k in range(len(rows)):
        for other in range(max(0, k - H), min(len(rows), k + H + 1)):
            total += weights[k] * weights[other] * r[abs(k - other)] * np.outer(rows[k], rows[other])
    return total


def test_the_middle_of_the_sandwich_is_the_double_sum():
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(80, N))
    taken = rng.random(80) > 0.2
    state = folded(rows, np.zeros(80), taken=taken)
    for colour, middle in enumerate(coloured.middles(state, N)):
        np.testing.assert_allclose(middle, slow_middle(rows, taken, R_COLOURS[colour]), rtol=1e-9, atol=1e-12)


def carried(rows, keep):
    """R'R times the error of x per unit of every raw noise sample (N, samples), step by step as forgetting has it."""
    total, errors = np.eye(N), np.zeros((N, len(rows) + H))
    for k, row in enumerate(rows):
        errors = (keep * np.eye(N) + (1.0 - keep) * np.linalg.inv(total)) @ errors
        total = keep * total + (1.0 - keep) * np.eye(N) + np.outer(row, row)
        errors[:, k : k + H + 1] += np.outer(row, KERNEL[::-1])
    return errors


@pytest.mark.parametrize("size", [1.0, 0.1, 0.02])
def test_forgetting_with_a_leak_preserves_the_noise_of_the_estimate(size):
    """Rows with much, little and almost no information in three directions; a memory of 500 samples."""
    t = np.arange(2000 + H) * 0.02
    raw = np.column_stack([np.sin(t), size * np.cos(2.3 * t), size * np.sin(3.7 * t + 1.0)])
    rows = np.column_stack([np.convolve(column, KERNEL, "valid") for column in raw.T])
    errors = carried(rows, 0.998)
    exact = errors @ errors.T
    middle = coloured.middles(folded(rows, np.zeros(len(rows)), 0.998), N)[0]
    np.testing.assert_allclose(np.diag(middle), np.diag(exact), rtol=0.1)
    if size < 0.1:  # forgotten like rows, noise of directions hardly excited would be a third of what it is
        weights = 0.998 ** np.arange(len(rows) - 1, -1, -1)
        assert np.diag(slow_middle(rows, weights, R_COLOURS[0]))[1] < 0.4 * exact[1, 1]


def test_colours_are_autocorrelations_of_the_kernels():
    lag = 7
    assert R_COLOURS[0, 0] == pytest.approx(KERNEL @ KERNEL)
    assert R_COLOURS[0, lag] == pytest.approx(KERNEL[:-lag] @ KERNEL[lag:])
    # white noise of unit variance keeps a unit long-run variance through a kernel of unit sum
    assert 2.0 * R_COLOURS[0].sum() - R_COLOURS[0, 0] == pytest.approx(1.0, abs=1e-9)


def test_correlated_torque_noise_has_the_autocorrelation_of_filtered_correlated_noise():
    rng, memory = np.random.default_rng(4), 4.0
    drive = rng.normal(size=400_000)
    rho = np.exp(-1.0 / memory)
    noise = np.empty_like(drive)
    noise[0] = drive[0]
    for k in range(1, len(drive)):
        noise[k] = rho * noise[k - 1] + np.sqrt(1.0 - rho * rho) * drive[k]
    e = np.convolve(noise, KERNEL, "valid")
    r = coloured.colours(H, 5, memory)[0]
    for lag in (0, 5, 15):
        assert e[lag:] @ e[: len(e) - lag] / len(e) == pytest.approx(r[lag], rel=0.05)


def noisy_problem(seed, count=600, sigma=0.7, truth=(1.0, -2.0, 0.5)):
    """Smooth rows, and y = F x + white noise through the kernel; scaled so that the noise declared is 1."""
    t = np.arange(count + H) * 0.02
    raw = np.column_stack([np.sin(t), np.cos(2.3 * t), np.sin(3.7 * t + 1.0)])
    rows = np.column_stack([np.convolve(column, KERNEL, "valid") for column in raw.T])
    noise = sigma * np.random.default_rng(seed).normal(size=count + H)
    return rows, rows @ np.array(truth) + np.convolve(noise, KERNEL, "valid")


def test_reported_standard_deviation_matches_the_empirical_one_and_the_naive_one_is_too_small():
    found, reported, naive, noises = [], [], [], []
    covariance = np.empty((N, N))
    for seed in range(100):
        rows, y = noisy_problem(seed)
        state = folded(rows, y)
        noises.append(covariance_of(state, R_COLOURS, 0.0, 0.0, 0.0, covariance))
        found.append(coloured.unknowns(state, N).copy())
        reported.append(np.sqrt(np.diag(covariance)))
        residual = y - rows @ found[-1]
        P = np.empty((N, N))
        inverse_normal(coloured.factor(state, N), np.empty((N, N)), P)
        naive.append(np.sqrt(np.diag(P) * (residual @ residual) / (len(y) - N)))
    seen = np.std(found, axis=0)
    np.testing.assert_allclose(np.mean(reported, axis=0) / seen, 1.0, atol=0.2)
    assert np.mean(noises) == pytest.approx(0.7**2, rel=0.1)
    assert np.all(np.mean(naive, axis=0) < 0.4 * seen)


def test_without_rows_the_state_returns_to_the_prior_and_stays_bounded():
    rows, y = noisy_problem(1)
    state = folded(rows, y, keep=0.99)
    x = coloured.unknowns(state, N).copy()
    covariance, sizes = np.empty((N, N)), []
    for _ in range(5000):
        coloured.forget(state, N, 0.99, WORK)
        coloured.skip(state, N, 0, H + 1)
        covariance_of(state, R_COLOURS, 0.0, 0.0, 0.0, covariance)
        sizes.append(np.trace(covariance))
    np.testing.assert_allclose(coloured.unknowns(state, N), x)
    # x stays, so what noise has made of it stays too, beside the prior
    assert np.all(np.diff(sizes) > -1e-9) and N <= sizes[-1] < N + 3.0 * sizes[0]
    np.testing.assert_allclose(coloured.factor(state, N), np.eye(N), atol=1e-9)


def test_a_constant_estimate_keeps_its_noise():
    rows, y = noisy_problem(1)
    state = folded(rows, y, keep=0.99)
    coloured.beliefs(state, N)[:] = 0.0
    before, after = np.empty((N, N)), np.empty((N, N))
    covariance_of(state, R_COLOURS, 0.0, 0.0, 1.0, before)
    for _ in range(2000):
        coloured.forget(state, N, 0.99, WORK)
        coloured.skip(state, N, 0, H + 1)
    covariance_of(state, R_COLOURS, 0.0, 0.0, 1.0, after)
    np.testing.assert_allclose(np.diag(after), np.diag(before), rtol=0.05)


def test_noise_is_at_least_its_lower_bound():
    rows, y = noisy_problem(1, sigma=0.1)
    state, covariance, wider = folded(rows, y), np.empty((N, N)), np.empty((N, N))
    assert covariance_of(state, R_COLOURS, 0.0, 0.0, 0.0, covariance) < 0.05
    assert covariance_of(state, R_COLOURS, 0.0, 0.0, 4.0, wider) == 4.0
    assert np.all(np.diag(wider) > 10.0 * np.diag(covariance))


@pytest.mark.parametrize("keep", [1.0, 0.995])
def test_the_residual_sum_excludes_the_prior(keep):
    rows, y = noisy_problem(5, truth=(4.0, -6.0, 2.0))
    state = folded(rows, y, keep)
    x, pulled = state[coloured.HEAD.size :][:N], state[coloured.HEAD.size :][2 * N : 3 * N]
    weights = keep ** np.arange(len(y) - 1, -1, -1)
    found = state[coloured.HEAD.misfit] - state[coloured.HEAD.scatter] - np.sum((x - pulled) ** 2)
    assert found == pytest.approx(weights @ (y - rows @ x) ** 2, rel=1e-9)


def test_noise_accounts_for_degrees_of_freedom_with_few_windows():
    """Three windows' worth of rows and three unknowns: without degrees of freedom, noise would be a third too small."""
    found, covariance = [], np.empty((N, N))
    for seed in range(150):
        rows, y = noisy_problem(seed, count=90, sigma=1.0)
        found.append(covariance_of(folded(10.0 * rows, y), R_COLOURS, 0.0, 0.0, 0.0, covariance))
    assert np.mean(found) == pytest.approx(1.0, rel=0.08)


def test_declared_position_noise_is_not_counted_as_torque_noise():
    bend, covariance, found, undeclared = window_weights(5, np.linspace(0.0, 1.0, H + 1))[2], np.empty((N, N)), [], []
    for seed in range(40):
        rows, y = noisy_problem(seed)
        y = y + 0.02 * np.convolve(np.random.default_rng(1000 + seed).normal(size=len(y) + H), bend, "valid")
        state = folded(rows, y)
        found.append(covariance_of(state, R_COLOURS, 0.0, 0.02**2, 0.0, covariance))
        undeclared.append(covariance_of(state, R_COLOURS, 0.0, 0.0, 0.0, covariance))
    assert np.mean(found) == pytest.approx(0.7**2, rel=0.25)
    assert np.mean(undeclared) > 2.0 * 0.7**2


@pytest.mark.parametrize("keep", [0.9, 0.1, 1e-4])
def test_one_large_step_of_forgetting_equals_many_small_ones(keep):
    """A gap is one step: A M A', A = lambda + (1 - lambda) P, without negative variances."""
    n, rng = 3, np.random.default_rng(5)
    state = np.zeros(coloured.size(n, 10))
    coloured.start(state, n)
    R = np.triu(rng.normal(size=(n, n))) + 2.0 * np.eye(n)
    coloured.factor(state, n)[:] = R
    roots = rng.normal(size=(3, n, 1))  # of rank one: any wrong term shows as a negative eigenvalue
    coloured.middles(state, n)[:] = roots @ roots.transpose(0, 2, 1)
    before = coloured.middles(state, n).copy()
    A = keep * np.eye(n) + (1.0 - keep) * np.linalg.inv(R.T @ R)
    coloured.forget(state, n, keep, coloured.scratch(n))
    after = coloured.middles(state, n)
    np.testing.assert_allclose(after, A @ before @ A, rtol=1e-10, atol=1e-12)
    assert np.linalg.eigvalsh(after).min() > -1e-12
