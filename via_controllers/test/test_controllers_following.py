"""Motors that do not follow their torque: when the torque ends, and when it returns."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from via_controllers.contract import ArmSample
from via_controllers.supervision.arm_supervision import GAP
from via_controllers.supervision.following import ERROR, FRICTION, REST, FollowingDetection


class Motors:
    """Two motors of qbmove_a without springs."""

    n = 2
    motor_inertia, motor_friction = np.full(2, 0.0233), np.full(2, 0.2698)
    torque_limit, speed_limit, deflection_limit = np.full(2, 6.0), np.full(2, 6.0), np.full(2, np.inf)

    def loads(self, q, velocity, theta, motor_velocity):
        return np.zeros(2), np.zeros(2)


AXES = Motors()
DETECTION = FollowingDetection(AXES)
STEP = 1e-3  # [s]
ZEROS = np.zeros(2)
Measured = Callable[[np.ndarray, int], np.ndarray]


def driven(
    measured: Measured, seconds: float, force: Callable[[float, np.ndarray], np.ndarray], share=1.0, delay=0, every=1
):
    """Times [s] at which torque acted on free motors whose angles (2,) are read as `measured(theta, tick)`.

    force  torque (2,) [N m] at a time for measured angles; share: of the true inertia in the device; delay in ticks
    """
    theta, speed, times, torque = np.zeros(2), np.zeros(2), [], np.zeros(2)
    queue = [np.zeros(2)] * (delay + 1)
    inertia, friction = AXES.motor_inertia / share, AXES.motor_friction
    state = None
    for tick in range(round(seconds / STEP)):
        if tick % every == 0:
            read = measured(theta, tick)
            sample = ArmSample(tick * STEP, read.copy(), ZEROS, read, ZEROS, np.full(2, np.nan))
            state = DETECTION.init(sample) if state is None else DETECTION.step(state, sample, torque, GAP)
            holds = DETECTION.holds(state)
            torque = np.zeros(2) if holds else force(tick * STEP, read)
            if not holds:
                times.append(tick * STEP)
        queue = [*queue[1:], torque]
        speed = (speed + STEP * queue[0] / inertia) / (1.0 + STEP * friction / inertia)
        theta = theta + STEP * speed
    return np.array(times)


def pushed(time: float, _read: np.ndarray) -> np.ndarray:
    return np.array([3.0, -3.0])


def swung(time: float, _read: np.ndarray) -> np.ndarray:
    return 3.0 * np.sin(2.0 * np.pi * np.array([1.0, 1.3]) * time)


def switched(time: float, _read: np.ndarray) -> np.ndarray:
    return 3.0 * np.sign(np.sin(2.0 * np.pi * np.array([1.0, 1.3]) * time + 0.1))


def held(_time: float, read: np.ndarray) -> np.ndarray:
    """A servo that returns to zero, with the sign that the encoder should have."""
    return np.clip(-20.0 * (read - 0.1), -6.0, 6.0)


@pytest.mark.parametrize(
    ("measured", "force"),
    [
        (lambda _theta, _tick: np.zeros(2), pushed),
        (lambda _theta, tick: 1e-4 * np.full(2, tick % 2), pushed),
        (lambda _theta, tick: 1e-3 * np.random.default_rng(tick).normal(size=2), pushed),
        (lambda theta, _tick: -theta, held),
        (lambda theta, _tick: (theta + np.pi) % (2.0 * np.pi) - np.pi, pushed),
        (lambda theta, _tick: theta[::-1], swung),
    ],
    ids=["frozen", "flickers", "noise", "reversed", "wrapped", "exchanged"],
)
def test_a_wrong_encoder_lets_torque_through_ever_more_rarely(measured, force):
    times = driven(measured, 20.0, force)
    rests = np.diff(times)[np.diff(times) > 0.5 * REST]
    assert rests[:3] == pytest.approx([REST, 2.0 * REST, 4.0 * REST], abs=3.0 * STEP)
    first = times[times < times[0] + 0.5 * REST]
    assert len(times) * STEP < 6.0 and len(first) * STEP < 2.5


@pytest.mark.parametrize(
    "case",
    [
        {}, {"share": 0.75}, {"share": 1.3}, {"delay": 5}, {"delay": 5, "force": switched}, {"every": 4, "delay": 2},
        {"every": 10},
    ],
    ids=["exact", "light", "heavy", "delayed", "switched", "slow", "slowest"],
)  # fmt: skip
def test_motors_that_follow_are_never_stopped(case):
    """An encoder of 14 bit, inertia a quarter off, a delay of 5 ms, samples of 250 and 100 Hz."""
    count = len(driven(lambda theta, _: np.round(theta / 3.8e-4) * 3.8e-4, 8.0, **{"force": swung} | case))
    assert count == round(8.0 / STEP / case.get("every", 1))


def test_an_encoder_that_freezes_in_motion_shows_it_by_a_torque_that_friction_could_balance():
    torque = 0.5 * FRICTION * AXES.torque_limit
    last: dict[str, np.ndarray] = {}

    def freezes(theta: np.ndarray, tick: int) -> np.ndarray:
        return last.setdefault("at", theta) if tick > 1000 else theta

    times = driven(freezes, 4.0, lambda _time, _read: torque)
    assert np.all(torque < FRICTION * AXES.torque_limit + ERROR * torque)
    assert 1.0 < times[np.diff(times, append=np.inf) > 0.5 * REST][0] < 1.03


def test_a_motor_that_sticks_in_its_friction_is_no_frozen_encoder():
    """It slows down to a rest, and repeats one number under a small torque from then on."""
    torque = 0.5 * FRICTION * AXES.torque_limit

    def slows(_theta: np.ndarray, tick: int) -> np.ndarray:
        return np.full(2, round(0.3 * (1.0 - np.exp(-tick / 200.0)) / 1e-4) * 1e-4)

    assert len(driven(slows, 4.0, lambda _time, _read: torque)) == 4000


def test_the_length_of_the_rest_returns_once_the_motors_have_followed():
    sample = ArmSample(0.0, ZEROS, ZEROS, ZEROS, ZEROS, np.full(2, np.nan))
    state = replace(DETECTION.init(sample), until=0.0, rest=4.0)
    for tick in range(1, 4500):
        state = DETECTION.step(state, replace(sample, time=tick * STEP), ZEROS, GAP)
        assert state.rest == (4.0 if tick * STEP <= 4.0 + 1e-9 else REST)
