"""The signal-based estimator: known truths, the moving base, rest, standard errors, and the printed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from scipy.linalg import toeplitz
from via_core.devices import load_device
from via_core.status import Status
from via_estimators import integral
from via_estimators.integrated_equation import KEPT, first_omitted
from via_estimators.signal_based import SignalBased, SignalBasedParameters

INERTIA, DAMPING = 0.02, 0.3
ONE = SignalBasedParameters(
    transmissions=1, basis="odd_powers", terms=2, memory=1e9, torque_noise=1e-3, position_noise=0.0, truncation=0.0,
    window=60,
)  # fmt: skip


def integral_rows(record):
    """Rows (N, 5) for (c, B, D, a_1, a_2) and right sides (N,) of the integrated equation; basis phi, phi^3 / 3."""
    time, q, theta, theta_velocity, tau = record.T
    phi, step = q - theta, np.diff(time)
    f = np.column_stack([phi, phi**3 / 3.0])
    integrals = np.vstack([np.zeros(2), np.cumsum(0.5 * step[:, None] * (f[1:] + f[:-1]), axis=0)])
    right = np.concatenate([[0.0], np.cumsum(step * tau[1:])])
    return np.column_stack([np.ones(len(time)), theta_velocity, theta - theta[0], -integrals]), right


def planted(count=4000, period=1e-3, stop=np.inf):
    """Rows (count, 5) of time, q, theta, theta velocity, effort of one motor; spring law 8 phi + 5 phi^3; stiffness.

    From `stop` [s] on it slows down and stands still, held by the torque of its spring.
    """
    t = period * np.arange(count)

    def motion(t):
        u = np.minimum(t, stop + 0.2 * (1.0 - np.exp(-np.maximum(t - stop, 0.0) / 0.2)))  # its own clock
        rush = np.where(t > stop, np.exp(-np.maximum(t - stop, 0.0) / 0.2), 1.0)
        slow = np.where(t > stop, -rush / 0.2, 0.0)
        theta = 0.3 * np.sin(7.0 * u) + 0.2 * np.sin(13.0 * u + 1.0)
        rate = 2.1 * np.cos(7.0 * u) + 2.6 * np.cos(13.0 * u + 1.0)
        bend = -14.7 * np.sin(7.0 * u) - 33.8 * np.sin(13.0 * u + 1.0)
        q = 0.5 * np.sin(4.0 * u)
        torque = INERTIA * (bend * rush**2 + rate * slow) + DAMPING * rate * rush
        return q, theta, rate * rush, torque - 8.0 * (q - theta) - 5.0 * (q - theta) ** 3

    q, theta, rate, _ = motion(t)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    effort = sum(0.5 * w * motion(t + 0.5 * period * (node - 1.0))[3] for node, w in zip(nodes, weights, strict=True))
    return np.column_stack([t, q, theta, rate, effort]), 8.0 + 15.0 * (q - theta) ** 2


@pytest.mark.parametrize("basis", ["powers", "odd_powers", "legendre", "odd_legendre"])
def test_parameters_are_recovered(basis):
    rows, truth = planted()
    _, estimates = SignalBased(replace(ONE, basis=basis, terms=4)).run_rows(rows)
    converged = (estimates.status == Status.OK) & (rows[:, 0] > 1.0)
    assert converged.mean() > 0.6
    assert np.abs(estimates.value[:, 0] / truth - 1.0)[converged].max() < 2e-3
    assert estimates.column("motor_inertia_1")[0][-1] == pytest.approx(INERTIA, rel=1e-3)
    assert estimates.column("motor_damping_1")[0][-1] == pytest.approx(DAMPING, rel=1e-3)


def test_the_moving_base_is_least_squares_from_a_fixed_one():
    """Reference: all rows from one fixed base, weighted, with the prior, by the normal equations."""
    rows, _ = planted(800)
    parameters = replace(ONE, memory=0.5, horizon=1e9, torque_noise=1.0, stiffness_deviation=1.0, minimum_motion=0.0)
    estimator = SignalBased(parameters)
    state, estimates = estimator.run_rows(rows)
    used = rows[parameters.window :]
    columns, right = integral_rows(used)
    widths = np.array([1.0, parameters.inertia_deviation, parameters.damping_deviation, 1.0, 1.0])
    scaled = columns * widths / (1.0 * 1e-3 * np.sqrt(60.0))
    weights = np.exp(-1e-3 / 0.5) ** np.arange(len(used) - 1, -1, -1)
    # the leak pulls towards the estimates along the way; run it in the same order, from the fixed base
    keep, A, b, x = np.exp(-1e-3 / 0.5), np.diag([1e-18, 1.0, 1.0, 1.0, 1.0]), np.zeros(5), np.zeros(5)
    pull = np.diag([0.0, 1.0, 1.0, 1.0, 1.0])
    for row, y in zip(scaled, right / (1e-3 * np.sqrt(60.0)), strict=True):
        A = keep * A + (1.0 - keep) * pull + np.outer(row, row)
        b = keep * b + (1.0 - keep) * pull @ x + y * row
        x = np.linalg.solve(A, b)
    np.testing.assert_allclose(estimates.value[-1, 2:], (x * widths)[1:3], rtol=1e-5)
    equation = state[len(state) - integral.size(5, 1, 0) :]
    np.testing.assert_allclose(integral.unknowns(equation, 5)[1:], x[1:], rtol=1e-5)
    assert weights[0] < 0.5  # forgetting had something to do
    # and the factor: R'R of the moving base is S'AS for a constant's column moved by what the integrals grew
    R = integral.factor(equation, 5)[:5, :5]
    moved = np.eye(5)
    moved[0, 2:] = -scaled[-1, 2:] / scaled[-1, 0]
    units = np.diag([1.0 / scaled[-1, 0], 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(R.T @ R, units @ moved.T @ A @ moved @ units, rtol=1e-6, atol=1e-6 * np.abs(A).max())


def test_small_steps_of_forgetting_are_accumulated():
    state, work = np.zeros(integral.size(4, 0, 0)), np.empty((5, 4))
    integral.start(state, 4, 0, 0)
    state[integral.HEAD.weight] = 1.0
    seen = []
    for _ in range(1000):
        integral.forget(state, 4, 1.0 - 1e-8, work)
        seen.append(state[integral.HEAD.weight])
    np.testing.assert_allclose(seen, (1.0 - 1e-8) ** np.arange(1, 1001), rtol=1.1e-6)
    assert 8 <= len(set(seen)) <= 12  # a millionth at a time
    assert seen[-1] * state[integral.HEAD.pending] == pytest.approx((1.0 - 1e-8) ** 1000, rel=1e-12)


def variance_of(equation, n, slope, torque, velocity, prior):
    inverted = np.empty((n, n))
    integral.inverse(equation, n, inverted)
    found = np.empty(1)
    integral.variances(equation, n, slope[None, :], torque, velocity, prior, inverted, np.empty((n + 2, n)), found)
    return found[0]


SWINGING = np.array([[0.3, 1.0, 1.0], [0.2, 0.8, -0.3], [0.1, 0.3, 0.8]])  # [[r_0, C], [B, A]]


@pytest.mark.parametrize("colour", [np.ones((1, 1)), SWINGING])
def test_eliminating_the_constant_preserves_the_other_unknowns(colour):
    rng, poles = np.random.default_rng(5), len(colour) - 1
    n, state = 4, np.zeros(integral.size(4, 0, poles))
    integral.start(state, n, 0, poles)
    for _ in range(30):
        row = np.concatenate([[1.0], rng.normal(size=3)])
        moved = np.concatenate([[0.0], rng.normal(size=3)])
        integral.rebase(state, n, moved, rng.normal(), 0.1, colour, np.empty((2, n)))
        integral.take(state, n, row, rng.normal())
    x = integral.unknowns(state, n).copy()
    slope = np.array([0.0, 0.3, -1.0, 0.5])
    velocity = 0.7 if poles == 0 else 0.0  # smoothed velocities have no noise of their own
    before = variance_of(state, n, slope, 1.3, velocity, np.full(n, 0.6))
    integral.eliminate(state, n)
    assert variance_of(state, n, slope, 1.3, velocity, np.full(n, 0.6)) == pytest.approx(before, rel=1e-9)
    integral.take(state, n, np.array([1.0, 0.0, 0.0, 0.0]), 5.0)  # a row that determines only the new constant
    np.testing.assert_allclose(integral.unknowns(state, n), [5.0, *x[1:]], rtol=1e-9)


@pytest.mark.parametrize("colour", [np.ones((1, 1)), SWINGING])
def test_variance_is_the_sum_over_single_torque_errors(colour):
    """h'Gh with h by unit errors, one at a time, and G the noise's covariance; integrals of 17 steps."""
    steps, n, poles = 60, 4, len(colour) - 1

    def run(wrong):
        rng, state = np.random.default_rng(8), np.zeros(integral.size(n, 0, poles))
        integral.start(state, n, 0, poles)
        for k in range(steps):
            if k and k % 17 == 0:
                integral.eliminate(state, n)
            integral.take(state, n, np.concatenate([[1.0], rng.normal(size=n - 1)]), 0.0)
            moved = np.concatenate([[0.0], rng.normal(size=n - 1)])
            integral.rebase(state, n, moved, 0.1 * (k == wrong), 0.1, colour, np.empty((2, n)))
        integral.take(state, n, np.ones(n), 0.0)
        return state

    slope = np.array([0.0, 0.3, -1.0, 0.5])
    h = np.array([slope @ integral.unknowns(run(k), n) for k in range(steps)])
    r = [colour[0, 0]] + [colour[0, 1:] @ np.linalg.matrix_power(colour[1:, 1:], d) @ colour[1:, 0] for d in range(59)]
    found = variance_of(run(-1), n, slope, 1.0, 0.0, np.zeros(n))
    assert found == pytest.approx(h @ toeplitz(r) @ h, rel=1e-9)


def test_errata_36_a_base_in_motion_needs_the_constant():
    """A record that begins in motion: with the constant fixed at 0, as printed, the estimate is wrong."""
    rows, truth = planted()
    late = rows[300:]
    estimator = SignalBased(replace(ONE, horizon=1e9))
    value = estimator.run_rows(late)[1].value[:, 0]
    columns, right = integral_rows(late[:1000])
    printed = np.linalg.lstsq(np.column_stack([columns[:, 1], late[:1000, 2], columns[:, 3:]]), right, rcond=None)[0]
    phi = late[:1000, 1] - late[:1000, 2]
    wrong = np.column_stack([np.ones_like(phi), phi**2]) @ printed[2:]
    assert np.mean((wrong - truth[300:1300]) ** 2) > 100.0 * np.mean((value - truth[300:])[700:1000] ** 2)


def test_standard_deviations_match_empirical_ones():
    """Reported over empirical on 60 seeds: stiffness, inertia, damping; torque noise, and velocity noise beside it."""
    clean, truth = planted(3000)
    right = np.column_stack([truth, truth, np.full_like(truth, INERTIA), np.full_like(truth, DAMPING)])
    for torque, velocity, memory in ((0.05, 0.0, 1e9), (0.05, 0.0, 0.5), (0.01, 0.01, 2.0)):
        estimator = SignalBased(replace(ONE, torque_noise=torque, velocity_noise=velocity, memory=memory, horizon=0.5))
        errors, promised = [], []
        for seed in range(60):
            rng, rows = np.random.default_rng(seed), clean.copy()
            rows[:, 4] += torque * rng.normal(size=len(rows))
            rows[:, 3] += velocity * rng.normal(size=len(rows))
            _, estimates = estimator.run_rows(rows)
            errors.append((estimates.value - right)[1000::40])
            promised.append(estimates.standard_deviation[1000::40])
        ratio = np.sqrt(np.mean(np.square(promised), axis=(0, 1)) / np.mean(np.square(errors), axis=(0, 1)))
        assert np.all((ratio >= 0.8) & (ratio <= 1.25)), (torque, velocity, memory, ratio)


@pytest.mark.parametrize("forgetting", [0.98, 0.995])
def test_seven_seconds_at_rest_do_not_change_the_estimate(forgetting):
    """Rows at rest are left out; the leak keeps the estimate, and its variance is at most the prior's."""
    rows, truth = planted(11000, stop=3.0)
    rows[:, 4] += 1e-4 * np.random.default_rng(2).normal(size=len(rows))
    parameters = replace(ONE, memory=-1e-3 / np.log(forgetting), torque_noise=1e-4)
    _, estimates = SignalBased(parameters).run_rows(rows)
    held = rows[:, 0] > 4.5
    assert np.abs(estimates.value[held, 0] - truth[held]).max() < 1.0
    assert np.all(estimates.status[rows[:, 0] > 5.0] == Status.NOT_EXCITED)
    assert np.all(estimates.standard_deviation[:, 2] <= 1.5 * parameters.inertia_deviation)
    assert np.all(estimates.standard_deviation[:, 3] <= 1.5 * parameters.damping_deviation)


