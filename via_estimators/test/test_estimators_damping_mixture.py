"""Damping with unknown friction, offset and order: closed forms, a slow filter bank, planted truths and coverage."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.status import Status
from via_estimators import damping_mixture, damping_models
from via_estimators.damping_mixture import DampingMixture
from via_estimators.damping_models import CHANGES, FILTER, FILTERS, OF_CHANGES, RATES, SHAPES, STRIBECK, U
from via_estimators.interacting_models import KNOWN, PERSISTENCE

VPDA = load_device("compact_vpda")
ESTIMATOR = DampingMixture.from_device(VPDA)
TABLE = ((1.5, 0.5, 0.0), (0.4, 1.3, 1.0))  # (velocity [rad/s], frequency [Hz], phase [rad]) of each tone
QUICK = ((0.8, 0.8, 0.0), (0.3, 2.1, 0.5))
WIDE = ((2.5, 0.3, 0.0), (0.7, 1.1, 2.0))


def motion(tones, t):
    q = sum(-a / (2.0 * np.pi * f) * np.cos(2.0 * np.pi * f * t + p) for a, f, p in tones)
    return q, sum(a * np.sin(2.0 * np.pi * f * t + p) for a, f, p in tones)


def of_80(t):
    return 1.0 + 1.4 * np.sin(0.05 * np.pi * t) ** 2 + 1.7 * np.sin(0.1 * np.pi * t) ** 2


def moved(
    tones=TABLE, *, damping=lambda t: 0.0 * t + 3.0, bend=0.0, stribeck=0.0, offset=0.0, delay=0.0, rate=1000.0,
    noise=0.05, bits=16, jitter=0.0, duration=12.0, seed=0,
):  # fmt: skip
    """Rows (N, 3) of time, angle and torque, and the true damping (N,) at the stamps."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    t = t + jitter / rate * rng.uniform(-0.5, 0.5, len(t))
    q, v = motion(tones, t)
    u = motion(tones, t - delay)[1]
    torque = damping(t - delay) * u + bend * u**3 / 3.0 + offset + noise * rng.normal(size=len(t))
    if stribeck:
        torque += np.sign(u) * (0.1 + 0.2 * np.exp(-((u / stribeck) ** 2)))
    quantum = 2.0 * np.pi / 2**bits if bits else 0.0
    q = quantum * np.rint(q / quantum) if bits else q
    return np.column_stack([t, q, torque]), damping(t) + bend * v**2


def error_and_coverage(rows, truth, estimator=ESTIMATOR):
    """Mean relative error after 1 s, and share of OK intervals that contain the truth."""
    estimates = estimator.run_rows(rows)[1]
    value, sd = estimates.column("damping")
    late, error = rows[:, 0] > 1.0, np.abs(value - truth)
    good = late & (estimates.status == Status.OK)
    assert good.sum() > 0.9 * late.sum()
    return np.mean(error[late] / truth[late]), np.mean(error[good] <= 1.96 * sd[good])


def state_after(rows):
    return ESTIMATOR.run_rows(rows)[0]


def test_friction_over_a_window_is_the_mean_over_a_gaussian():
    x = np.linspace(-9.0, 9.0, 40_001)
    weight = np.exp(-0.5 * x * x)
    weight /= weight.sum()
    for mean, width in ((0.0, 0.05), (0.03, 0.04), (-0.2, 0.05), (0.6, 0.1)):
        v, out = mean + width * x, np.empty((SHAPES, 2))
        damping_models.shapes(mean, width**2, out)

        def of(b, v=v):
            return weight @ (np.sign(v) * np.exp(-((v / b) ** 2)))

        assert out[0, 0] == pytest.approx(weight @ np.sign(v), abs=1e-3)
        for k, b in enumerate(STRIBECK):
            assert out[k + 1, 0] == pytest.approx(of(b), abs=1e-3)
            between = 0.5 * (of(b * damping_models.HALF_STEP) - of(b / damping_models.HALF_STEP))
            assert out[k + 1, 1] == pytest.approx(between, abs=1e-3)


