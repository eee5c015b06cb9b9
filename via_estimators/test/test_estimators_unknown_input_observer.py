"""The unknown-input observer: steps to convergence, its transitions, planted truths, and standard errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter
from via_core.status import Status
from via_estimators import deadbeat_observer as observer
from via_estimators.unknown_input_observer import UnknownInputObserver, UnknownInputObserverParameters

INERTIA, DAMPING = 0.02, 0.3
PLAIN = UnknownInputObserverParameters(
    transmissions=1, terms=2, truncation=0.0, inertia=INERTIA, damping=DAMPING, torque_noise=0.01, position_noise=1e-5,
    memory=1e9,
)  # fmt: skip


@pytest.mark.parametrize("damping", [1e-9, 0.3, 11.0, 99.0, 101.0, 1e4])
def test_transitions_are_those_of_the_matrix_exponential(damping):
    h = 1e-3
    chain = np.diag([1.0, 1.0, 1.0], 1)  # angle, velocity, force, slope of the force
    chain[1, 1] = -damping
    exact = expm(h * chain)
    np.testing.assert_allclose(observer.transition(damping, h), [exact[1, 1], *exact[0, 1:]], rtol=1e-10)


def stepped(steps, stamps, w, v, start, torque):
    """Angles (steps + 1,) of the motor under held torques and the input w + v t, by matrix exponentials."""
    A = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, -DAMPING / INERTIA, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0] * 4])
    x, angles = np.array([*start, w / INERTIA, v / INERTIA]), [start[0]]
    for k in range(steps):
        held = np.array([0.0, 0.0, torque[k] / INERTIA, 0.0])
        x = expm(A * (stamps[k + 1] - stamps[k])) @ (x + held) - held
        angles.append(x[0])
    return np.array(angles)


@pytest.mark.parametrize(("steps", "exact"), [(2, False), (3, True), (4, True), (30, True)])
def test_the_torque_is_exact_after_as_many_samples_as_the_model_has_states(steps, exact):
    """Four samples, that is three steps, whatever the initial velocity; without noise, on irregular stamps."""
    rng = np.random.default_rng(4)
    stamps = np.append(0.0, np.cumsum(rng.uniform(2e-3, 6e-3, steps)))
    torque, w, v = rng.normal(size=steps), 0.7, -4.0
    theta = stepped(steps, stamps, w, v, (3.0, 5.0), torque)
    nothing = np.zeros(0)
    state, row, found = np.zeros(observer.size(0)), np.empty(6), np.empty((2, 2))
    observer.begin(state, theta[0], 0.0, nothing)
    for k in range(steps):
        observer.advance(
            state, INERTIA, DAMPING, stamps[k + 1] - stamps[k], theta[k + 1], 0.0, torque[k], nothing, 0.0, row
        )  # fmt: skip
    middle = 0.5 * stamps[-1]
    observer.reconstruct(observer.views(state, 0)[3], middle, found)
    missed = found[:, 0] - found[:, 1] - [w + v * middle, v]
    if exact:
        np.testing.assert_allclose(missed, 0.0, atol=1e-6)
    else:
        assert not np.all(np.abs(missed) < 1e-2)


def test_declared_variances_are_those_of_noisy_angles():
    """White noise on the angles alone: variance of w and v over 2000 windows of 50 samples."""
    rng = np.random.default_rng(1)
    nothing, count = np.zeros(0), 50
    row, found, errors = np.empty(6), np.empty((2, 2)), []
    for _ in range(2000):
        state, theta = np.zeros(observer.size(0)), rng.normal(size=count)
        observer.begin(state, theta[0], 0.0, nothing)
        for each in theta[1:]:
            observer.advance(state, INERTIA, DAMPING, 1e-3, each, 0.0, 0.0, nothing, 0.0, row)
        variances = observer.reconstruct(observer.views(state, 0)[3], 0.5e-3 * (count - 1), found)
        errors.append(found[:, 0].copy())
    np.testing.assert_allclose(np.var(errors, axis=0) / variances, 1.0, atol=0.15)


def planted(count=6000, friction=0.0, seed=0, noise=0.0, period=1e-3):
    """Rows of one motor in prescribed motion; tau_e = 8 phi + 5 phi^3, torque held over the interval it ends."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    t = period * np.arange(count)

    def motion(t):
        theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
        rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
        bend = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
        q = 0.5 * np.sin(4.0 * t)
        spring = 8.0 * (q - theta) + 5.0 * (q - theta) ** 3
        return q, theta, INERTIA * bend + DAMPING * rate + friction * np.sign(rate) - spring

    q, theta, _ = motion(t)
    torque = sum(0.5 * w * motion(t + 0.5 * period * (x - 1.0))[2] for x, w in zip(nodes, weights, strict=True))
    rng = np.random.default_rng(seed)
    angle = 1e-3 * noise
    rows = [t, q + angle * rng.normal(size=count), theta + angle * rng.normal(size=count)]
    return np.column_stack([*rows, torque + noise * rng.normal(size=count)]), 8.0 + 15.0 * (q - theta) ** 2


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_planted_spring_is_recovered_despite_dry_friction(friction):
    rows, truth = planted(friction=friction)
    _, estimates = UnknownInputObserver(PLAIN).run_rows(rows)
    late = (rows[:, 0] > 3.0) & (estimates.status == Status.OK)
    assert late.mean() > 0.4
    np.testing.assert_allclose(estimates.value[late, 0], truth[late], rtol=2e-3)


