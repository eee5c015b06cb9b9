"""Torques that act late: the state at that time against fine integration, and speed limits that hold with it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from via_bringup.demo.reference import throwing_controller
from via_controllers.arm_methods import HoppingParameters
from via_controllers.contract import ArmController, ArmSample, JointSample, Torques
from via_controllers.joint_axes import JointAxes
from via_controllers.joint_methods import ExcitationParameters, MaxVelocityParameters
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import GAP, Supervisor
from via_controllers.supervision.delay import Sent, ahead, mean_torque, steps_of, still_acting
from via_controllers.supervision.joint_supervision import JointSupervisor
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

ARM = load_vsa_arm("reference_2dof")
SENT = tuple(Sent(k * 1e-3, np.array([10.0 * k, -5.0 * k])) for k in range(8))
SAMPLE = ArmSample(8e-3, *np.array([[0.4, 1.0], [1.0, -2.0], [0.35, 1.1], [3.0, 2.0]]), np.array([1.0, np.nan]))


def commanded(time, delay):
    """The torque that acts at `time`, one command after the other."""
    torque = np.zeros(ARM.n)
    for each in SENT:
        if each.stamp + delay <= time + 1e-12:
            torque = each.torque
    return torque


@pytest.mark.parametrize("delay", [0.5e-3, 2e-3, 2.3e-3, 7.5e-3, 20e-3])
def test_the_mean_torque_is_that_of_many_short_times(delay):
    begin, end = SAMPLE.time, SAMPLE.time + delay
    fine = begin + (np.arange(20000) + 0.5) * delay / 20000
    expected = np.mean([commanded(time, delay) for time in fine], axis=0)
    assert mean_torque(SENT, begin, end, delay) == pytest.approx(expected, rel=1e-3)
    kept = still_acting(SENT, begin, delay)
    assert np.array_equal(mean_torque(kept, begin, end, delay), mean_torque(SENT, begin, end, delay))
    assert len(kept) <= delay / 1e-3 + 2


def test_no_torque_acts_before_the_first_command():
    assert np.all(mean_torque((), 0.0, 1e-3, 1e-3) == 0.0)
    assert mean_torque(SENT[1:2], 1.5e-3, 2.5e-3, 1e-3) == pytest.approx(0.5 * SENT[1].torque)


def test_a_predicted_sample_is_that_of_fine_integration():
    """The mean torque in place of the steps leaves an error of second order in the delay."""
    delay, steps, none = 2e-3, 2000, np.zeros(ARM.n)
    x = np.array([SAMPLE.q, SAMPLE.q_velocity, SAMPLE.theta, SAMPLE.theta_velocity])
    for k in range(steps):
        x = x + delay / steps * ARM.rates(x, commanded(SAMPLE.time + k * delay / steps, delay), none)
    seen = ahead(ARM, SAMPLE, SENT, delay)
    assert seen.time == SAMPLE.time + delay
    moved = np.abs(x - np.array([SAMPLE.q, SAMPLE.q_velocity, SAMPLE.theta, SAMPLE.theta_velocity])).max(axis=1)
    for now, fine, far in zip((seen.q, seen.q_velocity, seen.theta, seen.theta_velocity), x, moved, strict=True):
        assert np.abs(now - fine).max() < 0.01 * far
    springs = [ARM.spring_state(each[0] - each[2])[0][0] for each in ((SAMPLE.q, None, SAMPLE.theta), x)]
    assert seen.spring_torque[0] == pytest.approx(1.0 + springs[1] - springs[0], rel=1e-2)
    assert np.isnan(seen.spring_torque[1])


class Records(ArmController[int]):
    """Keeps the samples it is given and pushes."""

    quantities = ()

    def __init__(self):
        self.seen = []

    def init(self, sample):
        return 0

    def step(self, state, sample):
        self.seen.append(sample)
        return state + 1, Torques(np.full(ARM.n, 1.0 + state), False)

    def observe(self, state):
        return np.zeros(0)


def test_a_supervisor_predicts_from_what_it_has_sent():
    records, delay = Records(), 3e-3
    supervisor, sent = Supervisor(records, Records(), ArmLimits(ARM), delay), ()
    state = supervisor.init()
    for k in range(6):
        sample = replace(SAMPLE, time=k * 1e-3)
        state, out = supervisor.step(state, sample, active=True)
        expected = ahead(ARM, sample, sent, delay)
        assert records.seen[-1].time == expected.time and np.array_equal(records.seen[-1].theta, expected.theta)
        sent = (*sent, Sent(sample.time, out.torque))
    assert len(state.sent) <= 5
    state, _ = supervisor.step(state, replace(SAMPLE, time=1.0 + GAP), active=True)  # nothing acts after a gap
    assert np.array_equal(records.seen[-1].theta, ahead(ARM, SAMPLE, (), delay).theta) and len(state.sent) == 1


def test_what_is_no_answer_of_the_controller_acts_as_no_torque():
    """Late answers, and those to unusable samples; an unknown stamp changes nothing, a stamp sent twice is one."""
    records, delay = Records(), 3e-3
    supervisor = Supervisor(records, Records(), ArmLimits(ARM), delay)
    state, out = supervisor.step(supervisor.init(), replace(SAMPLE, time=0.0), active=True)
    twice, again = supervisor.step(state, replace(SAMPLE, time=0.0), active=True)
    assert np.array_equal(mean_torque(twice.sent, 3e-3, 4e-3, delay), again.torque)
    assert not np.array_equal(again.torque, out.torque)
    late, _ = supervisor.step(state, replace(SAMPLE, time=1e-3), active=True, acts=False)
    assert np.array_equal(mean_torque(late.sent, 3e-3, 5e-3, delay), 0.5 * out.torque)
    lost, _ = supervisor.step(state, replace(SAMPLE, time=1e-3, q=np.full(ARM.n, np.nan)), active=True)
    assert np.array_equal(mean_torque(lost.sent, 3e-3, 5e-3, delay), 0.5 * out.torque)
    unknown, _ = supervisor.step(state, replace(SAMPLE, time=np.nan), active=True)
    assert unknown.sent is state.sent


def test_a_joint_remembers_that_a_lost_sample_was_answered_by_no_torque():
    joint = ExcitationParameters(delay=3e-3)
    joint = joint.tuned(joint.build().supervisor)
    state, _ = joint.step(joint.init(), JointSample(0.0, 0.0, np.array([0.6, -0.6])), True)
    lost, _ = joint.step(state, JointSample(1e-3, np.nan, np.zeros(2)), True)
    assert [each.stamp for each in lost.inner.sent] == [0.0, 1e-3] and not lost.inner.sent[1].torque.any()
    assert lost.time == state.time


def test_motors_that_are_fast_are_predicted_in_steps_or_refused():
    axes, seconds = JointAxes(load_device("visco_elastic_demo")), 0.1
    steps = steps_of(axes, seconds)
    sample = ArmSample(0.0, *np.array([[0.1], [0.5], [0.0], [0.8]]), np.array([np.nan]))
    seen, x, short = ahead(axes, sample, (), seconds, steps), np.array([[0.1], [0.5], [0.0], [0.8]]), seconds / 20000
    for _ in range(20000):
        tau_e, acceleration = axes.loads(*x)
        push = (tau_e - axes.motor_friction * x[3]) / axes.motor_inertia
        x = x + short * np.array([x[1], acceleration, x[3], push])
    assert steps > 1 and seen.theta == pytest.approx(x[2], abs=1e-3)
    assert seen.theta_velocity == pytest.approx(x[3], abs=0.02)
    limits = ArmLimits(JointAxes(load_device("cubic_aa_vsa")))
    with pytest.raises(ParameterError, match=r"the motors are too fast to predict 0\.005 s; at most 0\.00"):
        Supervisor(Records(), Records(), limits, 5e-3)
    with pytest.raises(ParameterError) as error:
        Supervisor(Records(), Records(), limits, 0.1)
    longest = float(str(error.value).split()[-2])
    assert Supervisor(Records(), Records(), limits, longest).delay == longest > 1e-3
    with pytest.raises(ParameterError, match="contacts of the feet cannot be predicted"):
        HoppingParameters(delay=1e-3).build()


def test_without_a_delay_samples_are_used_as_they_are():
    records = Records()
    supervisor = Supervisor(records, Records(), ArmLimits(ARM))
    state, _ = supervisor.step(supervisor.init(), SAMPLE, active=True)
    assert records.seen[-1] is SAMPLE and state.sent == ()
    with pytest.raises(ParameterError, match="delay must be >= 0"):
        Supervisor(records, Records(), ArmLimits(ARM), -1e-3)


def fastest_motor(late, stated):
    """Largest speed of a thrown joint's motor over its limit, its torques `late` samples late, at 1 kHz."""
    device = load_device("visco_elastic_demo")
    controller, _ = throwing_controller(device, 0.0, 3)
    joint = JointSupervisor.of(controller, JointAxes(device), drive=1.0)
    joint = MaxVelocityParameters(delay=stated * 1e-3).tuned(joint)
    simulator = Simulator(JointPlant.from_device(device), 1000.0, Sensors.of_device(device))
    body, state, torques, fastest = simulator.init(seed=1), joint.init(), [0.0] * late, 0.0
    measured, _ = simulator.sample(body)
    for tick in range(round((controller.horizon + 0.3) * 1000.0)):
        state, out = joint.step(state, JointSample(tick * 1e-3, measured[0], measured[1:2]), True)
        assert not out.fault
        torques.append(out.torque[0])
        body, measured, _ = simulator.step(body, [torques.pop(0), 0.0, 0.0, 0.0])
        fastest = max(fastest, abs(body[4]))
    return fastest / controller.velocity