class SlowBank:
    """The bank in matrix form, with Joseph's form of the correction."""

    def __init__(self, structures):
        self.structures = structures
        self.x = np.zeros((len(structures), RATES, U.size))
        self.P = np.zeros((len(structures), RATES, U.size, U.size))
        self.mu = np.zeros((len(structures), RATES))
        for s, structure in enumerate(structures):
            powers, kind = divmod(structure, SHAPES)
            live = [j for j in range(U.trend) if j not in (U.cubic, U.quintic) or j <= powers]
            live = [j for j in live if j not in (U.stribeck, U.between) or kind]
            self.P[s, :, live, live] = 1.0
            prior = damping_models.OF_POWERS[powers] * (
                damping_models.NONE if kind == 0 else (1.0 - damping_models.NONE) / len(STRIBECK)
            )
            self.mu[s] = prior * np.array(OF_CHANGES)
        self.noise, self.weight = np.ones_like(self.mu), np.full_like(self.mu, KNOWN)
        self.prior = self.mu.sum(1)

    def take(self, elapsed, memory, rows, y, noise, beside):
        """One step with the regressors `rows` (structures, n), scaled; `beside` as the kernel adds it."""
        stay, revised = np.exp(-elapsed / memory), np.exp(-elapsed / damping_models.REVISION)
        weights = np.zeros_like(self.mu)
        for s in range(len(self.structures)):
            whole = self.mu[s].sum()
            own = self.mu[s] / whole
            mean = own @ self.x[s]
            around = self.x[s] - mean
            P_mean = np.einsum("k,kij->ij", own, self.P[s] + np.einsum("ki,kj->kij", around, around))
            share = revised * whole + (1.0 - revised) * self.prior[s]
            for k, (walk, trend) in enumerate(CHANGES):
                now = stay * own[k] + (1.0 - stay) * OF_CHANGES[k]
                held = stay * own[k] / now
                x = held * self.x[s, k] + (1.0 - held) * mean
                one, other = self.x[s, k] - x, mean - x
                P = held * (self.P[s, k] + np.outer(one, one)) + (1.0 - held) * (P_mean + np.outer(other, other))
                live = np.diag(P)[: U.trend] > 0.0
                F, Q = np.eye(U.size), np.zeros((U.size, U.size))
                if trend == 0.0:
                    x[U.trend] = 0.0
                    P[U.trend, :] = P[:, U.trend] = 0.0
                else:
                    F[U.trend, U.trend] = np.exp(-elapsed / PERSISTENCE)
                    F[0, U.trend] = PERSISTENCE * (1.0 - F[U.trend, U.trend])
                    at = np.ix_([0, U.trend], [0, U.trend])
                    Q[at] = trend**2 * np.array([[elapsed**3 / 3, elapsed**2 / 2], [elapsed**2 / 2, elapsed]])
                Q[0, 0] += walk**2 * elapsed
                for j in range(1, U.trend):
                    Q[j, j] += damping_models.DRIFT**2 * elapsed * live[j]
                x, P = F @ x, F @ P @ F.T + Q
                error = self.noise[s, k] * noise + beside
                v, innovation = rows[s], y - rows[s] @ x
                S = v @ P @ v + error
                gain, left = P @ v / S, np.eye(U.size) - np.outer(P @ v / S, v)
                self.x[s, k], self.P[s, k] = x + gain * innovation, left @ P @ left.T + error * np.outer(gain, gain)
                part = (self.noise[s, k] * noise / S) ** 2
                self.weight[s, k] = KNOWN + stay * (self.weight[s, k] - KNOWN) + part
                self.noise[s, k] += (innovation**2 - S) / noise * part / self.weight[s, k]
                weights[s, k] = share * now / sqrt(S) * np.exp(-0.5 * innovation**2 / S)
        self.mu = weights / weights.sum()


def test_the_bank_equals_a_slow_one_in_matrix_form():
    rng = np.random.default_rng(5)
    state = np.zeros(damping_models.size())
    damping_models.start(state)
    slow = SlowBank(range(damping_models.STRUCTURES))
    scales, work, shape = rng.uniform(0.2, 2.0, U.size), damping_models.scratch(), np.empty((SHAPES, 2))
    for k in range(12):
        speed, noise = rng.normal(), 0.01
        damping_models.shapes(speed, 0.01, shape)
        v = np.zeros(U.size)
        v[[U.linear, U.cubic, U.quintic, U.offset, U.late]] = speed, speed**3, speed**5, 1.0, rng.normal()
        y = 2.0 * speed + 0.3 * np.sign(speed) + 0.1 * rng.normal()
        beside = (1.0 - shape[0, 0] ** 2) * damping_models._friction(state, scales)[1]
        damping_models.take(state, 0.03 * (k + 1), 5.0, scales, v, shape, y, noise, work)
        rows = np.tile(v, (damping_models.STRUCTURES, 1))
        for structure in range(damping_models.STRUCTURES):
            kind = structure % SHAPES
            rows[structure, U.coulomb] = shape[0, 0]
            rows[structure, [U.stribeck, U.between]] = shape[kind] if kind else 0.0
        slow.take(0.03 if k else 0.0, 5.0, rows * scales, y, noise, beside)
        x, P = damping_models._unknowns(state)
        filters = damping_models._filters(state)
        np.testing.assert_allclose(x.reshape(slow.x.shape), slow.x, atol=1e-7)
        np.testing.assert_allclose(P.reshape(slow.P.shape), slow.P, atol=1e-7)
        np.testing.assert_allclose(filters[FILTER.noise], slow.noise.ravel(), rtol=1e-6)
        np.testing.assert_allclose(filters[FILTER.probability], slow.mu.ravel(), atol=1e-7)
    mean, covariance = damping_models.estimate_of(state)
    mu = slow.mu.ravel()
    np.testing.assert_allclose(mean, mu @ slow.x.reshape(FILTERS, -1), atol=1e-7)
    around = slow.x.reshape(FILTERS, -1) - mean
    expected = np.einsum("k,kij->ij", mu, slow.P.reshape(FILTERS, U.size, U.size)) + around.T @ (mu[:, None] * around)
    np.testing.assert_allclose(covariance, expected, atol=1e-7)