def test_a_wrong_inertia_is_inside_the_interval_of_its_tolerance():
    rows, truth = planted()
    wrong = replace(PLAIN, inertia=1.1 * INERTIA, damping=0.95 * DAMPING)
    late = rows[:, 0] > 3.0
    for tolerances, covered in (((0.0, 0.0), False), ((0.1 * INERTIA, 0.1 * DAMPING), True)):
        tolerant = replace(wrong, inertia_tolerance=tolerances[0], damping_tolerance=tolerances[1])
        _, estimates = UnknownInputObserver(tolerant).run_rows(rows)
        inside = np.abs(estimates.value[:, 0] - truth) <= 1.96 * estimates.standard_deviation[:, 0]
        assert (inside[late].mean() > 0.9) == covered


def test_standard_deviations_match_the_scatter_between_seeds():
    known = replace(PLAIN, torque_noise=0.05, position_noise=5e-5)
    runs = [UnknownInputObserver(known).run_rows(planted(4000, seed=seed, noise=0.05)[0])[1] for seed in range(24)]
    looks = slice(2000, None, 100)
    scatter = np.std([each.value[looks, 0] for each in runs], axis=0, ddof=1)
    reported = np.sqrt(np.mean([each.standard_deviation[looks, 0] ** 2 for each in runs], axis=0))
    ratio = np.sqrt(np.mean(reported**2) / np.mean(scatter**2))
    assert 0.8 < ratio < 1.25


def sticking(friction, count=9000):
    """Rows of a motor that a controller moves and that sticks at each reversal, with dry friction [N m]; 50 N m/rad.

    Integrated in steps of .1 ms; the impulse of dry friction stops the motor and does not turn it back.
    """
    q = w = theta = omega = torque = 0.0
    rows, h, rng = np.empty((count, 4)), 1e-4, np.random.default_rng(1)
    for k in range(count):
        t = 1e-3 * k
        rows[k] = t, q, theta, torque
        turn = 2.0 * np.pi * t * min(t, 1.0)
        aim, push = 0.13 * np.sin(0.7 * turn) + 0.05 * np.sin(1.7 * turn), 0.5 * np.sin(1.1 * turn)
        torque = 150.0 * (aim - theta) - 6.0 * omega
        for _ in range(10):
            spring = 50.0 * (q - theta)
            w += h * (push - spring - 0.1 * w) / 0.15
            omega += h * (torque + spring - DAMPING * omega) / INERTIA
            omega -= np.clip(omega, -h * friction / INERTIA, h * friction / INERTIA)
            q, theta = q + h * w, theta + h * omega
    rows[:, 1:3] = 1e-4 * np.round(rows[:, 1:3] / 1e-4)
    rows[:, 3] += 0.02 * rng.normal(size=count)
    return rows


def test_a_motor_that_sticks_for_a_part_of_a_window_does_not_bias_the_stiffness():
    """Dry friction is constant where the motor moves, not where it rests."""
    known = replace(
        PLAIN, terms=1, friction_prior=0.2, friction_deviation=0.4, stiffness_prior=50.0, torque_noise=0.02,
        position_noise=1e-4 / np.sqrt(12.0),
    )  # fmt: skip
    rows = sticking(1.0)
    _, estimates = UnknownInputObserver(known).run_rows(rows)
    late = (rows[:, 0] > 4.0) & (estimates.status == Status.OK)
    value, sd = estimates.column("stiffness")
    assert late.sum() > 3000
    error = np.abs(value[late] - 50.0)
    assert error.max() < 0.002 * 50.0 and np.mean(error <= 1.96 * sd[late]) > 0.9


FILED = replace(
    PLAIN, position_noise=1e-5, inertia_tolerance=0.05 * INERTIA, damping_tolerance=0.05 * DAMPING,
    hysteresis_deviation=0.3,
)  # fmt: skip


@pytest.mark.parametrize("constant", [0.003, 0.01])
def test_torques_behind_a_low_pass_filter_do_not_bias_the_stiffness(constant):
    """With an exact time of the torques, errors were 1 and 11 % of the mean stiffness, outside of all intervals."""
    rows, truth = planted(12000, noise=0.01)
    share = 1.0 - np.exp(-1e-3 / constant)
    rows[:, 3] = lfilter([share], [1.0, share - 1.0], rows[:, 3])
    _, estimates = UnknownInputObserver(FILED).run_rows(rows)
    late = (rows[:, 0] > 4.0) & (estimates.status == Status.OK)
    error = np.abs(estimates.value[:, 0] - truth)[late]
    assert error.mean() < 0.01 * truth.mean()
    assert np.mean(error <= 1.96 * estimates.standard_deviation[late, 0]) > 0.85


@pytest.mark.parametrize("travel", [2e-3, 1e-2, 2e-2])
def test_friction_inside_the_spring_is_not_taken_for_stiffness(travel):
    rows, truth = planted(12000, noise=0.01)
    phi, state = rows[:, 1] - rows[:, 2], np.zeros(12000)
    for k in range(1, 12000):
        state[k] = np.clip(state[k - 1] + (phi[k] - phi[k - 1]) / travel, -1.0, 1.0)
    rows[:, 3] -= 0.3 * state
    _, estimates = UnknownInputObserver(FILED).run_rows(rows)
    late = (rows[:, 0] > 4.0) & (estimates.status == Status.OK)
    error = np.abs(estimates.value[:, 0] - truth)[late]
    assert error.mean() < 0.01 * truth.mean()
    assert np.mean(error <= 1.96 * estimates.standard_deviation[late, 0]) > 0.85
