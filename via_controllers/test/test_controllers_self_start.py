"""The start of a limit cycle on one mode of constant lambda: w = 1, A = 1, h = z^2 + zd^2."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from via_controllers.arms.self_start import BAND, ENOUGH, START, push, turned, turning

STEPS = 300  # of a period
PULL = 0.642  # k_V H_d w of mode 1 in the reference set-up
SOFTER = np.sqrt(ENOUGH)  # |z| at rest from which nothing is added


def course(z, speed, direction, periods, start=START, pull=PULL):
    """(STEPS periods, 4): h, z, zd and s; midpoint rule."""
    step, found = 2.0 * np.pi / STEPS, []

    def slope(z, speed, direction):
        h = z * z + speed * speed
        return speed, -z + pull * (1.0 - h) * speed + push(start, direction, h)

    for _ in range(round(STEPS * periods)):
        h = z * z + speed * speed
        found.append((h, z, speed, push(start, direction, h)))
        rate = turning(start, direction, z, speed, 1.0)
        by, force = slope(z, speed, direction)
        middle = turned(direction, rate, step / 2.0)
        by, force = slope(z + step / 2.0 * by, speed + step / 2.0 * force, middle)
        z, speed, direction = z + step * by, speed + step * force, turned(direction, rate, step)
    return np.array(found)


def final_directions(z, start=START):
    """Final values of p with the mode held at `z`, by simulation."""
    ends = set()
    for direction in (-1.0, 0.0, 1.0):
        for _ in range(200):
            direction = turned(direction, turning(start, direction, z, 0.0, 1.0), 0.02)
        ends.add(direction)
    return ends


def test_released_anywhere_the_cycle_is_back_in_one_period_and_a_half():
    """Number 3 between the turning points, for either direction; without the start it is missed."""
    for z in np.linspace(-1.0, 1.0, 41):
        for direction in final_directions(z):
            off = np.abs(course(z, 0.0, direction, 2.5)[:, 0] - 1.0)
            assert off[300:].max() < 0.1 and off[450:].max() < 0.02
    off = np.abs(course(0.1, 0.0, 0.0, 2.5, start=0.0)[:, 0] - 1.0)
    assert off[300:].max() > 0.5 and off[450:].max() > 0.1


@pytest.mark.parametrize("start", [0.05, START, 1.0])
def test_there_is_no_equilibrium(start):
    """z = s has no solution; with a constant p = 1 it would have one."""

    def least(ways):
        return min(abs(z - push(start, way, z * z)) for z in np.linspace(-1.0, 1.0, 2001) for way in ways(z))

    assert least(lambda z: final_directions(z, start)) > 0.5 * start
    assert least(lambda z: {1.0}) < 0.01


def test_from_rest_it_starts_away_from_its_offset_and_mirrored():
    for lean in (1e-3, -1e-3):
        found = course(lean, 0.0, 0.0, 1.5)
        away = np.sign(lean)
        assert np.all(found[1:80, 3] * away < 0.0)
        assert found[350:, 0].min() > 0.9 and found[:, 0].max() < 1.01
    assert_allclose(course(1e-3, 0.0, 0.0, 1.5), course(-1e-3, 0.0, 0.0, 1.5) * [1, -1, -1, -1], rtol=0, atol=0)


@pytest.mark.parametrize("pull", [0.0, PULL])
def test_from_rest_h_rises_all_the_way(pull):
    """s zd >= 0 also where p turns, with (102) and without; h = 2 a^2 (1 - cos t) as long as sigma is about 1."""
    found = course(0.0, 0.0, 1.0, 1.0, pull=pull)
    h, _, speed, s = found.T
    assert np.diff(h).min() > -1e-7 and np.min(s * speed) > -1e-5 and np.min(s) < -0.02
    early = np.arange(30) * 2.0 * np.pi / 300
    free = course(0.0, 0.0, 1.0, 0.1, pull=0.0)[:, 0]
    assert_allclose(free, 2.0 * START**2 * (1.0 - np.cos(early)), rtol=0.01, atol=1e-12)


def test_in_wide_oscillations_the_push_supports_the_motion():
    """Along z = .8 cos t p changes sign within the band's share of a turning point."""
    direction, given = 0.0, []
    for phase in np.arange(0.0, 6.0 * np.pi, 0.002):
        z, speed = 0.8 * np.cos(phase), -0.8 * np.sin(phase)
        direction = turned(direction, turning(START, direction, z, speed, 1.0), 0.002)
        given.append((speed, push(START, direction, 0.25)))
    speed, s = np.array(given[2000:]).T
    assert np.all((s * speed >= 0.0) | (np.abs(speed) < 0.8 * 1.05 * BAND * START / (0.8 * np.sqrt(2.0))))
    assert np.mean(s * speed) > 0.5 * push(START, 1.0, 0.25) * np.mean(np.abs(speed))


def test_the_direction_is_kept_within_the_band():
    for way in (1.0, -1.0):
        inside, beyond = 0.99 * BAND * START, 1.01 * BAND * START
        assert turning(START, way, way * inside, 0.0, 3.0) == 0.0
        assert turning(START, way, way * beyond, 0.0, 3.0) == pytest.approx(-way * 12.0 / np.pi)
        assert turning(START, 0.3 * way, way * inside, 0.0, 3.0) == pytest.approx(way * 12.0 / np.pi)
    assert turned(0.9, 10.0, 1.0) == 1.0 and turned(0.9, -1.0, 0.5) == pytest.approx(0.4)


def test_the_holding_force_is_at_most_that_of_a_turning_point():
    def most(start):
        z = np.linspace(0.0, SOFTER, 400)
        return max(abs(each - push(start, way, each * each)) for each in z for way in final_directions(each, start))

    assert most(START) <= most(0.6) <= 1.0 < most(0.65)


def test_nothing_is_added_from_enough_on_and_all_is_smooth():
    assert push(START, 1.0, ENOUGH) == 0.0 == push(START, -1.0, 1.7) == push(0.0, 1.0, 0.0) == push(START, 0.0, 0.0)
    assert push(START, 1.0, 0.0) == START == -push(START, -1.0, 0.0)
    for along in (lambda x: push(START, 1.0, x), lambda x: push(START, x - 0.2, 0.1)):
        values = np.array([along(x) for x in np.linspace(0.0, 1.2, 2401)])
        second = np.diff(values, 2) / 0.0005**2
        assert np.abs(np.diff(second)).max() < 0.02 * np.abs(second).max()