def test_the_state_stays_bounded_over_a_day_of_motion():
    """Continuous rotation: integrals, angles and time grow, the state does not; 24 h in steps."""
    t = 1e-2 * np.arange(2000)
    theta, rate = 3.0 * t + 0.3 * np.sin(5.0 * t), 3.0 + 1.5 * np.cos(5.0 * t)
    q = theta + 0.4 + 0.3 * np.sin(3.0 * t)
    torque = np.gradient(rate, t) * INERTIA + DAMPING * rate - 8.0 * (q - theta)
    day = np.column_stack([t, q, theta, rate, torque])
    estimator = SignalBased(replace(ONE, sampling=1e-2, horizon=1.0, memory=5.0, terms=1))
    first, early = estimator.run_rows(day)
    day[:, 0] += 86400.0
    day[:, 1:3] += 3.0 * 86400.0
    again, late = estimator.run_rows(day)
    np.testing.assert_allclose(late.value[-1], early.value[-1], rtol=1e-6)
    assert np.abs(again[-integral.size(4, 1, 0) :]).max() < 1.01 * np.abs(first[-integral.size(4, 1, 0) :]).max()


def joint(device, velocity, seconds=8, seed=0):
    """Rows of a joint with two motors in multi-tone motion, and its total stiffness (count,)."""
    spring, motor = device.springs[0], device.motors[0]
    t, sub = 1e-3 * np.arange(1000 * seconds), 8
    fine = np.arange(-sub, sub * (len(t) - 1) + 1) * (1e-3 / sub)

    def multisine(tones):
        return [sum(a * (w**k) * np.sin(w * fine + s + 0.5 * np.pi * k) for a, w, s in tones) for k in range(3)]

    q, _, _ = multisine([(0.08, 2.5, 0.0), (0.02, 11.0, 1.0)])
    rng, columns, truth = np.random.default_rng(seed), [t, q[sub::sub]], 0.0
    for sign in (1.0, -1.0):
        theta, rate, bend = multisine([(0.08, 1.7, 0.3), (0.02, 7.0, 2.0), (0.01, 17.0, sign)])
        phi = q - sign * 0.33 - theta
        torque = motor.inertia * bend + motor.viscous_friction * rate - spring.torque(phi)
        effort = np.array([0.0, *(0.5 * (torque[1:] + torque[:-1])).reshape(-1, sub).mean(axis=1)[1:]])
        effort += device.sensors.torque_noise * rng.normal(size=len(t))
        columns += [(sign * 0.33 + theta)[sub::sub], rate[sub::sub] + velocity * rng.normal(size=len(t)), effort]
        truth = truth + spring.stiffness(phi[sub::sub])
    return np.column_stack(columns), truth


