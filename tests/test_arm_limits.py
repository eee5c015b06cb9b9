"""Limits of an arm in closed loop, the holding controller, and the supervisor."""

from dataclasses import replace

import numpy as np
import pytest
from via_bringup.demo.reference import ARM, EQUILIBRIUM
from via_controllers.contract import ArmController, ArmSample, Torques
from via_controllers.supervision.arm_limits import ArmLimits, Limit
from via_controllers.supervision.arm_supervision import Activity, Supervisor
from via_controllers.supervision.hold_still import HoldStill
from via_core.errors import ParameterError
from via_sim.robots.arm import ArmState, arm_step
from via_validation.bench.limits import FaultyController, disturbed_run, limit_rows, supervisor_of
from via_validation.control.limit_cycle import limit_cycle_controller

STILL = np.zeros(4)
UNKNOWN = np.full(4, np.nan)


def sample_of(body: ArmState, time: float = 0.0) -> ArmSample:
    return ArmSample(time, body.q, body.velocity, body.theta, body.motor_velocity, UNKNOWN)


def at_rest(q=EQUILIBRIUM) -> ArmState:
    return ArmState(q, STILL, ARM.rest(q), STILL)


# ---- limits


def test_limits_hold_in_random_courses():
    """A thousand: `via bench limits --starts 1000`."""
    rows = limit_rows(range(6))
    assert len(rows) == 12 and all(row.ok for row in rows if row.limit is not None), rows


def test_without_limits_a_faulty_controller_bends_springs_to_their_stops():
    class Loose(ArmLimits):
        def kept(self, sample, torque, step=0.0):
            return np.clip(torque, -ARM.torque_limit, ARM.torque_limit), Limit.NONE

    seeds = (2, 5, 8)
    assert not all(disturbed_run(seed, replace(supervisor_of(seed), limits=Loose(ARM))).within for seed in seeds)
    assert all(disturbed_run(seed, supervisor_of(seed)).within for seed in seeds)


def test_torques_are_unchanged_far_from_limits():
    wanted = ARM.gravity(EQUILIBRIUM) + np.array([1.0, -2.0, 0.5, 0.2])
    torque, changed = ArmLimits(ARM).kept(sample_of(at_rest()), wanted)
    assert np.array_equal(torque, wanted) and changed == Limit.NONE


@pytest.mark.parametrize(
    ("motion", "limit"),
    [
        ({}, Limit.TORQUE),
        ({"motor_velocity": np.array([7.0, 0.0, 0.0, 0.0]), "velocity": np.array([7.0, 0.0, 0.0, 0.0])}, Limit.SPEED),
        (
            {"theta": ARM.rest(EQUILIBRIUM) - [0.5, 0.0, 0.0, 0.0], "velocity": np.array([3.0, 0.0, 0.0, 0.0])},
            Limit.DEFLECTION,
        ),
    ],
)
def test_each_limit_is_reported(motion, limit):
    """The first joint, which carries no weight: near a limit its torque is reduced or reversed."""
    push = np.array([140.0 if limit is not Limit.TORQUE else 160.0, 0.0, 0.0, 0.0])
    if limit is Limit.DEFLECTION:
        push = -push
    torque, changed = ArmLimits(ARM).kept(sample_of(replace(at_rest(), **motion)), push)
    assert limit in changed and torque[0] * np.sign(push[0]) < abs(push[0])


