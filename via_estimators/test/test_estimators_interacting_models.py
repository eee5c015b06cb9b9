"""The mixture of Kalman filters against a slow one written from its equations, and on planted changes and noise."""

import numpy as np
import pytest
from via_estimators import interacting_models as models

N, PERIOD, MEMORY = 5, 0.1, 60.0  # scale of y, three coefficients, the trend
SCALE, FIRST, OWN = 0, 1, slice(1, 4)
G = np.array([0.0, 1.0, -0.5, 2.0, 0.0])
SPRING = np.diag([0.0, 1.0, 1.0, 1.0, 0.0])  # of the unknowns that change
FRICTION = np.array([0.0, 1.0, 0.0, 0.0, 0.0])  # the first one may also change alone


def padded(coefficients):
    """All N unknowns, or their regressors, with 0 for the scale and the trend."""
    return np.concatenate([[0.0], coefficients, [0.0]])


def slow(equations, steadiness, within, beside, wobble, memory=MEMORY):
    """Mean, covariance and probabilities after each equation (time, row, y, g); matrices, no views, no tricks."""
    K = models.MODELS
    prior = np.array([models._of_prior(j, steadiness) for j in range(K)])
    x, P = np.zeros((K, N)), np.tile(SPRING, (K, 1, 1))
    mu, noise, weight = prior.copy(), np.array(models.NOISES), np.full(K, models.KNOWN)
    mean, covariance, last, before = np.zeros(N), P[0].copy(), None, (np.zeros(N), 0.0)
    answers = []
    for time, row, y, g in equations:
        dt = 0.0 if last is None else time - last
        last, stay = time, np.exp(-(0.0 if last is None else dt) / memory)
        x_before, P_before, likely, c = x.copy(), P.copy(), np.empty(K), np.empty(K)
        for j in range(K):
            jumped, scaled = j >= models.JUMPING, models.GAINS[j] > 0.0
            level = models.JUMPING + j % len(models.LEVELS) + scaled * len(models.LEVELS)  # jump at this noise level
            same = np.array(models.GAINS) > 0.0 if scaled else np.array(models.GAINS) == 0.0
            stayed = 0.0 if jumped else stay * mu[j]
            after = stay * mu[level] * prior[j] * len(models.LEVELS) / prior[same].sum()
            c[j] = max(stayed + after + (1.0 - stay) * prior[j], models.NEVER)
            parts = [
                (stayed, x_before[j], P_before[j]), (after, x_before[level], P_before[level]),
                (c[j] - stayed - after, mean, covariance),
            ]  # fmt: skip
            x[j] = sum(p * each for p, each, _ in parts) / c[j]
            P[j] = sum(p * (C + np.outer(each - x[j], each - x[j])) for p, each, C in parts) / c[j]
            if jumped or not scaled:
                x[j][SCALE] = P[j][SCALE, :] = P[j][:, SCALE] = 0.0
            if models.TRENDS[j] == 0.0:
                x[j][-1] = P[j][-1, :] = P[j][:, -1] = 0.0
                lasted = 1.0 if jumped else dt
                added, gained = (min(each[j] ** 2 * lasted, models.FURTHEST) for each in (models.WALKS, models.GAINS))
                P[j][SCALE, SCALE] += gained
                P[j] += added * (np.outer(g, g) + models.SHAPE**2 * (g @ g) * SPRING)
                P[j] += min(models.WEARS[j] ** 2 * dt, models.FURTHEST) * np.diag(FRICTION)
            else:
                F, q = np.eye(N), models.TRENDS[j] ** 2
                F[:, -1] += models.PERSISTENCE * (1.0 - np.exp(-dt / models.PERSISTENCE)) * g
                F[-1, -1] = np.exp(-dt / models.PERSISTENCE)
                unit = np.eye(N)[-1]
                w = min(dt, models.PERSISTENCE, np.cbrt(3.0 * models.FURTHEST / q))
                Q = w**3 / 3.0 * np.outer(g, g) + 0.5 * w**2 * (np.outer(g, unit) + np.outer(unit, g))
                x[j], P[j] = F @ x[j], F @ P[j] @ F.T + q * (Q + w * np.outer(unit, unit))
            walk, gain = (each[j] ** 2 for each in (models.WALKS, models.GAINS))
            if jumped:
                walk, gain = (each / max(dt, wobble, models.NEVER) for each in (walk, gain))
            colour = j // len(models.LEVELS) == 1 and dt > 0.0
            r = np.exp(-dt / models.CORRELATION) if colour else 0.0
            own, unit = row - r * before[0], (1.0 - r**2) * within
            known = (1.0 + r**2) * (beside + within) if j // len(models.LEVELS) == 1 else beside
            changed = walk * (row @ g) ** 2 + models.WEARS[j] ** 2 * row**2 @ FRICTION + gain * row[SCALE] ** 2
            error = noise[j] * unit + known + wobble * changed
            S, nu = own @ P[j] @ own + error, y - r * before[1] - own @ x[j]
            likely[j] = np.log(c[j]) - 0.5 * (nu**2 / S + np.log(S))
            share = (noise[j] * unit / S) ** 2
            weight[j] = models.KNOWN + stay * (weight[j] - models.KNOWN) + share
            low = models.NOISES[j] / models.HALF_STEP if models.NOISES[j] > models.NOISES[0] else models.LEAST_NOISE
            high = models.NOISES[j] * models.HALF_STEP if models.NOISES[j] < models.NOISES[-1] else np.inf
            noise[j] = np.clip(noise[j] + (nu**2 - S) / unit * share / weight[j], low, high)
            gain = P[j] @ own / S
            x[j], P[j] = x[j] + gain * nu, P[j] - np.outer(gain, own @ P[j])
        before = row, y
        mu = np.exp(likely - likely.max())
        mu /= mu.sum()
        mean = mu @ x
        covariance = sum(p * (C + np.outer(each - mean, each - mean)) for p, C, each in zip(mu, P, x, strict=True))
        answers.append((mean, covariance, mu))
    return answers