@pytest.mark.parametrize("name", ["qbmove_a", "qbmove_alterego"])
def test_standard_deviations_match_the_error_of_a_qbmove_with_undeclared_velocity_noise(name):
    """Velocity noise is not counted as 20 times the torque noise; truncation is included."""
    device = load_device(name)
    device = device.model_copy(update={"sensors": device.sensors.model_copy(update={"torque_noise": 0.03})})
    estimator, promised, missed = SignalBased.from_device(device), [], []
    assert estimator.parameters.velocity_noise == 0.0
    for seed in range(3):
        rows, truth = joint(device, 0.02, seed=seed)
        _, estimates = estimator.run_rows(rows)
        good = (estimates.status == Status.OK) & (rows[:, 0] > 4.0)
        assert good.mean() > 0.4
        promised.append(estimates.standard_deviation[good, 0])
        missed.append((estimates.value[:, 0] - truth)[good])
    ratio = np.sqrt(np.mean(np.concatenate(promised) ** 2) / np.mean(np.concatenate(missed) ** 2))
    assert 0.6 < ratio < 2.0


def test_rounding_of_stamps_has_no_effect():
    """An integral ends at the sample nearest to the horizon, independent of rounding in the sum of steps."""
    rows, _ = planted()
    rows[:, 4] += 0.01 * np.random.default_rng(1).normal(size=len(rows))
    estimator = SignalBased(replace(ONE, torque_noise=0.01, horizon=0.5))
    _, exact = estimator.run_rows(rows)
    rows[:, 0] += 1e-11 * np.random.default_rng(2).uniform(-1.0, 1.0, len(rows))
    _, rounded = estimator.run_rows(rows)
    np.testing.assert_allclose(rounded.value[500:], exact.value[500:], rtol=1e-6)
    np.testing.assert_allclose(rounded.standard_deviation[500:], exact.standard_deviation[500:], rtol=1e-5)


