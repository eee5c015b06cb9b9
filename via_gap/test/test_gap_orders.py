"""Orders of periodic effects: planted ones are found, also where the first choice by itself is a wrong one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
from via_core.signals import Array
from via_gap.candidates.fit import Fit
from via_gap.candidates.orders import ENCODER_ORDERS, PASSES, _exchanged, encoder_waves, torque_waves
from via_gap.candidates.scales import SCREENED, highest_order, strongest_order
from via_sim.effects import Effect

FOUND = {"amplitude": 0.01, "phase": 0.3}  # order 1, which every encoder error has
PLANTED = {5.0: (0.004, 1.0), 7.0: (0.004, 0.3)}  # amplitude [rad] and phase by order


class Linear:
    """A problem whose residual is the encoder error itself: planted orders less those of the effect."""

    def __init__(self, angle: Array, planted: dict[float, tuple[float, float]], noise: float) -> None:
        self.angle, self.noise = angle, noise
        self.measured = sum(a * np.sin(n * angle + p) for n, (a, p) in planted.items())
        self.measured = self.measured + noise * np.random.default_rng(3).normal(size=len(angle))

    def row_or_none(self, effects: Sequence[Effect], offsets: Array) -> Array:
        p = effects[0].parameters
        row = p["amplitude"] * np.sin(self.angle + p["phase"])
        if "order_2" in p:
            row = row + p["amplitude_2"] * np.sin(p["order_2"] * self.angle + p["phase_2"])
        return row

    def residual(self, rows: Sequence[Array]) -> Array:
        return self.measured - np.stack(list(rows))

    def weights(self, residual: Array) -> Array:
        return np.ones_like(residual)

    def nuisance_jacobian(self, effects: Sequence[Effect], offsets: Array, residual: Array) -> Array:
        return np.ones((len(residual), 1))


def found(turns: float, noise: float = 1e-5) -> tuple[list[tuple[float, float, float]], Linear]:
    problem = Linear(np.linspace(0.0, 2.0 * np.pi * turns, 600), {1.0: (0.01, 0.3), **PLANTED}, noise)
    effect = Effect("encoder_eccentricity", "sensor", FOUND)
    residual = problem.residual([problem.row_or_none([effect], np.empty(0))])[0]
    fit = Fit((effect,), np.empty(0), float(residual @ residual), residual, np.eye(2))
    return encoder_waves(problem, fit, 0, 3), problem  # type: ignore[arg-type]


@pytest.mark.parametrize("turns", [3.0, 0.4])
def test_planted_orders_of_an_encoder_are_found(turns):
    """Over .4 turns neighbouring orders are alike: there only the exchange leads to them."""
    waves, _ = found(turns)
    assert waves[0][1] == 1.0 and {order for _, order, _ in waves} == {1.0, *PLANTED}
    for amplitude, order, phase in waves:
        wanted = PLANTED.get(order, (0.01, 0.3))
        assert (amplitude, phase) == (pytest.approx(wanted[0], rel=0.05), pytest.approx(wanted[1], abs=0.05))


def test_no_other_pair_of_orders_beside_the_first_leaves_less():
    waves, problem = found(0.4)

    def left(orders: Sequence[float]) -> float:
        columns = [np.ones_like(problem.angle)]
        columns += [f(n * problem.angle) for n in (1.0, *orders) for f in (np.sin, np.cos)]
        design = np.stack(columns, axis=1)
        rest = problem.measured - design @ np.linalg.lstsq(design, problem.measured, rcond=None)[0]
        return float(rest @ rest)

    taken = left([order for _, order, _ in waves[1:]])
    pairs = list(combinations(map(float, ENCODER_ORDERS[1:12]), 2))
    assert taken == pytest.approx(min(map(left, pairs)))


def test_the_first_order_stays_and_exchanges_end():
    assert _exchanged([0, 5, 6], lambda others: {(0, 6): 2, (0, 2): 4, (0, 4): 2}[tuple(others)], 1) == [0, 2, 4]
    asked: list[list[int]] = []

    def restless(others: list[int]) -> int:
        asked.append(others)
        return len(asked) + 10

    assert _exchanged([0, 1], restless, 1)[0] == 0
    assert len(asked) == PASSES and all(each == [0] for each in asked)


@pytest.mark.parametrize(
    ("turns", "orders"), [(1.3, (7.0, 8.0, 12.0)), (0.6, (7.0, 9.0, 20.0)), (0.4, (7.0, 100.0, 200.0))]
)
def test_planted_orders_of_a_torque_are_found(monkeypatch, turns, orders):
    """Over little more than a turn the strongest single order is between two true ones. A gear has high orders."""
    angle = np.linspace(-0.3, 2.0 * np.pi * turns - 0.3, 900)
    amounts = (0.05, 0.04, 0.02)
    torque = 0.3 + sum(a * np.sin(n * angle + 0.7 * n) for n, a in zip(orders, amounts, strict=True))
    torque = torque + 1e-4 * np.random.default_rng(5).normal(size=len(angle))
    monkeypatch.setattr("via_gap.candidates.orders._missing", lambda *_: (angle, torque))
    whole = torque_waves(None, angle, 1, 8)[0]  # type: ignore[arg-type]
    assert {order for _, order, _ in whole} == set(orders)
    for amplitude, order, _ in whole:
        assert amplitude == pytest.approx(amounts[orders.index(order)], rel=0.03)


def test_the_strongest_order_is_found_as_far_as_windows_show_it():
    """A window that contains a whole period shows nothing of it: in fast motion only low orders are screened."""
    slow, fast = (np.linspace(0.0, 2.0 * np.pi * turns, 900) for turns in (1.0, 12.0))
    for angle, order in ((slow, 160.0), (fast, 30.0)):
        torque = np.sin(order * angle + 0.4) + 0.5 * np.sin(7.0 * angle)
        assert strongest_order(angle, torque, (), highest_order(angle)) == pytest.approx(order, abs=1e-3)
        assert strongest_order(angle, torque, (order,), highest_order(angle)) == pytest.approx(7.0, abs=1e-3)
    assert highest_order(slow) > 160.0 and highest_order(fast) == SCREENED


def test_high_orders_that_fit_noise_by_chance_replace_no_low_one(monkeypatch):
    """Slow motion over a turn shows hundreds of orders, more than half as many as there are windows."""
    random, low = np.random.default_rng(7), (7, 12, 14, 28, 36)
    angle = 2.0 * np.pi * np.sort(random.uniform(0.0, 1.0, 500))
    torque = sum(a * np.sin(n * angle + n) for n, a in zip(low, (0.05, 0.014, 0.016, 0.025, 0.012), strict=True))
    torque = torque + 0.006 * random.standard_normal(len(angle))
    assert highest_order(angle) > 200.0
    monkeypatch.setattr("via_gap.candidates.orders._missing", lambda *_: (angle, torque))
    whole = torque_waves(None, angle, 1, 5)[0]
    assert sorted(order for _, order, _ in whole) == list(low)


def test_a_high_order_explains_what_low_ones_leave(monkeypatch):
    angle = np.linspace(0.0, 2.0 * np.pi, 900)
    torque = 2.0 * np.sin(100.0 * angle + 0.3) + 0.5 * np.sin(50.0 * angle)
    monkeypatch.setattr("via_gap.candidates.orders._missing", lambda *_: (angle, torque))
    for choice in torque_waves(None, angle, 1, 8):
        assert {round(order) for _, order, _ in choice[:2]} == {50, 100}


def test_no_high_order_is_found_in_noise(monkeypatch):
    """Of 30 logs, two or three may have one by chance; with the share of low orders alone more than half do."""
    random, found = np.random.default_rng(11), 0
    for _ in range(30):
        angle = np.linspace(0.0, 2.0 * np.pi, 168) * 0.4
        torque = 0.05 * np.sin(7.0 * angle) + 0.004 * random.standard_normal(len(angle))
        monkeypatch.setattr("via_gap.candidates.orders._missing", lambda *_, a=angle, t=torque: (a, t))
        found += any(order > SCREENED for choice in torque_waves(None, angle, 1, 8) for _, order, _ in choice)
    assert found <= 5