def test_planted_coefficients_are_recovered():
    rows, _ = moved(damping=lambda t: 0.0 * t + 2.0, bend=0.9, stribeck=0.2, offset=0.1, noise=0.01, duration=20.0)
    found = ESTIMATOR.coefficients(state_after(rows))
    scale = ESTIMATOR.parameters.velocity_scale
    assert found[U.linear] == pytest.approx(2.0, abs=0.05)
    assert found[U.cubic] / scale**2 == pytest.approx(0.3, abs=0.05)
    assert found[U.coulomb] == pytest.approx(0.1, abs=0.03)
    assert found[U.offset] == pytest.approx(0.1, abs=0.003)
    state = state_after(rows).copy()
    share = damping_models._filters(damping_mixture._models(state))[FILTER.probability].reshape(3, SHAPES, RATES)
    near = [k + 1 for k, b in enumerate(STRIBECK) if 0.1 < b < 0.4]
    assert share[:, near].sum() > 0.9 and share[0].sum() < 0.01  # the order and the velocity are chosen by the data


def test_a_late_torque_is_an_unknown():
    rows, truth = moved(delay=0.005, stribeck=0.05)
    assert ESTIMATOR.coefficients(state_after(rows))[U.late] == pytest.approx(0.005, abs=0.001)
    error, covered = error_and_coverage(rows, truth)
    assert error < 0.02 and covered > 0.85


@pytest.mark.parametrize("damping", [lambda t: 0.0 * t + 2.0, of_80], ids=["constant", "eq. (80)"])
@pytest.mark.parametrize(
    ("tones", "settings"),
    [
        (TABLE, {}),
        (TABLE, {"stribeck": 0.02}),
        (TABLE, {"stribeck": 0.5}),
        (TABLE, {"bend": 0.9}),
        (TABLE, {"bend": 0.9, "stribeck": 0.5, "offset": 0.1}),
        (QUICK, {"stribeck": 0.2, "offset": 0.1}),
        (QUICK, {"bend": 0.9, "stribeck": 0.05, "rate": 500.0, "noise": 0.02}),
        (WIDE, {"stribeck": 0.3, "rate": 200.0, "bits": 14, "jitter": 0.6}),
        (WIDE, {"bend": 0.9, "offset": -0.1, "stribeck": 0.1, "rate": 500.0, "bits": 12}),
    ],
)
def test_error_and_coverage_hold_outside_the_table(damping, tones, settings):
    """Limits of the issue: mean error 5 %, coverage 85 %; each is the mean of three seeds."""
    found = [error_and_coverage(*moved(tones, damping=damping, seed=seed, **settings)) for seed in range(3)]
    error, covered = np.mean(found, axis=0)
    assert error < 0.05 and covered > 0.85


@pytest.mark.parametrize("rate", [0.25, 0.5])
def test_a_switched_damper_is_followed(rate):
    """Square wave of the command; what remains are the windows that contain a switch."""

    def damping(t):
        return np.where(np.sin(2.0 * np.pi * rate * t) > 0.0, 3.5, 1.2)

    found = [error_and_coverage(*moved(damping=damping, seed=seed)) for seed in range(3)]
    error, covered = np.mean(found, axis=0)
    assert error < 0.12 and covered > 0.85


def test_damping_is_that_at_the_velocity_and_time_of_the_sample():
    """Without noise; half a window of lag would be an error of 8 % where damping changes fastest with the velocity."""
    rows, truth = moved(damping=lambda t: 2.0 + 0.3 * np.sin(t), bend=0.9, noise=0.0, bits=0)
    value = ESTIMATOR.run_rows(rows)[1].value[:, 0]
    assert np.abs(value / truth - 1.0)[3000:].max() < 0.02


