"""The modal limit cycle on the simulated 4-dof arm of flexible joints at 1 kHz."""

from dataclasses import replace

import numpy as np
import pytest
from via_bringup.demo.reference import ARM, LEVEL
from via_bringup.demo.reference import EQUILIBRIUM as REST
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.contract import ArmSample
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import Supervisor
from via_controllers.supervision.hold_still import HoldStill
from via_core.errors import ParameterError
from via_sim.robots.arm import ArmState, arm_step
from via_sim.robots.contacts import Hand
from via_validation.control.arm_run import PERIOD, Phase, TorqueNoise, run_arm
from via_validation.control.limit_cycle import CycleCourse, cycling, in_modes, limit_cycle_controller, start

STILL, NO_SENSOR = np.zeros(4), np.full(4, np.nan)


def sample_of(body: ArmState) -> ArmSample:
    return ArmSample(0.0, body.q, body.velocity, body.theta, body.motor_velocity, NO_SENSOR)


def run(controller: VsaModalLimitCycle, duration: float, noise: TorqueNoise | None = None) -> CycleCourse:
    """Modal quantities of a run of the controller on the arm."""
    course = cycling(controller, duration, noise=noise)
    assert course.saturated == 0.0
    return in_modes(controller.cycle, course.q, course.velocity)


@pytest.mark.parametrize("mode", [0, 1])
def test_the_cycle_on_flexible_joints(mode):
    """Number 2: H within 2e-3, leak below 1e-4, 2 % after 1.2 s, frequency within .5 %."""
    course = run(limit_cycle_controller(mode), 3.0)
    assert abs(course.H[0]) > 0.5
    assert np.abs(course.H[course.late]).max() < 2e-3
    assert course.leak[course.late].max() < 1e-4
    assert np.abs(course.H[round(1.2 / PERIOD) :]).max() < 0.02
    frequency, linear = course.frequencies()
    assert frequency == pytest.approx(linear, rel=5e-3)


@pytest.mark.parametrize("mode", [0, 1])
def test_noise_of_torque_sensors_stays_small(mode):
    course = run(limit_cycle_controller(mode), 3.0, noise=TorqueNoise(0.05))
    assert 1e-4 < course.leak[course.late].max() < 2e-3


def test_without_feed_forward_the_cycle_is_missed(monkeypatch):
    """(107) with tau_ed' = tau_ed'' = 0: the spring torques lag."""
    controller = limit_cycle_controller(0)
    whole = VsaModalLimitCycle.reference

    def held(self, *args):
        return whole(self, *args)._replace(rate=STILL, second=STILL)

    monkeypatch.setattr(VsaModalLimitCycle, "reference", held)
    course = run(controller, 3.0)
    assert np.abs(course.H[course.late]).max() > 0.02


@pytest.mark.parametrize("direction", [0.0, -0.4])
def test_derivatives_of_the_reference_are_those_along_the_motion(direction):
    """Compared with the reference along the simulated motion and the direction of the start.

    The step is smaller than the default 2 ms, which leaves an error from the third derivative of the start.
    """
    controller, h = replace(limit_cycle_controller(0), difference_step=5e-4), 1e-4

    def seen(body, direction):
        return sample_of(body), controller.cycle.at(controller.cycle.init(body.q), body.q, body.velocity, direction)

    bodies = [start(controller)]
    for _ in range(2):
        bodies.append(arm_step(ARM, bodies[-1], ARM.gravity(REST), h))
    rate = seen(bodies[1], direction)[1].turning
    directions = [direction + rate * s for s in (-h, 0.0, h)]
    torques = [-seen(body, each)[1].torque for body, each in zip(bodies, directions, strict=True)]
    sample, motion = seen(bodies[1], direction)
    assert (motion.push != 0.0) == (direction != 0.0) and rate != 0.0
    reference = controller.reference(motion, sample, controller.tracking.observed(sample))
    assert reference.torque == pytest.approx(torques[1])
    rate, second = (torques[2] - torques[0]) / (2 * h), (torques[2] - 2 * torques[1] + torques[0]) / h**2
    assert reference.rate == pytest.approx(rate, abs=2e-3 * np.abs(rate).max())
    assert reference.second == pytest.approx(second, abs=2e-3 * np.abs(second).max())


