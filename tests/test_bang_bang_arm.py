"""Numbers 5 and 6: modal bang-bang control of the simulated 4-dof arm, free and against a wall; printing errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from via_bringup.demo.reference import MOTORS, TURNING, damped_arm, linear_modes
from via_controllers.arms.bang_bang import BangBangState, ModalBangBang
from via_core.errors import ParameterError
from via_validation.control.arm_run import Phase, run_arm
from via_validation.control.bang_bang import degrees_between, free_motion, pushed, reference_controller
from via_validation.control.cycles import Cycles, relative_sd
from via_validation.control.hitting import hitting
from via_validation.control.nonlinear_mode import nonlinear_mode

ARM = damped_arm()


@pytest.mark.parametrize("mode", [1, 2])
def test_it_finds_a_mode_and_oscillates_regularly(mode):
    """Number 5, from a w_1(0) that selects joints without a mode of the model."""
    found = free_motion(mode, 9.0)
    assert found.angle < 3.0
    assert found.period_sd < 1e-3
    assert 1.03 < found.ratio < 1.15
    assert found.cycles >= 8 and found.run.saturated == 0.0


def test_linear_modes_are_those_of_the_held_arm():
    """(K + dg) w = omega^2 M w, dg by differences."""
    motors = np.array([0.2, 0.5, 0.3, 1.3])
    found, h = linear_modes(ARM, motors), 1e-6
    q = found.rest

    def force(at):
        return ARM.gravity(at) + ARM.spring_state(at - motors)[0]

    assert force(q) == pytest.approx(np.zeros(4), abs=1e-9)
    stiffness = np.column_stack([(force(q + h * e) - force(q - h * e)) / (2.0 * h) for e in np.eye(4)])
    for w, f in zip(found.directions.T, found.frequencies, strict=True):
        assert stiffness @ w == pytest.approx((2.0 * np.pi * f) ** 2 * ARM.inertia(q) @ w, abs=1e-4)


def returned(start, period):
    """How far [rad] the arm without friction is from `start` after a period, let go there with its motors held.

    Slow and plain: M qdd = -C qd - g - tau_e, M by the composite rigid body algorithm, DOP853.
    """
    free, motors = replace(ARM, link_friction=np.zeros(4)), np.array(MOTORS)

    def motion(_, x):
        q, v = x[:4], x[4:]
        pull = free.link_torque(q, v, np.zeros(4)) + free.spring_state(q - motors)[0]
        return np.concatenate([v, np.linalg.solve(free.inertia(q), -pull)])

    there = solve_ivp(motion, (0.0, period), np.append(start, np.zeros(4)), method="DOP853", rtol=1e-9, atol=1e-11)
    return float(np.abs(there.y[:4, -1] - start).max())


@pytest.mark.parametrize("mode", [1, 4])
def test_a_nonlinear_mode_is_periodic_and_starts_as_a_linear_one(mode):
    motors, linear = np.array(MOTORS), linear_modes(ARM, np.array(MOTORS))
    little = nonlinear_mode(ARM, motors, mode, 0.01)
    assert degrees_between(little.direction, linear.directions[:, mode - 1]) < 0.05
    assert little.frequency == pytest.approx(linear.frequencies[mode - 1], rel=1e-4)
    much = nonlinear_mode(ARM, motors, mode, 0.28)
    assert np.linalg.norm(much.path[-1] - much.path[0]) == pytest.approx(0.28, abs=1e-6)
    assert much.path[0] == pytest.approx(much.start) and much.frequency > linear.frequencies[mode - 1]
    assert returned(much.start, 1.0 / much.frequency) < 2e-5
    straight = linear.rest + 0.5 * 0.28 * linear.directions[:, mode - 1]
    assert returned(straight, 1.0 / much.frequency) > 1e-3


def test_at_this_swing_no_free_motion_is_along_linear_mode_4():
    """The criterion of number 5 for w_1 holds only for the arm's free motions 1 to 3."""
    linear = linear_modes(ARM, np.array(MOTORS)).directions
    bent = [
        degrees_between(nonlinear_mode(ARM, np.array(MOTORS), mode, 0.28).direction, linear[:, mode - 1])
        for mode in (1, 2, 3, 4)
    ]
    assert max(bent[:3]) < 3.0 and 10.0 < bent[3] < 20.0


def test_an_amplitude_without_a_periodic_motion_is_refused():
    with pytest.raises(ParameterError, match="no nonlinear mode of"):
        nonlinear_mode(ARM, np.array(MOTORS), 1, 6.0)


def test_with_the_printed_force_the_motion_dies(monkeypatch):
    """(122) with both terms at the same q; about the static equilibrium the motion persists."""
    whole = ModalBangBang._after

    def printed(self, sample, time, direction):
        here = whole(self, sample, time, direction)
        hold = self.motors
        torque = float(
            direction
            @ (
                hold.drives.spring_state(sample.q - hold.motors)[0]
                - hold.drives.spring_state(sample.q - sample.theta)[0]
            )
        )
        switch = int(np.sign(torque)) if abs(torque) > self.threshold else 0
        return BangBangState(here.time, here.direction, here.y, torque, switch)

    def swing(duration):
        controller = reference_controller(ARM, np.array([0.0, 1.0, 0.0, 1.0]))
        late = run_arm(ARM, controller, pushed(controller), (Phase(duration),)).since(duration - 0.6)
        return np.ptp(late.values[:, 0])

    assert swing(2.0) > 0.2
    monkeypatch.setattr(ModalBangBang, "_after", printed)
    assert swing(4.0) < 0.03


def test_an_offset_turns_the_direction():
    """C of q about a point beside the static equilibrium: its first component is not that of the motion."""
    controller = reference_controller(ARM, np.array([0.0, 1.0, 0.0, 1.0]))
    run = run_arm(ARM, controller, pushed(controller), (Phase(4.0),))
    motion = run.since(2.0).q - controller.motors.equilibrium

    def first(offset):
        data = motion + offset
        return np.linalg.eigh(data.T @ data)[1][:, -1]

    def turned(a, b):
        return np.degrees(np.arccos(min(1.0, abs(a @ b))))

    about_rest, mode = first(np.zeros(4)), linear_modes(ARM, controller.motors.motors).directions[:, 0]
    assert turned(about_rest, mode) < 5.0
    assert turned(first(np.array([0.1, 0.0, 0.0, 0.0])), about_rest) > 20.0


@pytest.mark.parametrize(("wall", "hold", "duration"), [(0.3, 1.2, 5.0), (0.7, 0.9, 7.0)])
def test_hitting_is_steady_from_the_second_cycle(wall, hold, duration):
    """Number 6 on the two cases that differ most; the tables have all of them."""
    case = hitting(wall, hold, duration)
    assert case.second < 0.05
    assert case.steady_sd < 5e-3
    assert case.least_force > 20.0
    assert np.abs(case.run.values[:1000, 0]).max() == pytest.approx(hold * TURNING, rel=0.2)


def test_cycles_are_counted_at_their_rises():
    time = 1e-3 * np.arange(3000)
    cycles = Cycles(time, 0.5 + np.sin(2.0 * np.pi * 3.3 * (time - 0.05)), 0.5)
    assert cycles.periods == pytest.approx(np.full(len(cycles.periods), 1.0 / 3.3), abs=1e-6)
    assert cycles.crossings[0] == pytest.approx(0.05, abs=1e-6)
    assert cycles.swings == pytest.approx(np.full(len(cycles.periods), 2.0), abs=1e-3)
    assert relative_sd(np.array([1.0, 3.0])) == pytest.approx(0.5)