def speeds_and_faults(stated):
    """Speeds of a motor that follows multisines at 100 Hz, its torques 10 ms late, and the number of faults."""
    rate, device = 100.0, load_device("cubic_demo")
    joint = ExcitationParameters(delay=stated)
    joint = joint.tuned(joint.build().supervisor)
    simulator = Simulator(JointPlant.from_device(device), rate, Sensors.of_device(device))
    body, state, waiting, speeds, faults = simulator.init(seed=1), joint.init(), np.zeros(2), [], 0
    measured, _ = simulator.sample(body)
    for tick in range(round(6.0 * rate)):
        state, out = joint.step(state, JointSample(tick / rate, measured[0], measured[1:3]), True)
        faults += bool(out.fault)
        body, measured, _ = simulator.step(body, [*waiting, 0.0, 0.0])
        waiting = out.torque
        speeds.append(body[4])
    return np.array(speeds[len(speeds) // 2 :]), faults


def test_a_loop_that_is_too_slow_without_its_delay_is_stable_with_it():
    (fast, faults), (slow, none) = speeds_and_faults(0.0), speeds_and_faults(0.01)
    assert faults > 100 and none == 0
    assert np.diff(fast).std() > 4.0 * np.diff(slow).std()


@pytest.mark.parametrize(("late", "without"), [(2, 1.2), (5, 2.0)])
def test_speed_limits_hold_with_late_torques_that_are_stated(late, without):
    fastest = partial(fastest_motor, late)
    assert fastest(0) > without and fastest(late) < 1.02
