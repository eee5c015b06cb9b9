"""Payload of an arm: planted masses, intervals, contacts, rest, faults, and agreement with a slow filter."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from via_core.errors import ParameterError
from via_core.status import Status
from via_core.vsa_arms import load_vsa_arm
from via_core.weak_form import window_weights
from via_estimators import payload
from via_estimators.contract import Live
from via_estimators.payload import ACROSS, JUMP, MISFIT, ORDER, PART, SIGNALS, Payload, PayloadParameters

ARM = load_vsa_arm("reference_2dof")
N, RATE = ARM.n, 1000.0
PARAMETERS = PayloadParameters(window=100)
KICK = 0.4


@cache
def course(mass, duration=2.0, dry=0.0, force=0.0, still=False, viscous=0.0):
    """Rows of an arm whose motors follow two tones, springs half as stiff as filed; `force` [N] at the tip from 1 s.

    dry, viscous  friction of every motor [N m] and every link [N m s/rad] beyond the file's
    """
    arm = ARM.corrected(mass, np.full(N, 0.5), viscous)
    q0 = np.array([0.4, 1.0])
    theta0 = arm.rest(q0)
    x, rows, tau, h = np.array([q0, np.zeros(N), theta0, np.zeros(N)]), [], np.zeros(N), 5e-4

    def rate(x, tau, push):
        return arm.rates(x, tau - dry * np.tanh(x[3] / 1e-3), arm.tip_jacobian(x[0]).T @ push)

    for k in range(round(duration * RATE)):
        t = k / RATE
        rows.append([t, *x[0], *x[2], *tau])
        wave = 0.0 if still else KICK * np.array([np.sin(9.0 * t), np.sin(13.0 * t + 1.0)])
        tau = -arm.spring_state(q0 - theta0)[0] + 60.0 * (theta0 + wave - x[2]) - 6.0 * x[3]
        push = np.array([force if t > 1.0 else 0.0, 0.0, 0.0])
        for _ in range(2):
            k1 = rate(x, tau, push)
            k2 = rate(x + 0.5 * h * k1, tau, push)
            k3 = rate(x + 0.5 * h * k2, tau, push)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + rate(x + h * k3, tau, push)) + 0.0
    return np.array(rows)


def estimated(rows, parameters=PARAMETERS):
    return Payload(ARM, parameters).run_rows(rows)[1]


@pytest.mark.parametrize("mass", [0.0, 0.3, 1.1])
def test_a_planted_payload_is_found_whatever_the_springs(mass):
    found = estimated(course(mass))
    value, sd = found.column("payload")
    assert found.status[-1] == Status.OK
    assert value[-1] == pytest.approx(mass, abs=2e-3) and sd[-1] < 0.02


def test_the_interval_covers_with_noise_and_dry_friction():
    clean, inside, late = course(0.3, dry=0.5), [], 1000
    for seed in range(12):
        random = np.random.default_rng(seed)
        rows = clean.copy()
        rows[:, 1 : 1 + 2 * N] += random.normal(0.0, 1e-4, (len(rows), 2 * N))
        rows[:, 1 + 2 * N :] += random.normal(0.0, 0.2, (len(rows), N))
        found = estimated(rows)
        value, sd = found.column("payload")
        good = found.status[late:] == Status.OK
        assert good.all()
        inside.append(np.abs(value[late:] - 0.3) < 1.96 * sd[late:])
    assert np.mean(inside) > 0.85, np.mean(inside)


def slow_filter(rows, own):
    """After each window: time, variance of the payload with forces, misfit, payload, friction of links, its variances.

    The equations are those of a filter in information form.
    """
    estimator, k = Payload(ARM, own), 1 + 2 * N
    samples, times = rows[:, 1:].reshape(-1, len(SIGNALS), N), rows[:, 0]
    steps = np.diff(times, prepend=times[0])
    before = samples[np.maximum(np.arange(len(rows)) - 1, 0), :2]
    parts = np.array([estimator._parts(*each) for each in zip(before, samples, steps, strict=True)])
    x = np.zeros(k)
    P = np.diag([own.payload_deviation**2] + N * [own.damping_deviation**2] + N * [own.friction_deviation**2])
    prior, noise, weight, earlier = P.copy(), np.full(N, own.noise**2), np.full(N, 2.0), []
    forces, misfit, before, found = 0.0, 0.0, None, []
    for at in range(own.window, len(rows), own.window // 2):
        t, each = times[at - own.window : at + 1], parts[at - own.window : at + 1]
        psi, steps = window_weights(ORDER, t), np.diff(t)
        density = psi[0] / np.gradient(t)
        density[[0, -1]] = 0.0
        held = np.concatenate([[0.0], steps * 0.5 * (density[1:] + density[:-1])])
        slope = np.diff(density, prepend=0.0)
        theta, far = each[:, PART.theta], int(ACROSS * len(t))
        first, last = np.maximum(np.arange(len(t)) - far, 0), np.minimum(np.arange(len(t)) + far, len(t) - 1)
        speed = (theta[last] - theta[first]) / (t[last] - t[first])[:, None]
        still = np.abs(speed) <= own.still
        A, tau, stuck = np.zeros((N, k)), held @ each[:, PART.tau], psi[0] @ still
        A[:, 0] = slope @ each[:, PART.unit_momentum] + held @ each[:, PART.unit_force]
        A[range(N), range(1, 1 + N)] = -held @ each[:, PART.velocity]
        A[range(N), range(1 + N, k)] = -psi[0] @ np.where(still, 0.0, np.sign(speed))
        y = -slope @ each[:, PART.momentum] - held @ each[:, PART.force] - tau
        P[0, 0] += own.payload_drift**2 * (t[-1] - before) if before is not None else 0.0
        before = t[-1]
        borne = x[1 + N :] ** 2 + np.diag(P)[1 + N :]
        R = noise + borne * stuck**2
        e, inverse = y - A @ x, np.linalg.inv(A @ P @ A.T + np.diag(R))
        information = A[:, 0] @ inverse @ A[:, 0]
        mass = A[:, 0] @ inverse @ e / information
        more = max((e @ inverse @ e - mass**2 * information) / (N - 1), 1.0)
        shares = A[:, 0] * (inverse @ A[:, 0]) / information
        if mass**2 * information > JUMP**2 * more:
            P[0, 0] += mass**2 - 1.0 / information
        earlier.append((y, stuck, A))
        if len(earlier) > 2:
            y_before, stuck_before, A_before = earlier[-3]
            rows, count = A - A_before, np.minimum(weight, 40.0)
            expected = 2.0 * noise + np.diag(rows @ P @ rows.T) + borne * (stuck - stuck_before) ** 2
            change = np.minimum((y - y_before - rows @ x) ** 2 / expected, JUMP**2)
            louder = noise * (count + change) / (count + 1.0)
            factor, noise, weight = (R + louder - noise) / R, louder, count + 1.0
            wanted = np.concatenate([[shares @ factor], factor, factor])
            wider = np.minimum(wanted, np.maximum(np.diag(prior) / np.diag(P), 1.0))
            P = np.diag(np.sqrt(wider)) @ P @ np.diag(np.sqrt(wider))
        R = R * more
        moved = min(P[0, 0] * (A[:, 0] @ np.linalg.inv(A @ P @ A.T + np.diag(R)) @ A[:, 0]), 1.0)
        forces += moved * ((more - 1.0) / information - forces)
        P = np.linalg.inv(np.linalg.inv(P) + A.T @ (A / R[:, None]))
        x = x + P @ A.T @ (e / R)
        left = y - A @ x
        misfit = max(min(left @ left / (tau @ tau), 1.0), 0.8 * misfit)
        found.append([before, P[0, 0] + forces, misfit, *x[: 1 + N], *np.diag(P)[1 : 1 + N]])
    return np.array(found)


def test_every_window_equals_the_slow_filter():
    """Noise, dry friction, rest, a force from 1 s on, then a payload picked up."""
    own = replace(PARAMETERS, payload_drift=0.2)
    first, second = course(0.3, dry=0.2, force=4.0), course(0.9, duration=1.0)
    pause = np.repeat(first[:1], 200, axis=0)
    rows = np.vstack([pause, first, second])
    rows[:, 0] = np.arange(len(rows)) / RATE
    rows[:, 1:] += np.random.default_rng(1).normal(0.0, 1e-5, rows[:, 1:].shape)
    slow, found = slow_filter(rows, own), estimated(rows, own)
    value, sd = found.column("payload")
    at = np.searchsorted(rows[:, 0], slow[2:, 0])  # the first windows are not reported
    assert np.all(found.status[: at[0]] == Status.WARMING_UP) and found.status[at[0]] != Status.WARMING_UP
    assert value[at] == pytest.approx(slow[2:, 3], rel=1e-6, abs=1e-9)
    assert sd[at] ** 2 == pytest.approx(slow[2:, 1], rel=1e-6)
    assert sd[at[-1] - 1] ** 2 == pytest.approx(slow[-2, 1] + own.payload_drift**2 * 0.049, rel=1e-6)
    friction, variance = np.split(slow[2:, 4:], 2, axis=1)
    assert found.value[at, 1:] == pytest.approx(friction, rel=1e-6, abs=1e-9)
    assert found.standard_deviation[at, 1:] ** 2 == pytest.approx(variance, rel=1e-6)
    doubted = slow[2:, 2] > MISFIT**2
    assert 0 < doubted.sum() < len(doubted)
    assert np.array_equal(found.status[at] == Status.IMPLAUSIBLE, doubted)


@pytest.mark.parametrize("bits", [0, 17, 14])
def test_planted_friction_of_links_and_motors_is_recovered(bits):
    """Whatever the encoders: the velocities of a driver that differences their angles would be late."""
    rows, viscous = course(0.3, dry=0.5, viscous=0.4).copy(), [f"link_friction_{joint}" for joint in range(1, 1 + N)]
    if bits:
        step = 2.0 * np.pi / 2**bits
        rows[:, 1 : 1 + 2 * N] = step * np.round(rows[:, 1 : 1 + 2 * N] / step)
    state, found = Payload(ARM, PARAMETERS).run_rows(rows)
    x, variance, _, _, _ = payload._filter(state.copy(), N)
    assert found.outputs[1:] == tuple(viscous) and np.array_equal(found.value[-1], x[: 1 + N])
    assert x[1 : 1 + N] == pytest.approx(0.4, abs=0.03) and x[1 + N :] == pytest.approx(0.5, abs=0.05)
    assert np.linalg.eigvalsh(variance)[0] > 0.0


@pytest.mark.parametrize("noise", [0.2, 1.0])
def test_the_intervals_of_friction_cover(noise):
    """Also with twenty times the noise that the estimator expects, which it measures; they are not too wide either."""
    clean, inside, scores = course(0.3, dry=0.5, viscous=0.4), [], []
    for seed in range(24):
        random = np.random.default_rng(seed)
        rows = clean.copy()
        rows[:, 1 : 1 + 2 * N] += random.normal(0.0, 1e-4, (len(rows), 2 * N))
        rows[:, 1 + 2 * N :] += random.normal(0.0, noise, (len(rows), N))
        found = estimated(rows)
        inside.append(np.abs(found.value[1000:, 1:] - 0.4) < 1.96 * found.standard_deviation[1000:, 1:])
        scores.append((found.value[-1, 1:] - 0.4) / found.standard_deviation[-1, 1:])
    assert 0.6 < np.std(scores) < 1.4
    assert np.mean(inside) > 0.85, np.mean(inside)


@pytest.mark.parametrize("bounds", [{"heaviest": 0.2}, {"lightest": 0.0}])
def test_an_impossible_payload_is_implausible(bounds):
    rows = course(0.3 if "heaviest" in bounds else -0.1)
    assert estimated(rows, replace(PARAMETERS, **bounds)).status[-1] == Status.IMPLAUSIBLE
    assert estimated(rows).status[-1] == Status.OK


def test_a_payload_that_data_do_not_determine_is_not_excited():
    status = estimated(course(0.3, still=True, duration=1.0), replace(PARAMETERS, payload_deviation=0.02)).status
    assert set(status[200:]) == {Status.NOT_EXCITED}


def test_a_strong_force_at_the_tip_is_not_called_a_payload():
    found, free = estimated(course(0.3, force=15.0)), estimated(course(0.3))
    assert np.array_equal(found.value[:1000], free.value[:1000])
    assert np.mean(found.status[1000:] == Status.OK) < 0.5 and np.mean(free.status[1000:] == Status.OK) == 1.0


def test_a_payload_picked_up_is_followed():
    rows = np.vstack([course(0.0), course(0.6) + np.eye(1, 1 + 3 * N) * 2.0])
    value, _ = estimated(rows).column("payload")
    assert abs(value[1999]) < 5e-3 and value[-1] == pytest.approx(0.6, abs=0.02)


def test_at_rest_dry_friction_may_hide_the_payload():
    value, sd = estimated(course(0.3, still=True, duration=1.0)).column("payload")
    moving = estimated(course(0.3)).column("payload")[1][-1]
    assert sd[-1] > 5.0 * moving and abs(value[-1] - 0.3) < 2.0 * sd[-1]


@pytest.mark.parametrize("scale", [-1.0, 1000.0])
def test_efforts_of_wrong_sign_or_unit_are_never_ok(scale):
    rows = course(0.3).copy()
    rows[:, 1 + 2 * N :] *= scale
    status = estimated(rows).status
    assert np.mean(status[1000:] == Status.OK) <= 0.05


def test_bad_samples_are_skipped_and_live_equals_replay():
    rows = course(0.3)[:600].copy()
    rows[200, 3] = np.nan
    rows[300, 0] = rows[299, 0]
    estimator = Payload(ARM, PARAMETERS)
    replay, live = estimator.run_rows(rows)[1], Live(estimator)
    assert replay.status[200] == replay.status[300] == Status.BAD_SAMPLE
    for row, value in zip(rows, replay.value[:, 0], strict=True):
        live.take(row[None])
        assert live.value[0] == value
    assert live.health().bad == 2 and np.isfinite(replay.value).all()
    state, one = estimator.step(estimator.init(), rows[0])
    assert one.status == Status.WARMING_UP and one.standard_deviation[0] == PARAMETERS.payload_deviation
    assert not state.flags.writeable and estimator.condition(state) == pytest.approx(1.0)


@pytest.mark.parametrize("rest", [60.0, 240.0])
def test_a_long_rest_makes_no_estimate_too_certain(rest):
    """Noise is measured at rest, too, where the friction that a motor bears is no noise."""
    moving = course(0.3, dry=0.5, viscous=0.4)
    rows = np.vstack([moving, np.repeat(moving[-1:], round(rest * RATE), axis=0), moving])
    rows[:, 0] = np.arange(len(rows)) / RATE
    rows[:, 1 + 2 * N :] += np.random.default_rng(2).normal(0.0, 0.2, (len(rows), N))
    found = estimated(rows)
    good, truth = found.status == Status.OK, np.array([0.3, *[0.4] * N])
    off = np.abs(found.value - truth) / found.standard_deviation
    after = good & (np.arange(len(rows)) > len(rows) - 1000)
    assert after.mean() * len(rows) > 800 and np.mean(off[after] < 1.96) > 0.85 and off[good].max() < 5.0


@pytest.mark.parametrize("late", [-0.9, -30.0, 5.0])
def test_stamps_that_jump_leave_the_estimate_sound(late):
    rows = np.vstack([course(0.3), course(0.3)])
    rows[:, 0] = np.arange(len(rows)) / RATE
    rows[1000:, 0] += late
    found = estimated(rows)
    assert np.isfinite(found.standard_deviation).all()
    assert found.status[-1] == Status.OK and found.value[-1, 0] == pytest.approx(0.3, abs=2e-3)


def test_no_variance_shrinks_by_time_that_runs_backward():
    """A variance that becomes negative, by as much as one window determines, never recovers."""
    rows = np.vstack([course(0.3), course(0.3)])[:2000]
    rows[:, 0] = np.arange(len(rows)) / RATE - 0.9 * (np.arange(len(rows)) >= 1000)
    for drift in np.geomspace(1e-4, 1.0, 13):
        found = estimated(rows, replace(PARAMETERS, payload_drift=float(drift)))
        assert np.isfinite(found.standard_deviation).all() and found.value[-1, 0] == pytest.approx(0.3, abs=5e-3)


def test_windows_before_and_after_a_gap_are_not_compared():
    """Noise is measured again by the third window after it."""
    rows = np.vstack([course(0.3), course(0.3)[:300]])
    rows[:, 0] = np.arange(len(rows)) / RATE
    rows[2000:, 0] += 1.0
    counts = [
        payload._filter(Payload(ARM, PARAMETERS).run_rows(rows[:n])[0].copy(), N)[3][0] for n in (2000, 2155, 2205)
    ]
    assert counts[0] == counts[1] == counts[2] - 1.0


def test_a_sample_that_was_sent_twice_is_no_motion():
    rows = np.repeat(course(0.3, viscous=0.4), 2, axis=0)
    rows[1::2, 0] += 1e-7
    rows[:, 1 : 1 + 2 * N] += np.random.default_rng(3).normal(0.0, 1e-4, (len(rows), 2 * N))
    found = estimated(rows)
    assert set(found.status[1::2]) == {Status.BAD_SAMPLE}
    assert found.value[-1] == pytest.approx([0.3, 0.4, 0.4], abs=0.05)


def test_exact_signals_have_no_noise_to_divide_by():
    """Also after hours of exact rest, when nothing is left of the noise that was expected."""
    estimator, rows = Payload(ARM, PARAMETERS), course(0.3)[:800]
    state, out = estimator.init().copy(), np.zeros((len(rows), 2 + 2 * (1 + N)))
    payload._filter(state, N)[2][:] = 0.0
    estimator._fold_rows(state, rows, out)
    assert np.isfinite(out).all() and out[-1, 2] == pytest.approx(0.3, abs=2e-3)
    own = replace(PARAMETERS, noise=1e-9)
    assert np.isfinite(estimated(course(0.3), own).standard_deviation).all()
    assert np.isfinite(
        estimated(np.zeros((800, 1 + 3 * N)) + np.arange(800)[:, None] / RATE * np.eye(1, 1 + 3 * N), own).value
    ).all()


def test_a_joint_has_no_payload():
    from via_core.devices import load_device

    with pytest.raises(ParameterError, match="is a joint"):
        Payload.from_device(load_device("cubic_demo"))