@pytest.mark.parametrize(("period", "delay"), [(4e-3, 4e-3), (5e-3, 5e-3), (1e-2, 0.0)])
def test_a_motor_settles_at_its_speed_limit_with_slow_and_late_samples(period, delay):
    """Free motors, of which full torque is wanted all the time; the limit that knows no period is exceeded by half."""
    count, fine = round(2.0 / period), 1e-4
    for step, steady in ((period, True), (0.0, False)):
        limits = ArmLimits(FREE, drive_share=0.9)
        theta, speed, sent, speeds = np.zeros(1), np.zeros(1), [np.zeros(1)] * 2, []
        late = round(delay / fine)
        for tick in range(count):
            sample = ArmSample(tick * period, theta, speed, theta, speed, np.full(1, np.nan))
            sent = [sent[1], limits.kept(sample, np.full(1, 5.0), step)[0]]
            for part in range(round(period / fine)):
                torque = sent[0] if part < late else sent[1]
                speed = speed + fine * (torque - FREE.motor_friction * speed) / FREE.motor_inertia
                theta = theta + fine * speed
                speeds.append(float(speed[0]))
        ending = np.array(speeds[len(speeds) // 2 :])
        assert (np.max(speeds) < 0.95) == steady and (np.max(speeds) > 1.5) != steady
        assert not steady or ending == pytest.approx(np.full(len(ending), 0.9))


def test_the_supervisor_knows_the_period_of_the_samples():
    class Push(ArmController[None]):
        quantities = ()

        def init(self, sample):
            return None

        def observe(self, state):
            return np.empty(0)

        def step(self, state, sample):
            return None, Torques(np.full(1, 5.0), False)

    supervisor = Supervisor(Push(), Push(), ArmLimits(FREE, drive_share=0.9))
    state, theta, speed, speeds = supervisor.init(), np.zeros(1), np.zeros(1), []
    for tick in range(200):
        sample = ArmSample(1e-2 * tick, theta, speed, theta, speed, np.full(1, np.nan))
        state, answer = supervisor.step(state, sample, True)
        for _ in range(100):
            speed = speed + 1e-4 * (answer.torque - FREE.motor_friction * speed) / FREE.motor_inertia
            theta = theta + 1e-4 * speed
        speeds.append(float(speed[0]))
    assert np.max(speeds[100:]) < 0.91 and np.min(speeds[100:]) > 0.89


class FREE:
    """A motor without a spring, whose speed limit is 1 rad/s."""

    n = 1
    motor_inertia, motor_friction, torque_limit = np.full(1, 0.02), np.full(1, 0.05), np.full(1, 30.0)
    speed_limit, deflection_limit = np.full(1, 1.0), np.full(1, np.inf)

    @staticmethod
    def loads(q, velocity, theta, motor_velocity):
        return np.zeros(1), np.zeros(1)


def test_torques_that_are_not_finite_leave_motors_passive():
    torque, changed = ArmLimits(ARM).kept(sample_of(at_rest()), np.array([np.nan, 0.0, 0.0, 0.0]))
    assert np.array_equal(torque, STILL) and changed


@pytest.mark.parametrize("change", [{"drive_share": 1.1}, {"speed_time": 0.0}, {"deflection_rate": np.nan}])
def test_invalid_limits_are_refused(change):
    with pytest.raises(ParameterError):
        ArmLimits(ARM, **change)


# ---- holding


def test_an_arm_in_motion_comes_to_rest_where_it_was():
    controller, body = HoldStill(ARM), replace(at_rest(), velocity=np.array([0.5, -0.5, 1.0, 1.0]))
    state = controller.init(sample_of(body))
    for _ in range(3000):
        state, out = controller.step(state, sample_of(body))
        body = arm_step(ARM, body, out.torque, 1e-3, substeps=2)
    assert body.q == pytest.approx(EQUILIBRIUM, abs=0.02)
    assert np.abs(body.velocity).max() < 0.05


def test_a_load_beyond_the_springs_is_compensated_as_far_as_possible():
    heavy = replace(ARM, springs=tuple(replace(spring, max_deflection=0.05) for spring in ARM.springs))
    q = np.array([0.0, np.pi / 2, 0.0, 0.0])
    state = HoldStill(heavy).init(sample_of(ArmState(q, STILL, q, STILL)))
    assert np.abs(q - state.theta).max() <= 0.05


# ---- supervision


class Constant(ArmController[int]):
    """Counts its samples; its torque is their number."""

    quantities = ()

    def observe(self, state):
        return np.empty(0)

    def init(self, sample):
        return 0

    def step(self, state, sample):
        return state + 1, Torques(np.full(4, 1e-3 * (state + 1)), False)


def test_controllers_restart_when_their_state_is_outdated():
    supervisor, body = Supervisor(Constant(), HoldStill(ARM), ArmLimits(ARM)), at_rest()
    state, counted = supervisor.init(), []

    def at(time, active=True, **change):
        nonlocal state
        state, answer = supervisor.step(state, replace(sample_of(body, time), **change), active)
        counted.append((answer.activity, state.inner if answer.activity is Activity.ACTIVE else None))

    for time in (0.0, 0.001, 0.002):
        at(time)
    at(0.003, q=UNKNOWN)  # no values
    at(0.004, theta=np.full(4, 1e3))  # implausible values
    at(0.005)  # continues
    at(0.006, active=False)
    at(0.007)
    at(0.003)  # backward
    at(0.050)  # a gap
    active, passive, holding = Activity.ACTIVE, Activity.PASSIVE, Activity.HOLDING
    assert counted == [
        (active, 1), (active, 2), (active, 3), (passive, None), (passive, None), (active, 4), (holding, None),
        (active, 1), (active, 1), (active, 1),
    ]  # fmt: skip


def test_supervision_does_not_change_the_controller():
    """Away from the limits, torques and quantities are the same."""
    controller = limit_cycle_controller(0)
    supervisor = Supervisor(controller, HoldStill(ARM), ArmLimits(ARM))
    body = replace(at_rest(), velocity=np.array([0.1, 0.2, 0.1, 0.3]))
    state, answer = supervisor.step(supervisor.init(), sample_of(body), True)
    motion, out = controller.step(controller.init(sample_of(body)), sample_of(body))
    assert np.array_equal(answer.torque, out.torque) and answer.limited == Limit.NONE
    assert np.array_equal(supervisor.observe(state), controller.observe(motion))
    held, _ = supervisor.step(state, sample_of(body, 1e-3), False)
    assert np.isnan(supervisor.observe(held)).all()


def test_the_faulty_controller_is_reproducible():
    wild, sample = FaultyController(ARM, 3), sample_of(at_rest(), 0.5)
    assert np.array_equal(wild.step(STILL, sample)[0], wild.step(STILL, sample)[0])