def test_it_starts_from_rest_within_limits():
    """Within 10 % after one period and 2 % after a period and a half; noise does not reverse the push."""
    for mode, period in ((0, 0.586), (1, 0.472)):
        course = cycling(
            limit_cycle_controller(mode), 1.6 * period, share=0.0, noise=TorqueNoise(0.05) if mode else None
        )
        H, s = course.quantity("H") / LEVEL, course.quantity("s")
        assert course.saturated == 0.0 and H[0] == pytest.approx(0.0, abs=1e-12)
        assert np.abs(H[round(period / PERIOD) :] - 1.0).max() < 0.1
        assert np.abs(H[round(1.5 * period / PERIOD) :] - 1.0).max() < 0.02
        ways = np.sign(s[s != 0.0])
        assert np.count_nonzero(np.diff(ways)) <= 1 and not s[H >= 0.8].any() and np.all(np.diff(H[H < 0.8]) > -1e-4)
        assert 0.45 < np.abs(s).max() / np.sqrt(2.0 * LEVEL) < 0.5


def test_held_at_rest_and_released_it_starts():
    """Number 3 in the hardest case, held at z = 0: the hand bears a steady force, and the cycle converges in time."""
    controller = limit_cycle_controller(0)
    hand = Hand(ARM.tip_position(REST))
    held = run_arm(ARM, controller, start(controller, 0.0), (Phase(0.5, (hand,), 4),))
    force = np.linalg.norm(held.force[-100:], axis=1)
    assert force.min() > 10.0 and force.max() < 1.05 * force.min() and held.quantity("H")[-1] < 0.01 * LEVEL
    H = run_arm(ARM, controller, held.body, (Phase(1.1),), state=held.state).quantity("H") / LEVEL
    assert np.abs(H[586:] - 1.0).max() < 0.1 and np.abs(H[879:] - 1.0).max() < 0.02


def test_the_start_only_matters_away_from_the_cycle():
    printed = limit_cycle_controller(0, start=0.0)
    assert cycling(printed, 0.2, share=0.0).quantity("H").max() < 1e-20
    theirs, ours = (cycling(controller, 0.3, share=1.0) for controller in (printed, limit_cycle_controller(0)))
    assert np.array_equal(theirs.torque, ours.torque) and np.array_equal(theirs.values, ours.values)


def test_the_direction_turns_a_bounded_step_between_samples():
    """After a pause the push continues from its last value."""
    controller = limit_cycle_controller(0)
    sample = sample_of(start(controller))
    state = controller.init(sample)
    short, long = (controller.step(state, replace(sample, time=time))[0].motion for time in (0.01, 0.5))
    assert short.direction == long.direction != 0.0
    assert controller.step(state, replace(sample, time=-1.0))[0].motion.direction == 0.0


def test_invalid_samples_give_zero_torque():
    controller = limit_cycle_controller(0)
    sample = ArmSample(0.0, REST, STILL, REST, STILL, NO_SENSOR)
    state = controller.init(sample)
    for broken in ({"theta": np.array([0.2, np.nan, 0.3, 1.2])}, {"time": np.nan}):
        after, out = controller.step(state, replace(sample, **broken))
        assert after is state and np.array_equal(out.torque, STILL)


def test_observed_quantities_have_names():
    controller = limit_cycle_controller(1)
    state = controller.init(sample_of(start(controller)))
    observed = dict(zip([each.name for each in controller.quantities], controller.observe(state), strict=True))
    assert observed["z_2"] == pytest.approx(0.1, rel=0.02) and observed["H"] == pytest.approx(
        0.5 * observed["z_2"] ** 2
    )
    assert observed["V"] == pytest.approx(0.5 * (observed["H"] - LEVEL) ** 2)
    assert observed["frequency_2"] > observed["frequency_1"] > 0.3


@pytest.mark.parametrize("change", [{"difference_step": 0.0}, {"bandwidth": 0.0}])
def test_invalid_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(limit_cycle_controller(0), **change)


@pytest.mark.parametrize(
    ("mode", "shift"),
    [(1, (0.8, -0.8, 0.8, -0.8)), (1, (-0.5, -0.5, -0.5, -0.5)), (0, (-0.5, -0.5, -0.5, -0.5))],
    ids=str,
)
def test_the_cycle_is_reached_from_a_rest_far_from_it(mode, shift):
    """Without the case far from the cycle, these starts end in a swing at the limits, or converge seconds later."""
    controller = limit_cycle_controller(mode)
    supervisor = Supervisor(controller, HoldStill(ARM), ArmLimits(ARM))
    q = REST + np.array(shift)
    body, state, levels = ArmState(q, STILL, ARM.rest(q), STILL), supervisor.init(), []
    for tick in range(9000):
        sample = replace(sample_of(body), time=tick * PERIOD)
        state, answer = supervisor.step(state, sample, True)
        levels.append(supervisor.observe(state)[0] / LEVEL)
        body = arm_step(ARM, body, answer.torque, PERIOD, substeps=2)
    assert np.array(levels[-1000:]) == pytest.approx(np.ones(1000), abs=0.02)