def fast(equations, steadiness, within, beside, wobble, memory=MEMORY):
    state, work, answers = np.zeros(models.size(N)), models.scratch(N), []
    models.start(state, N, SCALE, steadiness)
    for time, row, y, g in equations:
        models.take(
            state, N, time, memory, steadiness, g, FIRST, FRICTION, SCALE, row.copy(), y, within, beside, wobble, work
        )
        mean, covariance = models.estimate_of(state, N)
        answers.append((mean.copy(), covariance.copy(), models.models_of(state)[models.MODEL.probability].copy()))
    return answers


def equations(count, noise, scale=lambda t: 1.0, seed=0, truth=0.5 * G):
    """Equations of the unknowns scale(t) * truth, one every PERIOD from 3 s on."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        t = 3.0 + PERIOD * k
        row = padded(rng.normal(size=3) + np.array([2.0, 0.0, 1.0]))
        found.append((t, row, scale(t - 3.0) * row @ truth + noise * rng.normal(), truth))
    return found


@pytest.mark.parametrize("steadiness", [0.5, 1.0])
def test_agrees_with_the_slow_version(steadiness):
    given = equations(60, 0.3, lambda t: 1.0 if t < 3.0 else 1.4)
    given = [*given[:30], *[(t + 5.0, *rest) for t, *rest in given[30:]]]  # with a gap
    for _, row, _, g in given:
        row[SCALE] = row @ g
    args = steadiness, 0.7, 0.01, 0.02
    for quick, sure in zip(fast(given, *args), slow(given, *args), strict=True):
        for a, b in zip(quick, sure, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)


def test_without_change_it_is_least_squares():
    """Steady and with noise as declared: the posterior of linear regression with the prior of unit variance."""
    given = equations(400, 1.0)
    mean, covariance, _ = fast(given, 1.0, 1.0, 0.0, 0.0)[-1]
    A, y = np.array([row[OWN] for _, row, _, _ in given]), np.array([y for _, _, y, _ in given])
    P = np.linalg.inv(A.T @ A + np.eye(3))
    assert np.all(np.abs(mean[OWN] - P @ A.T @ y) < np.sqrt(np.diag(P)))
    np.testing.assert_allclose(np.diag(covariance)[OWN], np.diag(P), rtol=0.1)


@pytest.mark.parametrize("noise", [0.03, 0.3, 3.0, 10.0])
def test_standard_sds_match_the_scatter_for_any_noise(noise):
    """The declared noise is 1; 60 runs of unknowns from the prior that do not change."""
    errors, variances = [], []
    for seed in range(60):
        truth = padded(np.random.default_rng(1000 + seed).normal(size=3))
        mean, covariance, _ = fast(equations(100, noise, seed=seed, truth=truth), 0.5, 1.0, 0.0, 0.0)[-1]
        errors.append(mean[OWN] - truth[OWN])
        variances.append(np.diag(covariance)[OWN])
    ratio = np.sqrt(np.mean(variances) / np.mean(np.square(errors)))
    assert 0.85 < ratio < 1.25


@pytest.mark.parametrize("memory", [0.15, 0.3, 0.6])
def test_coloured_noise_is_recognised_and_its_standard_sds_match_the_scatter(memory):
    """Gauss-Markov noise of other correlation times [s] than assumed; regressors that vary as slowly."""
    errors, variances, white, returning = [], [], [], []
    for seed in range(40):
        rng, keep = np.random.default_rng(seed), np.exp(-PERIOD / memory)
        truth = padded(np.random.default_rng(1000 + seed).normal(size=3))
        noise, regressors, given = 0.0, np.zeros(3), []
        for k in range(200):
            noise = keep * noise + np.sqrt(1.0 - keep**2) * 0.3 * rng.normal()
            regressors = keep * regressors + np.sqrt(1.0 - keep**2) * rng.normal(size=3)
            row = padded(regressors)
            given.append((PERIOD * k, row, row @ truth + noise, truth))
        state, work = np.zeros(models.size(N)), models.scratch(N)
        models.start(state, N, SCALE, 0.5)
        for time, row, y, g in given:
            models.take(state, N, time, MEMORY, 0.5, g, FIRST, FRICTION, SCALE, row.copy(), y, 1e-4, 0.0, 0.0, work)
        mean, covariance = models.estimate_of(state, N)
        errors.append(mean[OWN] - truth[OWN])
        variances.append(np.diag(covariance)[OWN])
        white.append(models.models_of(state)[models.MODEL.probability, : models.WHITE].sum())
        returning.append(models.returning(state, N))
    assert 0.8 < np.sqrt(np.mean(np.square(errors) / variances)) < 1.25
    assert np.median(white) < 0.05
    assert np.median(returning) > 10.0  # of 200 equations with three unknowns


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
    given = equations(200, 0.02, scale)
    inside, relative = [], []
    answers = fast(given, 0.5, 4e-4, 0.0, 0.0)
    for (t, *_), (mean, covariance, _) in list(zip(given, answers, strict=True))[20:]:
        error = mean[OWN] - 0.5 * scale(t - 3.0) * G[OWN]
        inside.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(covariance)[OWN]))
        relative.append(np.linalg.norm(error) / np.linalg.norm(0.5 * G))
    assert np.mean(inside) > 0.85
    assert np.median(relative) < 0.05
    steady = answers[-1][2][: len(models.LEVELS)].sum()
    assert steady < 0.05 if walks else steady > 0.8


def test_after_a_jump_the_scale_is_constant_again():
    """The interval shrinks as fast as after the first equations: a random walk would keep it wide."""
    given = equations(160, 0.1, lambda t: 1.0 if t < 10.0 else 1.5)
    answers = fast(given, 0.5, 0.01, 0.0, 0.01)
    mean, covariance, probability = answers[-1]
    assert np.abs(mean[OWN] - 0.75 * G[OWN]).max() < 0.3
    assert probability[: len(models.LEVELS)].sum() > 0.5
    assert np.trace(covariance) < 4.0 * np.trace(answers[90][1])  # twice the standard sds


@pytest.mark.parametrize("friction", [lambda t: 1.4 if t > 10.0 else 0.5, lambda t: 0.5 - 0.01 * t])
def test_a_change_of_friction_is_no_change_of_the_spring(friction):
    """The spring's unknowns, without the first one, keep their intervals and their values."""
    spring = padded([0.0, -0.5, 2.0])
    given = [
        (t, row, y + friction(t - 3.0) * row[FIRST], spring)
        for t, row, y, _ in equations(240, 0.05, seed=2, truth=spring)
    ]
    answers = fast(given, 0.5, 25e-4, 0.0, 0.0)
    errors = np.array([mean[OWN] - [friction(t - 3.0), *spring[2:4]] for (t, *_), (mean, *_) in zip(given, answers)])
    sds = np.sqrt([np.diag(covariance)[OWN] for _, covariance, _ in answers])
    assert np.mean(np.abs(errors[40:]) <= 1.96 * sds[40:]) > 0.9
    assert np.abs(errors[-1]).max() < 0.05 and sds[-1, 1:].max() < 0.03
    worn = np.array(models.WEARS) > 0.0
    assert max(found[worn].sum() for *_, found in answers) > 0.9