@pytest.mark.parametrize("memory", [1e9, 0.5])
def test_the_effect_of_an_omitted_term_on_the_others_is_known(memory):
    """5 phi^3 fitted by one term: the column considered gives the errors of inertia, damping and k."""
    rows, _ = planted()
    estimator = SignalBased(replace(ONE, terms=1, memory=memory, horizon=0.05))
    own = estimator.parameters
    state, estimates = estimator.run_rows(rows)
    off = integral.considered(state[len(state) - integral.size(4, 1, 0) :], 4)[0]
    widths = np.array([own.inertia_deviation, own.damping_deviation, own.stiffness_deviation])
    predicted = off[1:] * widths * 15.0 / own.stiffness_deviation  # g_2 = phi^2 at scale 1, with coefficient 15
    found = np.array([estimates.value[-1, 2], estimates.value[-1, 3], estimates.value[-1, 1]])
    found -= (INERTIA, DAMPING, 8.0)
    assert abs(found[2]) > 0.3
    np.testing.assert_allclose(predicted, found, rtol=0.02, atol=1e-5)


def expected_of(curve, far, noise, draws=400):
    """Expected over actual size (draws,) of the first omitted term, for an even stiffness curve(z) over |z| <= far.

    Fitted by four powers, the last Chebyshev coefficient of the fit being off by `noise` times itself.
    """
    series = chebyshev.chebinterpolate(lambda u: curve(far * u), 40)
    shrunk = far ** np.arange(0.0, 8.0, 2.0)
    lower = -chebyshev.cheb2poly([0.0] * 8 + [1.0])[:7:2] / 128.0 * far**8 / shrunk  # of z^8 without its T_8
    estimator = SignalBased(replace(ONE, terms=4, truncation=1.0, stiffness_deviation=1.0))
    kept, doubt = np.zeros(KEPT.size + 5), (32.0 * noise * series[6] / far**6) ** 2
    kept[KEPT.low], kept[KEPT.high] = -far, far
    found = []
    for wrong in noise * series[6] * np.random.default_rng(4).normal(size=draws):
        fitted = chebyshev.cheb2poly([*series[:6], series[6] + wrong])[::2] / shrunk
        x, off = (np.concatenate([np.zeros(3), part]) for part in (fitted, lower))
        found.append(first_omitted(estimator._constants, kept, x, off, 0, doubt))
    return np.abs(found) / abs(128.0 * series[8] / far**8)


@pytest.mark.parametrize("far", [0.6, 1.0])
@pytest.mark.parametrize(
    "curve", [lambda z: np.cosh(3.0 * z), lambda z: 1.0 / np.cos(1.2 * z) ** 2, lambda z: 1.0 / (1.0 + 4.0 * z * z)]
)
def test_noise_of_the_last_term_does_not_inflate_the_truncation_error(curve, far):
    """Root mean squares for noise up to twice that term: an entire function and two with poles outside the range."""
    for noise in (1e-3, 0.3, 1.0, 2.0):
        found = np.sqrt(np.mean(expected_of(curve, far, noise) ** 2))
        assert 0.7 < found < 2.2, (noise, found)
