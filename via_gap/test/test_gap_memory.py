"""Elements with memory along a measured motion: integration step by step, and segments without it."""

from math import exp

import numpy as np
import pytest
from gap_logs import flexible, log_of, positioned
from via_core.signals import Signals
from via_gap.residual.memory import (
    GOAL_NUMBERS,
    DriveGoals,
    _follow,
    goals_along,
    torques_along,
    with_late_goal,
    with_memory,
)
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect
from via_sim.joint.layout import X
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.simulate import Simulator, command_rows

MAXWELL = Effect("hysteresis", "transmission", {"torque": 0.05, "stiffness": 0.25}, 1)
BRISTLE = Effect("presliding_friction", "link", {"torque": 0.03, "stiffness": 0.2}, 0)


def test_what_is_held_is_the_law_step_by_step():
    time = np.arange(4000) * 1e-3
    link, motor = 0.6 * np.sin(3.0 * time) + 0.1 * np.sin(11.0 * time), 0.3 * np.sin(2.2 * time + 1.0)
    angles = np.column_stack([link, motor, np.full(len(time), np.nan)])
    row = JointPlant.from_device(flexible()).parameters.copy()
    plain = row.copy()
    for effect in (MAXWELL, BRISTLE):
        effect.write(row)
    ticks = np.array([3999, 0, 1234, 700])
    held = torques_along(np.stack([plain, row]), angles, ticks)

    spring, bristle, springs, bristles = 0.0, 0.0, [0.0], [0.0]
    for k in range(1, len(time)):
        travel = (link[k] - motor[k]) - (link[k - 1] - motor[k - 1])
        spring = min(max(spring + 0.25 * travel, -0.05), 0.05)
        way = link[k] - link[k - 1]
        end = np.sign(way) * 0.03
        bristle = end + (bristle - end) * exp(-abs(way) * 0.2 / 0.03)
        springs.append(spring)
        bristles.append(bristle)
    assert not held[0].any()
    assert held[1, :, 3] == pytest.approx([springs[k] for k in ticks], abs=1e-12)
    assert np.abs(held[1, :, 0]) == pytest.approx(np.abs([bristles[k] for k in ticks]), abs=1e-12)
    assert max(map(abs, springs)) == 0.05 and min(map(abs, springs[500:])) < 0.02
    assert with_memory(np.stack([plain, row])).tolist() == [False, True]
    assert row[P.hysteresis_torque] == 0.05


@pytest.mark.parametrize("effect", [MAXWELL, BRISTLE], ids=str)
def test_shots_cut_out_of_a_log_know_what_was_held_before_them(effect):
    """Both reverse many times between two slips, so that a start that holds nothing is far off."""
    log = log_of(flexible(), (effect,), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    whole = ResidualModel.of([segments], [np.arange(1, len(segments))])
    few, _ = whole.part([np.arange(4, len(segments) - 1, 5)])
    assert np.max(few.per_segment(few.residual([few.row([effect])])[0])) < 3.0
    assert np.median(few.per_segment(few.residual([few.row(())])[0])) > 10.0


SLOW = Effect("speed_limit", "command", {"limit": 0.6})
LAG = Effect("actuator_lag", "command", {"time_constant": 0.2})
AHEAD = Effect("velocity_feedforward", "motor", {"share": 0.5}, 1)
INTEGRAL = Effect("integral_action", "motor", {"rate": 2.0, "start": 0.1}, 1)


@pytest.mark.parametrize(
    "effects", [(SLOW,), (LAG,), (SLOW, LAG), (INTEGRAL,), (SLOW, LAG, INTEGRAL), (SLOW, AHEAD)], ids=str
)
def test_a_goal_is_as_far_behind_as_in_the_simulator_and_so_is_the_integral(effects):
    """Through a interval in which the drive is off, at ticks in any order."""
    device = positioned()
    time = np.arange(2000) / 500.0
    goal = 0.8 * np.sin(2.0 * time) + 0.2 * np.sign(np.sin(5.0 * time))
    goal[700:760] = np.nan
    commands = command_rows(device, Signals(time, {"equilibrium": goal}, {"equilibrium": "rad"}), time)
    plant = JointPlant.from_device(device).with_effects(effects)
    simulator = Simulator(plant, 500.0)
    state, measured, expected = simulator.init((goal[0], 0, 0, 0, 0, 0)), [], []
    for k in range(len(time)):
        expected.append([state[X.behind], state[X.lag], state[X.integral]])
        state, _, _ = simulator.step(state, commands[k])
        measured.append(state[0])
    on = np.isfinite(goal)
    ticks = np.flatnonzero(on & np.roll(on, 4) & np.roll(on, 5))[::-7]  # the command that acted last was a goal
    nominal = JointPlant.from_device(device).at_rate(500.0)
    found = goals_along(np.stack([nominal, plant.at_rate(500.0)]), commands, np.array([goal[0], *measured[:-1]]), ticks)
    assert not found[0].any()
    expected = np.array(expected)[ticks]
    np.testing.assert_allclose(found[1][:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(found[1][:, 2], expected[:, 2], atol=5e-6)  # the angle within a tick is interpolated
    assert np.abs(found[1]).max() > 0.1


@pytest.mark.parametrize("effects", [(SLOW, LAG), (INTEGRAL,), (SLOW, AHEAD)], ids=str)
def test_goals_that_are_kept_are_those_of_each_row_alone(effects):
    """Every number of the drive matters, or its change leaves the goal as it was; the second answer is the kept one."""
    device, rng = positioned(), np.random.default_rng(0)
    row = JointPlant.from_device(device).with_effects(effects).at_rate(500.0)
    rows = np.stack([JointPlant.from_device(device).at_rate(500.0), row, *np.repeat(row[None], len(GOAL_NUMBERS), 0)])
    rows[range(2, len(rows)), GOAL_NUMBERS] *= np.where(np.isfinite(row[GOAL_NUMBERS]), 0.7, 1.0)
    time = np.arange(1000) / 500.0
    goal = 0.8 * np.sin(2.0 * time) + 0.2 * np.sign(np.sin(5.0 * time))
    commands = command_rows(device, Signals(time, {"equilibrium": goal}, {"equilibrium": "rad"}), time)
    measured, ticks = 0.9 * goal + 0.01 * rng.normal(size=1000), np.arange(3, 990, 40)
    alone = np.zeros((len(rows), len(ticks), 3))
    late = np.flatnonzero(with_late_goal(rows))
    _follow(commands, measured, rows[late], ticks, alone[late[0] :])  # all rows but the first
    assert late.tolist() == [*range(1, len(rows))] and np.abs(alone).max() > 0.01
    goals = DriveGoals(commands, measured, ticks)
    for _ in range(2):
        assert np.array_equal(goals.states(rows), alone)
    assert np.array_equal(goals.states(rows, np.repeat(commands[None], len(rows), axis=0)), alone)
    assert 1 < len(goals._found) < len(late)
