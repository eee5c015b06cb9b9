"""Designed excitation: the prescribed motion against the simulator, limits, search, duration and verification."""

from __future__ import annotations

import numpy as np
import pytest
from via_controllers.contract import JointSample
from via_controllers.joint_methods import ExcitationParameters
from via_core.command_files import columns_of, read_motion, write_table
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_gap.design.excitation_file import commanded
from via_gap.design.excite import RATE, Effort, Goal, Problem, Series, search
from via_gap.design.excite_check import Check
from via_gap.design.excite_design import Settings, design
from via_gap.design.prescribed import prescribed
from via_sim.plants import JointPlant
from via_sim.simulate import Simulator, simulate

NOISE = 0.03


def problem(name: str = "cubic_demo", goal: Goal | None = None, margin: float = 0.9) -> Problem:
    return Problem.of(load_device(name), goal or Goal(), margin, NOISE)


def series() -> Series:
    coefficients = np.zeros((2, 2, 4))
    coefficients[0, 0, 1], coefficients[1, 0, 0] = 0.1, 0.15
    return Series(0.6, 0.4, coefficients)


@pytest.mark.parametrize("name", ["qbmove_a", "vsa2", "visco_elastic_demo"])
def test_torques_of_a_prescribed_motion_reproduce_it_on_the_simulator(name):
    device = load_device(name)
    time = np.arange(3001) / 1000.0
    angles = series().scaled(0.3).angles(time, device.n_motors)
    found = prescribed(device, time, angles)
    commands = Signals(time, {"motor": found.torque}, {"motor": "N m"}, frozenset({"motor"}))
    run = simulate(JointPlant.from_device(device), commands, 3.0, 1000.0).measured
    assert np.abs(run["q"] - found.q).max() < 0.03 * np.ptp(found.q)
    assert np.abs(run["theta"] - found.theta).max() < 0.03 * np.ptp(found.theta)


def test_a_motion_begins_and_ends_at_rest():
    angles = series().angles(np.arange(1001) / RATE, 2)
    assert angles[0] == pytest.approx([0.0, 0.0]) and angles[-1] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.abs(np.diff(angles, axis=0)[[0, -1]]).max() < 1e-5


def test_the_search_keeps_the_limits_and_improves_on_its_start():
    given = problem("qbmove_a")
    start = given.candidate(series(), 3.0)
    found = search(given, 3.0, Effort(4, 12, seed=2), series())
    assert start is not None and found.score < start.score
    used = given.limits.exceeded(given.motion(found.series, 3.0, RATE))
    assert max(used.values()) <= 1.0
    again = search(given, 3.0, Effort(4, 12, seed=2), series())
    assert again.score == found.score and again.series.mean == found.series.mean


def test_too_large_a_motion_is_made_smaller():
    given = problem("qbmove_a")
    large = series().scaled(6.0)
    assert max(given.limits.exceeded(given.motion(large, 3.0, RATE)).values()) > 1.0
    fitted = given.fitted(large, 3.0)
    assert fitted is not None
    assert max(given.limits.exceeded(given.motion(fitted, 3.0, RATE)).values()) <= 1.0


def test_information_grows_with_the_duration_and_with_less_noise():
    given, loud = problem(), Problem.of(load_device("cubic_demo"), Goal(), 0.9, 30.0 * NOISE)
    short, long = given.candidate(series(), 3.0), given.candidate(series(), 12.0)
    assert short is not None and long is not None
    assert long.stiffness_sd < 0.8 * short.stiffness_sd
    assert loud.candidate(series(), 3.0).stiffness_sd > 5.0 * short.stiffness_sd


def test_a_design_reaches_what_it_claims_and_its_file_runs_on_the_node(tmp_path):
    device, lines = load_device("cubic_demo"), []
    found = design(
        device, Goal(0.02), Settings(torque_noise=NOISE, seeds=4, max_duration=4.0, effort=Effort(6, 10)), lines.append
    )
    checked = found.verification
    assert found.reached and checked.stiffness_sd <= 0.02
    assert checked.stiffness_scatter <= 1.25 * checked.stiffness_sd and checked.coverage >= 0.85
    assert max(checked.used.values()) <= 1.02  # the loop that makes the file adds to the torques of the model
    assert found.commanded.limited == 0
    assert any("search" in line for line in lines)
    path, commands = tmp_path / "motion.csv", found.commanded.commands
    angles = {f"reference_{i + 1}": column for i, column in enumerate(found.commanded.reference.T)}
    write_table(path, commands.time, columns_of(commands) | angles)
    assert read_motion(path, device)["motor"] == pytest.approx(commands["motor"], rel=1e-8)
    joint = ExcitationParameters(device="cubic_demo", commands=str(path)).build()
    simulator, memory = Simulator(JointPlant.from_device(device), 1000.0), joint.supervisor.init()
    state = simulator.init()
    measured, _ = simulator.sample(state)
    for k, angle in enumerate(found.commanded.reference):
        assert np.abs(measured[1:3] - angle).max() < 1e-6
        sample = JointSample(1e-3 * k, float(measured[0]), measured[1:3].copy())
        memory, answer = joint.supervisor.step(memory, sample, True)
        state, measured, _ = simulator.step(state, [*answer.torque, 0.0, 0.0])


def test_an_unreachable_goal_is_reported_with_the_best():
    found = design(
        load_device("cubic_demo"),
        Goal(1e-5),
        Settings(torque_noise=0.5, seeds=2, max_duration=2.0, effort=Effort(4, 4)),
        id,
    )
    assert not found.reached and found.duration == pytest.approx(2.0)
    assert found.verification.stiffness_sd > 1e-5


def test_presets_that_no_sample_visits_are_not_reached():
    given = problem()
    made = commanded(given.device, given.motion(series().scaled(0.1), 3.0, 1000.0))
    check = Check(given.device, np.array([1.2, 1.3]))
    assert check.reached(*check.run(made.commands, 1)).stiffness_sd == np.inf


def test_goals_and_devices_that_do_not_fit_are_refused():
    with pytest.raises(ParameterError, match="no torque motors on springs"):
        problem("xl330")
    with pytest.raises(ParameterError, match="preset must lie"):
        _ = problem(goal=Goal(preset=5.0)).presets