@pytest.mark.parametrize("scale", [lambda t: 1.4 if t > 10.0 else 1.0, lambda t: 1.0 - 0.02 * max(t - 8.0, 0.0)])
def test_a_change_of_the_scale_of_y_is_no_change_of_the_spring(scale):
    """The first unknown never changes alone, so it shows the scale. The spring, the others, seems to change as well."""
    direction, truth = padded([0.0, -0.25, 1.0]), 0.5 * G
    state, work, found = np.zeros(models.size(N)), models.scratch(N), []
    models.start(state, N, SCALE, 0.5)
    for t, row, y, _ in equations(240, 0.02, scale, seed=3):
        mean, covariance = models.estimate_of(state, N)
        known, s = row @ mean, 1.0 + mean[SCALE]
        row, y = s * row, y + (s - 1.0) * known
        row[SCALE] = known
        models.take(
            state, N, t, MEMORY, 0.5, direction, 2, np.zeros(N), SCALE, row, y, 4e-4, 0.0, 0.0, work,
        )  # fmt: skip
        found.append((1.0 + mean[SCALE] - scale(t - 3.0), *(mean - truth)[OWN], *np.sqrt(np.diag(covariance))[:4]))
    errors, sds = np.array(found)[20:, :4], np.array(found)[20:, 4:]
    assert np.mean(np.abs(errors) <= 1.96 * sds) > 0.85
    assert np.median(np.abs(errors)) < 0.02 and np.abs(errors[-1]).max() < 0.05
    scaled = np.array(models.GAINS) > 0.0
    assert models.models_of(state)[models.MODEL.probability][scaled].sum() > 0.9


