"""Payload of an arm: planted masses, intervals, contacts, rest, faults, and agreement with a slow least-squares fit."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from via_core.errors import ParameterError
from via_core.status import Status
from via_core.vsa_arms import load_vsa_arm
from via_core.weak_form import window_weights
from via_estimators.contract import Live
from via_estimators.payload import ORDER, SIGNALS, Payload, PayloadParameters

ARM = load_vsa_arm("reference_2dof")
N, RATE = ARM.n, 1000.0
PARAMETERS = PayloadParameters(window=100)
KICK = 0.4


@cache
def course(payload, duration=2.0, dry=0.0, force=0.0, still=False):
    """Rows of an arm whose motors follow two tones, springs half as stiff as filed; `force` [N] at the tip from 1 s."""
    arm = ARM.corrected(payload, np.full(N, 0.5))
    q0 = np.array([0.4, 1.0])
    theta0 = arm.rest(q0)
    x, rows, tau, h = np.array([q0, np.zeros(N), theta0, np.zeros(N)]), [], np.zeros(N), 5e-4

    def rate(x, tau, push):
        return arm.rates(x, tau - dry * np.tanh(x[3] / 1e-3), arm.tip_jacobian(x[0]).T @ push)

    for k in range(round(duration * RATE)):
        t = k / RATE
        rows.append([t, *x.ravel(), *tau])
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


@pytest.mark.parametrize("payload", [0.0, 0.3, 1.1])
def test_a_planted_payload_is_found_whatever_the_springs(payload):
    found = estimated(course(payload))
    value, sd = found.column("payload")
    assert found.status[-1] == Status.OK
    assert value[-1] == pytest.approx(payload, abs=2e-3) and sd[-1] < 0.02


def test_the_interval_covers_with_noise_and_dry_friction():
    clean, inside, late = course(0.3, dry=0.5), [], 1000
    for seed in range(12):
        random = np.random.default_rng(seed)
        rows = clean.copy()
        rows[:, 1 : 1 + 4 * N] += random.normal(0.0, 2e-3, (len(rows), 4 * N))
        rows[:, 1 + 4 * N :] += random.normal(0.0, 0.2, (len(rows), N))
        found = estimated(rows)
        value, sd = found.column("payload")
        good = found.status[late:] == Status.OK
        assert good.all()
        inside.append(np.abs(value[late:] - 0.3) < 1.96 * sd[late:])
    assert np.mean(inside) > 0.85


def test_it_equals_least_squares_over_the_same_windows():
    """Without drift and with little noise: all equations, prior included, in one weighted fit."""
    own = replace(PARAMETERS, payload_drift=0.0, noise=0.05)
    rows, estimator = course(0.3), Payload(ARM, own)
    length, at = own.window + 1, own.window
    parts = np.array([estimator._parts(row[1:].reshape(len(SIGNALS), N)) for row in rows])
    A, y = [], []
    while at < len(rows):
        inside = slice(at - own.window, at + 1)
        psi = window_weights(ORDER, rows[inside, 0])
        steps, each = np.diff(rows[inside, 0]), parts[inside]
        density = psi[0] / np.gradient(rows[inside, 0])
        density[[0, -1]] = 0.0
        held = np.concatenate([[0.0], steps * 0.5 * (density[1:] + density[:-1])])
        for i in range(N):
            row = np.zeros(1 + 2 * N)
            row[0] = psi[1] @ each[:, 2, i] + psi[0] @ each[:, 3, i]
            row[1 + i], row[1 + N + i] = -psi[0] @ each[:, 4, i], -psi[0] @ each[:, 5, i]
            A.append(row)
            y.append(-psi[1] @ each[:, 0, i] - psi[0] @ each[:, 1, i] - held @ each[:, 7, i])
        at += own.window // 2
    assert length == 101
    slow = np.linalg.lstsq(np.array(A), np.array(y), rcond=None)[0]
    assert estimated(rows, own).column("payload")[0][-1] == pytest.approx(slow[0], abs=1e-3)


def test_a_strong_force_at_the_tip_is_not_called_a_payload():
    found, free = estimated(course(0.3, force=15.0)), estimated(course(0.3))
    assert np.array_equal(found.value[:1000], free.value[:1000])
    assert np.mean(found.status[1000:] == Status.OK) < 0.5 and np.mean(free.status[1000:] == Status.OK) == 1.0


def test_a_payload_picked_up_is_followed():
    rows = np.vstack([course(0.0), course(0.6) + np.eye(1, 1 + 5 * N) * 2.0])
    value, _ = estimated(rows).column("payload")
    assert abs(value[1999]) < 5e-3 and value[-1] == pytest.approx(0.6, abs=0.02)


def test_at_rest_dry_friction_may_hide_the_payload():
    value, sd = estimated(course(0.3, still=True, duration=1.0)).column("payload")
    moving = estimated(course(0.3)).column("payload")[1][-1]
    assert sd[-1] > 5.0 * moving and abs(value[-1] - 0.3) < 2.0 * sd[-1]


@pytest.mark.parametrize("scale", [-1.0, 1000.0])
def test_efforts_of_wrong_sign_or_unit_are_never_ok(scale):
    rows = course(0.3).copy()
    rows[:, 1 + 4 * N :] *= scale
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


def test_a_joint_has_no_payload():
    from via_core.devices import load_device

    with pytest.raises(ParameterError, match="is a joint"):
        Payload.from_device(load_device("cubic_demo"))
