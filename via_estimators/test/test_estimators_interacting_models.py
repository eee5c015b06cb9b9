"""The mixture of Kalman filters against a slow one, and on planted changes, noise and failures."""

import numpy as np
import pytest
from via_estimators import interacting_models as models

N, M, PERIOD, MEMORY, SPAN = 8, 2, 0.1, 60.0, 0.2  # 2 + 2 coefficients, 2 unknowns of the last equation, 2 trends
G = np.zeros((M, N))
G[0, :2], G[1, 2:4] = (1.0, -0.5), (0.7, 2.0)
OWN, CHANNELS = (4, 6), 2
LEVELS = np.array(models.NOISES)


def mixture(parts):
    """Mean and covariance of weighted Gaussians (weight, mean, covariance)."""
    total = sum(w for w, _, _ in parts)
    mean = sum(w * x for w, x, _ in parts) / total
    return mean, sum(w * (P + np.outer(x - mean, x - mean)) for w, x, P in parts) / total


def slow(steps, steadiness):
    """Mean, covariance and probabilities after each step (time, equations); matrices, no views, no tricks."""
    K, jump = models.MODELS, models.JUMPING
    rho = np.array([models._of_prior(j, steadiness) for j in range(K)])
    fresh = np.array([[models.of_level(c, CHANNELS, k) for k in range(models.LEVELS)] for c in range(CHANNELS)])
    x, P, mu = np.zeros((K, N)), np.tile(np.diag([1.0] * (N - M) + [0.0] * M), (K, 1, 1)), rho.copy()
    w, fails = np.tile(fresh, (K, 1, 1)), np.zeros(K)
    mean, covariance, last, answers = np.zeros(N), P[0].copy(), None, []
    C = M / (M + 1.0) * (np.eye(M) + 1.0)
    along = sum(C[i, k] * np.outer(G[i], G[k]) for i in range(M) for k in range(M))
    for time, equations in steps:
        dt = 0.0 if last is None else time - last
        last, stay = time, np.exp(-dt / MEMORY)
        before = x.copy(), P.copy(), w.copy(), fails.copy(), np.einsum("j,jck->ck", mu, w), mu @ fails
        landed, wobble = mu[jump], np.zeros(K)
        for j in range(K):
            # jumps are mixed last: the others see the estimate of the jump before it is mixed
            weights = [stay * mu[j] if j != jump else 0.0, stay * landed * rho[j], (1.0 - stay) * rho[j]]
            c = max(sum(weights), models.NEVER)
            shares = np.array([weights[0] / c, weights[1] / c, 1.0 - (weights[0] + weights[1]) / c])
            parts = [(shares[0], before[0][j], before[1][j]), (shares[1], before[0][jump], before[1][jump])]
            x[j], P[j] = mixture([*parts, (shares[2], mean, covariance)])
            w[j] = stay * (shares[0] * before[2][j] + shares[1] * before[2][jump] + shares[2] * before[4])
            w[j] += (1.0 - stay) * fresh
            failed = shares @ [before[3][j], before[3][jump], before[5]]
            fails[j] = failed * models.LASTING + (1.0 - failed) * (1.0 - stay)
            walk, trend = models.WALKS[j] ** 2, models.TRENDS[j] ** 2
            if trend == 0.0:
                x[j][-M:] = P[j][-M:, :] = P[j][:, -M:] = 0.0
                P[j] += (models.JUMP**2 if j == jump else min(walk * dt, models.FURTHEST)) * along
            else:
                F, s = np.eye(N), min(dt, models.PERSISTENCE, np.cbrt(3.0 * models.FURTHEST / trend))
                F[:, -M:] += models.PERSISTENCE * (1.0 - np.exp(-dt / models.PERSISTENCE)) * G.T
                F[-M:, -M:] = np.exp(-dt / models.PERSISTENCE) * np.eye(M)
                E = np.eye(N)[:, -M:]
                Q = s**3 / 3.0 * along + s * E @ C @ E.T + 0.5 * s**2 * (G.T @ C @ E.T + E @ C @ G)
                x[j], P[j] = F @ x[j], F @ P[j] @ F.T + trend * Q
            if j == jump:
                walk = models.JUMP**2 / max(dt, models.WOBBLE * SPAN)
            wobble[j] = models.WOBBLE * SPAN * walk + models.BENDING * SPAN**3 * trend
            mu[j] = c
        for channel, row, y, within, beside, noisy, lasting, force in equations:
            for j in range(K):
                v, known = y - row @ x[j], row @ P[j] @ row + beside + wobble[j] * row @ along @ row
                S = known + LEVELS * within
                density = np.exp(-0.5 * v * v / S) / np.sqrt(S)
                holds = (1.0 - fails[j]) * w[j, channel] @ density if force else w[j, channel] @ density
                fails_now = fails[j] * np.exp(-0.5 * v * v / (known + force)) / np.sqrt(known + force) if force else 0.0
                mu[j] *= holds + fails_now
                f = fails_now / (holds + fails_now)
                posterior = w[j, channel] * density / (w[j, channel] @ density)
                w[j, channel] = (1.0 - f) * posterior + f * w[j, channel]
                share = w[j, channel] @ (np.minimum(LEVELS, 1.0) * within / S)
                denoised = row + v * share * noisy
                gain = P[j] @ denoised
                used = denoised @ gain + known - row @ P[j] @ row + LEVELS * within
                used += lasting * np.maximum(LEVELS - 1.0, 0.0) * within
                parts = [
                    (p, x[j] + gain * v / s, P[j] - np.outer(gain, gain) / s)
                    for p, s in zip(w[j, channel], used, strict=True)
                ]
                held = mixture([each for each in parts if each[0] > 0.0])
                if force:
                    fails[j] = f
                if f > models.NEGLIGIBLE:
                    reset, Q = x[j].copy(), P[j].copy()
                    reset[slice(*OWN)] = 0.0
                    Q[slice(*OWN), :], Q[:, slice(*OWN)] = 0.0, 0.0
                    Q[slice(*OWN), slice(*OWN)] = np.eye(OWN[1] - OWN[0])
                    held = mixture([(1.0 - f, *held), (f, reset, Q)])
                x[j], P[j] = held
            mu /= mu.sum()
        mean, covariance = mixture([(mu[j], x[j], P[j]) for j in range(K)])
        answers.append((mean, covariance, mu.copy()))
    return answers