def test_a_trend_is_learnt_and_continued():
    mean, covariance, _ = fast(equations(300, 0.01, lambda t: 1.0 + 0.05 * t), 0.5, 1e-4, 0.0, 0.0)[-1]
    assert mean[-1] == pytest.approx(0.05, abs=3.0 * np.sqrt(covariance[-1, -1]))
    assert mean[-1] > 2.0 * np.sqrt(covariance[-1, -1])


def test_probabilities_and_covariances_stay_sound_over_rests_and_outliers():
    rng = np.random.default_rng(4)
    state, work, time = np.zeros(models.size(N)), models.scratch(N), 0.0
    models.start(state, N, SCALE, 0.5)
    for k in range(3000):
        time += 1e4 if k % 500 == 0 else 0.1
        row, y = padded(rng.normal(size=3)), 1e6 if k % 300 == 0 else rng.normal()
        models.take(state, N, time, MEMORY, 0.5, G, FIRST, FRICTION, SCALE, row, y, 1.0, 0.0, 0.01, work)
        _, covariance = models.estimate_of(state, N)
        probability = models.models_of(state)[models.MODEL.probability]
        assert np.all(np.isfinite(state)) and probability.sum() == pytest.approx(1.0)
        assert np.linalg.eigvalsh(covariance)[0] > -1e-9 * np.trace(covariance)


def test_what_time_alone_can_add_is_bounded():
    state = np.zeros(models.size(N))
    models.start(state, N, SCALE, 0.0)
    walks, trends = (np.square(each[: models.JUMPING]) for each in (models.WALKS, models.TRENDS))  # a jump is over
    probability = models.models_of(state)[models.MODEL.probability, : models.JUMPING]
    assert models.wander(state, 0.5) == pytest.approx(probability @ (0.5 * walks + 0.5**3 / 3.0 * trends))
    assert models.wander(state, 1e9) == models.FURTHEST
