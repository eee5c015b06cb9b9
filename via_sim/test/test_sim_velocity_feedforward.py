"""Damping of a position drive that follows the speed of the goal: an independent integration, a goal that leads."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sim_joints import flexible, positioned, rigid
from sim_position_drives import KD, KP, RATE, M, goals, wave
from via_sim.effects import Effect, places
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

SERVO = f"{{kp: {KP}, kd: {KD}, feedforward: 1.0}}"


def motion(device, values, effects=(), rate: float = RATE) -> np.ndarray:
    plant = JointPlant.from_device(device).with_effects(effects)
    return simulate(plant, goals(values, rate), (len(values) - 1) / rate, rate).truth["q"]


def test_damping_acts_on_the_derivative_of_the_error():
    """A smooth goal; the derivative of the commands is half a tick late, and so is the simulation."""
    rate = 1000.0
    t = np.arange(2001) / rate

    def goal(t):
        return 0.5 - 0.5 * np.cos(3.0 * t)

    def slope(t, x):
        return x[1], (KP * (goal(t) - x[0]) + KD * (1.5 * np.sin(3.0 * t) - x[1])) / M

    found = solve_ivp(slope, (0.0, t[-1]), np.zeros(2), t_eval=t, rtol=1e-10, atol=1e-12).y[0]
    device = positioned(f"{{inertia: {M}, viscous_friction: 0.0}}", servo=SERVO)
    assert np.max(np.abs(motion(device, goal(t + 0.5 / rate))[:-1] - found[:-1])) < 1e-4
    assert np.max(np.abs(motion(positioned(servo=f"{{kp: {KP}, kd: {KD}}}"), goal(t)) - found)) > 1e-2


@pytest.mark.parametrize("late", [0.0, 0.0023])
def test_it_is_a_goal_that_leads(late):
    """g + f kd / kp times the change of the command per tick, at any dead time."""
    values = wave(800)
    led = values + 0.7 * KD / KP * np.diff(values, prepend=values[0]) * RATE
    plain = f"{{kp: {KP}, kd: {KD}, delay: {late}}}"
    effects = [Effect("velocity_feedforward", "motor", {"share": 0.7}, 1)]
    ahead = motion(positioned(servo=plain), values, effects)
    np.testing.assert_allclose(ahead, motion(positioned(servo=plain), led), atol=1e-12)
    filed = positioned(servo=plain.replace("}", ", feedforward: 0.7}"))
    np.testing.assert_allclose(ahead, motion(filed, values), atol=1e-12)


def test_the_first_goal_after_switching_on_has_no_speed():
    values = np.r_[np.full(20, np.nan), np.full(20, 0.5)]
    plain = motion(positioned(servo=f"{{kp: {KP}, kd: {KD}}}"), values)
    np.testing.assert_array_equal(motion(positioned(servo=SERVO), values), plain)


def test_only_a_position_drive_follows_the_speed_of_its_goal():
    assert places("velocity_feedforward", positioned()) == (("motor", 1),)
    assert places("velocity_feedforward", rigid()) == places("velocity_feedforward", flexible()) == ()
