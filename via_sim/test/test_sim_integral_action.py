"""Integral action of position drives: closed forms, limits, an independent integration, switching off."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sim_joints import flexible, positioned, rigid
from sim_position_drives import KD, KP, RATE, M, goals, wave
from via_core.errors import ParameterError
from via_sim.effects import Effect, places
from via_sim.joint.layout import X
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, Simulator, command_rows, simulate

KI = 12.0
LOADED = f"{{inertia: {M}, viscous_friction: 0.02, gravity_torque: 0.3, gravity_angle: 0.2}}"


def servo(more: str = "") -> str:
    return f"{{kp: {KP}, kd: {KD}, ki: {KI}{more}}}"


def test_no_error_remains_under_a_load():
    truth = simulate(JointPlant.from_device(positioned(LOADED, servo=servo())), goals([1.0]), 16.0, RATE).truth
    assert truth["q"][-1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("rate", [1000.0, 200.0])
def test_motion_is_that_of_an_independent_integration(rate):
    """Third order, along goals that are constant during a tick; the error falls with the square of the tick."""
    steps = np.sin(5.0 * np.arange(int(2.0 * rate)) / rate)
    q = simulate(JointPlant.from_device(positioned(LOADED, servo=servo())), goals(steps, rate), 2.0, rate).truth["q"]

    def slope(t, x, goal):
        pull = KP * (goal - x[0]) + x[2] - (KD + 0.02) * x[1]
        return x[1], (pull - 0.3 * np.sin(x[0] - 0.2)) / M, KI * (goal - x[0])

    x, found = np.zeros(3), [0.0]
    for goal in steps:
        x = solve_ivp(slope, (0.0, 1.0 / rate), x, args=(goal,), rtol=1e-9, atol=1e-11).y[:, -1]
        found.append(x[0])
    assert np.max(np.abs(q - found[: len(q)])) < 2.0 / rate**2


def test_the_torque_of_the_integral_has_a_limit():
    """A link that cannot reach its goal: kp e + limit = load at rest."""
    device = positioned(LOADED, servo=servo(", integral_limit: 0.05"))
    q = simulate(JointPlant.from_device(device), goals([1.0]), 8.0, RATE).truth["q"][-1]
    assert KP * (1.0 - q) + 0.05 == pytest.approx(0.3 * np.sin(q - 0.2), abs=1e-9)


def test_the_torque_of_the_integral_at_the_start_is_that_of_the_effect():
    effects = [Effect("integral_action", "motor", {"rate": 1e-9, "start": 0.3 * np.sin(0.8)}, 1)]
    plant = JointPlant.from_device(positioned(LOADED)).with_effects(effects)
    truth = simulate(plant, goals([1.0]), 1.0, RATE, initial=InitialConditions([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])).truth
    assert np.max(np.abs(truth["q"] - 1.0)) < 1e-9  # it holds the load


def test_a_drive_that_was_off_begins_anew():
    plant = JointPlant.from_device(positioned(LOADED, servo=servo()))
    simulator = Simulator(plant, RATE)
    values = np.r_[np.full(300, 0.5), np.full(10, np.nan), np.full(1, 0.5)]
    state, held = simulator.init(), []
    for row in command_rows(plant.device, goals(values), np.arange(len(values)) / RATE):
        state, _, _ = simulator.step(state, row)
        held.append(state[X.integral])
    assert abs(held[299]) > 0.02
    assert held[305] == 0.0
    assert 0.0 < abs(held[-1]) < 0.01


def test_only_a_position_drive_has_integral_action():
    assert places("integral_action", positioned()) == (("motor", 1),)
    assert places("integral_action", rigid()) == places("integral_action", flexible()) == ()
    with pytest.raises(ParameterError, match="no position drive"):
        JointPlant.from_device(flexible()).with_effects(
            [Effect("integral_action", "motor", {"rate": 1.0, "start": 0.0}, 1)]
        )


def test_an_effect_adds_to_the_gain_of_the_device_file():
    filed = JointPlant.from_device(positioned(LOADED, servo=servo()))
    half = JointPlant.from_device(positioned(LOADED, servo=servo().replace(str(KI), str(0.5 * KI))))
    beside = half.with_effects([Effect("integral_action", "motor", {"rate": 0.5 * KI / KP, "start": 0.0}, 1)])
    q = [simulate(each, goals(wave(500)), 0.5, RATE).truth["q"] for each in (filed, beside)]
    assert np.max(np.abs(q[0] - q[1])) < 1e-12