def fast(steps, steadiness, memory=MEMORY):
    state, work, answers = np.zeros(models.size(N, CHANNELS)), models.scratch(N), []
    models.start(state, N, M, CHANNELS, steadiness)
    bank = models.bank_of(state, N, CHANNELS)
    for time, equations in steps:
        models.begin(bank, time, memory, steadiness, G, SPAN, work)
        for channel, row, y, within, beside, noisy, lasting, force in equations:
            own = OWN if force else (0, 0)
            models.take(bank, channel, row.copy(), y, within, beside, noisy, lasting, force, own, work)
        models.combine(bank)
        answers.append((bank.x[-1].copy(), bank.P[-1].copy(), bank.probability.copy()))
    return answers


NONE = np.zeros(N)
TRUTH = 0.5 * (G[0] + G[1]) + np.array([0.0, 0.0, 0.0, 0.0, 0.8, -0.3, 0.0, 0.0])


def steps(count, noise, scale=lambda t: 1.0, seed=0, link=lambda t: 0.0, precise=0.01, truth=TRUTH):
    """Two equations of channel 0 and one of channel 1 every PERIOD from 3 s on; `link` is a force in the latter."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        t, equations = PERIOD * k, []
        x = truth.copy()
        x[:4] *= scale(t)
        for i in range(M):
            row = np.zeros(N)
            row[2 * i : 2 * i + 2] = rng.normal(size=2) + 1.0
            equations.append((0, row, row @ x + noise * rng.normal(), 1.0, 0.0, NONE, 0.0, 0.0))
        row = np.append(rng.normal(size=N - M), np.zeros(M))
        y = row @ x + link(t) + precise * rng.normal()
        equations.append((1, row, y, precise**2, 0.0, NONE, 9.0, 4.0))
        found.append((3.0 + t, equations))
    return found


@pytest.mark.parametrize("steadiness", [0.5, 1.0])
def test_agrees_with_the_slow_version(steadiness):
    given = steps(60, 0.3, lambda t: 1.0 if t < 3.0 else 1.4, link=lambda t: 2.0 if 4.0 < t < 4.6 else 0.0)
    given = [*given[:30], *[(t + 5.0, rest) for t, rest in given[30:]]]  # with a gap
    noisy = np.append(0.01 * np.arange(N - M), np.zeros(M))
    given = [(t, [(*e[:4], 0.01, noisy if e[0] else NONE, *e[6:]) for e in rest]) for t, rest in given]
    for quick, sure in zip(fast(given, steadiness), slow(given, steadiness), strict=True):
        for a, b in zip(quick, sure, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-8)


def test_without_change_it_is_least_squares():
    """Steady and with noise as declared: the posterior of linear regression with the prior of unit variance."""
    given = [(t, equations[:M]) for t, equations in steps(400, 1.0)]
    mean, covariance, _ = fast(given, 1.0)[-1]
    A, y = (np.array([e[k] for _, rest in given for e in rest]) for k in (1, 2))
    P = np.linalg.inv(A[:, :4].T @ A[:, :4] + np.eye(4))
    assert np.all(np.abs(mean[:4] - P @ A[:, :4].T @ y) < np.sqrt(np.diag(P)))
    np.testing.assert_allclose(np.diag(covariance)[:4], np.diag(P), rtol=0.15)


@pytest.mark.parametrize("noise", [0.1, 0.45, 3.0, 10.0])
def test_standard_deviations_match_the_scatter_for_any_noise(noise):
    """The declared noise is 1; 40 runs of unknowns from the prior that do not change."""
    errors, variances = [], []
    for seed in range(40):
        truth = np.append(np.random.default_rng(1000 + seed).normal(size=N - M), np.zeros(M))
        given = [(t, equations[:M]) for t, equations in steps(100, noise, seed=seed, truth=truth)]
        mean, covariance, _ = fast(given, 0.5)[-1]
        errors.append(mean[:4] - truth[:4])
        variances.append(np.diag(covariance)[:4])
    assert 0.8 < np.sqrt(np.mean(variances) / np.mean(np.square(errors))) < 1.3


@pytest.mark.parametrize(
    ("scale", "walks"),
    [
        (lambda t: 1.0 + 0.01 * t, True),
        (lambda t: 1.0 + 0.3 * np.sin(np.pi * t), True),
        (lambda t: 1.0 if t < 10.0 else 1.5, False),
        (lambda t: 1.0, False),
    ],
)
def test_a_changing_scale_is_followed_within_its_intervals(scale, walks):
    given = steps(200, 0.02, scale)
    given = [(t, [(c, row, y, 4e-4 if c == 0 else s, *rest) for c, row, y, s, *rest in eqs]) for t, eqs in given]
    inside, answers = [], fast(given, 0.5)
    for (t, _), (mean, covariance, _) in list(zip(given, answers, strict=True))[20:]:
        error = mean[:4] - scale(t - 3.0) * TRUTH[:4]
        inside.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(covariance)[:4]))
    assert np.mean(inside) > 0.85
    steady = answers[-1][2][0]
    assert steady < 0.05 if walks else steady > 0.8


def test_a_precise_last_equation_is_used_and_a_force_in_it_does_not_harm():
    """A force as large as the rest of the equation, for 3 s: the springs stay within their intervals."""
    force = lambda t: 2.0 * np.sin(3.0 * t) if 8.0 < t < 11.0 else 0.0  # noqa: E731
    given = steps(200, 1.0, link=force)
    with_it, without = fast(given, 0.5), fast([(t, equations[:M]) for t, equations in given], 0.5)
    assert np.trace(with_it[79][1][:4, :4]) < 0.1 * np.trace(without[79][1][:4, :4])
    for k in (79, 95, 109, 199):
        mean, covariance, _ = with_it[k]
        assert np.all(np.abs(mean[:4] - TRUTH[:4]) < 3.0 * np.sqrt(np.diag(covariance)[:4])), k
    assert np.abs(with_it[199][0][4:6] - TRUTH[4:6]).max() < 0.1  # learnt anew after the force


def test_noise_of_the_row_does_not_make_the_unknowns_smaller():
    """A homogeneous equation whose first coefficient is noisy; motor equations alone determine the scale."""
    truth, off = np.append(np.zeros(2), [1.0, 0.6, 0.8, -0.5, 0.0, 0.0]), []
    for treated in (True, False):
        means = []
        for seed in range(20):
            rng, given = np.random.default_rng(seed), []
            for k in range(300):
                other = np.append(np.zeros(2), [*rng.normal(size=2), 0.0, rng.normal(), 0.0, 0.0])
                row = other.copy()
                row[4] = -(other @ truth) / truth[4] + 0.03 * rng.normal()
                motor = np.zeros(N)
                motor[2:4] = rng.normal(size=2)
                noisy = np.zeros(N)
                noisy[4] = 1.0 / truth[4] if treated else 0.0
                equations = [(0, motor, motor @ truth + 0.3 * rng.normal(), 0.09, 0.0, NONE, 0.0, 0.0)]
                equations.append((1, row, 0.0, (0.03 * truth[4]) ** 2, 0.0, noisy, 0.0, 0.0))
                given.append((3.0 + 0.1 * k, equations))
            means.append(fast(given, 1.0, 1e9)[-1][0][2] / truth[2])
        off.append(1.0 - np.mean(means))
    assert abs(off[0]) < 0.03 and off[1] > 0.05


def test_variances_within_a_window_are_those_of_w_55():
    u = np.linspace(0.0, 1.0, 1001)
    psi, t = u**5 * (1.0 - u) ** 5, np.abs(u - 0.5)
    psi /= psi.sum()
    side = np.sign(u - 0.5)[:, None] == np.sign(u - 0.5)[None, :]
    low, high = np.minimum.outer(t, t), np.maximum.outer(t, t)
    assert psi @ (side * low) @ psi == pytest.approx(models.WOBBLE, rel=0.02)
    assert psi @ (side * low**2 * (3.0 * high - low) / 6.0) @ psi == pytest.approx(models.BENDING, rel=0.02)


def test_a_change_of_one_spring_or_of_all_is_a_standard_deviation():
    C = np.array([[models._shared(i, k, 2) for k in range(2)] for i in range(2)])
    for change in ([1.0, 0.0], [0.0, 1.0], [1.0, 1.0]):
        assert np.array(change) @ np.linalg.solve(C, change) == pytest.approx(1.0)
    assert models._shared(0, 0, 1) == 1.0


def test_probabilities_and_covariances_stay_sound_over_rests_and_outliers():
    given = steps(1500, 1.0, seed=4)
    for k in range(0, 1500, 300):
        (channel, row, _, *rest), *others = given[k][1]
        given[k] = (given[k][0], [(channel, row, 1e6, *rest), *others])
    given = [(t + 1e4 * (t // 50.0), equations) for t, equations in given]
    for mean, covariance, probability in fast(given, 0.5):
        assert np.all(np.isfinite(mean)) and probability.sum() == pytest.approx(1.0)
        assert np.linalg.eigvalsh(covariance)[0] > -1e-9 * np.trace(covariance)


def test_what_time_alone_can_add_is_bounded():
    state = np.zeros(models.size(N, CHANNELS))
    models.start(state, N, M, CHANNELS, 0.0)
    bank = models.bank_of(state, N, CHANNELS)
    walks, trends = (np.square(each[1:]) for each in (models.WALKS, models.TRENDS))
    assert models.wander(bank, 0.5) == pytest.approx(np.mean(0.5 * walks + 0.5**3 / 3.0 * trends))
    assert models.wander(bank, 1e9) == models.FURTHEST