def test_a_jump_is_followed_and_its_interval_holds():
    rows, truth = moved(damping=lambda t: np.where(t < 3.3, 2.0, 4.0), duration=6.0)
    estimates = ESTIMATOR.run_rows(rows)[1]
    value, sd = estimates.column("damping")
    at = np.searchsorted(rows[:, 0], [3.2, 3.6])
    np.testing.assert_allclose(value[at], [2.0, 4.0], rtol=0.02)
    assert np.mean(np.abs(value - truth)[3300:4800] <= 1.96 * sd[3300:4800]) > 0.85


def test_the_noise_of_the_angle_is_measured_on_jittered_stamps():
    for noise in (1e-4, 1e-3):
        rows, _ = moved(bits=0, jitter=0.8, rate=500.0)
        rows[:, 1] += noise * np.random.default_rng(2).normal(size=len(rows))
        state = state_after(rows)
        found = sqrt(damping_mixture._latest(state.copy())[damping_mixture.LATEST.angle])
        assert found == pytest.approx(noise, rel=0.15)


def test_the_window_has_the_span_at_any_sampling_rate():
    for rate, samples in ((1000.0, 51), (500.0, 26), (200.0, 17), (5000.0, 101)):
        state = state_after(moved(rate=rate, duration=0.5)[0])
        assert damping_mixture._latest(state.copy())[damping_mixture.LATEST.length] == samples


def test_rest_widens_the_interval_to_the_prior_s_and_keeps_the_value():
    rows, _ = moved(duration=30.0)
    t = rows[:, 0]
    s = t - np.clip(t - 6.0, 0.0, 18.0)  # 18 s of rest
    q, v = motion(TABLE, s)
    still = (t > 6.0) & (t < 24.0)
    damping = np.where(t < 15.0, 3.0, 2.0)
    torque = np.where(still, 0.0, damping * v) + 0.05 * np.random.default_rng(1).normal(size=len(t))
    state, estimates = ESTIMATOR.run_rows(np.column_stack([t, q, torque]))
    value, sd = estimates.column("damping")
    assert np.all(estimates.status[6100:23_990] == Status.NOT_EXCITED)
    assert np.ptp(value[6100:23_990]) == 0.0 and np.all(np.diff(sd[6100:23_990]) >= 0.0)
    rested = 1.0 - np.exp(-(t[[8000, 12_000, 23_900]] - 6.0) / ESTIMATOR.parameters.rest_memory)
    assert sd[[8000, 12_000, 23_900]] / ESTIMATOR.parameters.damping_deviation == pytest.approx(
        np.sqrt(rested), abs=0.03
    )
    good = estimates.status == Status.OK
    late = good & (t > 24.0)
    assert np.mean(np.abs(value - damping)[late] <= 1.96 * sd[late]) > 0.85
    np.testing.assert_allclose(value[25_000:], 2.0, rtol=0.02)
    eigenvalues = np.linalg.eigvalsh(ESTIMATOR.covariance(state))
    assert eigenvalues[0] >= 0.0 and eigenvalues[-1] <= 2.0


def test_gaps_and_repeated_rest_keep_every_covariance_positive():
    rows, _ = moved(duration=8.0, stribeck=0.05)
    rows = rows[(rows[:, 0] % 2.0 > 0.3)]  # a gap every two seconds
    state = ESTIMATOR.init()
    for turn in range(15):
        state, estimates = ESTIMATOR.run_rows(rows + np.array([12.0 * turn, 0.0, 0.0]), state)
    P = damping_models._unknowns(damping_mixture._models(state.copy()))[1]
    assert np.linalg.eigvalsh(P).min() > -1e-12 and np.isfinite(state).all()
    assert np.abs(estimates.value[2000:, 0] / 3.0 - 1.0).max() < 0.05


def test_the_device_file_sets_priors():
    given = ESTIMATOR.parameters
    assert (given.damping_prior, given.damping_deviation) == (pytest.approx(2.55), pytest.approx(3.1))
    assert given.dry_friction == pytest.approx(0.41) and given.angle_noise == pytest.approx(9.587e-5 / sqrt(12.0))
    dry = VPDA.model_copy(update={"link": VPDA.link.model_copy(update={"coulomb_friction": 2.0})})
    assert DampingMixture.from_device(dry).parameters.dry_friction == 2.0
    other = ESTIMATOR.with_parameters(replace(given, window=200))
    assert other.parameters.window == 200 and np.isfinite(other.condition(other.init()))
