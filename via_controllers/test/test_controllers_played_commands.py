"""Playing a table of torques: rows hold, references correct them, and the joint ends held or passive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.contract import JointSample
from via_controllers.joint_methods import ExcitationParameters
from via_controllers.joints.played_commands import PlayedCommands
from via_core.command_files import read_references, write_table
from via_core.devices import load_device
from via_core.errors import ParameterError, SignalError

TIME = np.array([5.0, 5.1, 5.2, 5.3])
TORQUE = np.array([[1.0, -1.0], [2.0, -2.0], [3.0, -3.0], [0.5, -0.5]])
ANGLES = np.array([[0.0, 0.0], [0.1, -0.1], [0.2, -0.2], [0.2, -0.2]])


def player(reference: np.ndarray | None = ANGLES, derivative: float = 0.0) -> PlayedCommands:
    return PlayedCommands(TIME, TORQUE, reference, 20.0, derivative, 300.0, (2.5, 2.5), 0.1)


def played(controller: PlayedCommands, angles: dict[float, list[float]]) -> list[np.ndarray]:
    state, torques = controller.init(), []
    for time, theta in angles.items():
        state, answer = controller.step(state, JointSample(100.0 + time, 0.0, np.array(theta)))
        torques.append(answer.torque)
    return torques


def test_torques_without_references_hold_within_the_limit_and_end_passive():
    still = {time: [0.0, 0.0] for time in (0.0, 0.05, 0.1, 0.25, 0.3, 1.0)}
    expected = [[1.0, -1.0], [1.0, -1.0], [2.0, -2.0], [2.5, -2.5], [0.0, 0.0], [0.0, 0.0]]
    assert np.array(played(player(None), still)) == pytest.approx(np.array(expected))


def test_on_its_reference_the_joint_gets_the_torques_of_the_table_and_is_held_at_the_end():
    on = {0.0: [0.0, 0.0], 0.05: [0.05, -0.05], 0.15: [0.15, -0.15], 0.3: [0.2, -0.2], 2.0: [0.2, -0.2]}
    expected = [[1.0, -1.0], [1.0, -1.0], [2.0, -2.0], [0.5, -0.5], [0.5, -0.5]]
    assert np.array(played(player(), on)) == pytest.approx(np.array(expected))
    (torque,) = played(player(), {0.0: [0.0, 0.0], 2.0: [0.1, -0.1]})[1:]
    assert torque == pytest.approx([0.5 + 20.0 * 0.1, -0.5 - 20.0 * 0.1])


def test_other_angles_at_the_start_fade_into_the_reference_without_a_jump():
    first, middle, later = played(player(), {0.0: [0.04, 0.04], 0.05: [0.05, -0.05], 0.1: [0.1, -0.1]})
    assert first == pytest.approx([1.0, -1.0])
    assert middle == pytest.approx([1.0 + 20.0 * 0.02, -1.0 + 20.0 * 0.02])  # half of the difference is left
    assert later == pytest.approx([2.0, -2.0])


def test_the_derivative_acts_on_the_low_passed_error_of_velocity():
    slow = {k * 0.001: [k * 0.0005, -k * 0.001] for k in range(100)}  # the first motor at half the reference's speed
    torque = np.array(played(replace(player(derivative=0.5), fade_in=1e-3), slow))
    t = 0.001 * np.arange(100)
    expected = 1.0 + 20.0 * 0.5 * t + 0.5 * 0.5 * (1.0 - np.exp(-300.0 * t))
    assert torque[:, 0] == pytest.approx(expected) and torque[:, 1] == pytest.approx(-1.0)


def test_an_accelerated_joint_on_its_reference_gets_the_torques_of_the_table():
    t = 0.001 * np.arange(300)
    angles = np.column_stack([np.sin(30.0 * t) ** 2, -(np.sin(40.0 * t) ** 2)])
    table = 0.1 * np.cos(np.column_stack([20.0 * t, 30.0 * t]))
    controller = PlayedCommands(t, table, angles, 20.0, 0.6, 300.0, (2.5, 2.5), 0.1)
    torque = played(controller, {time: row.tolist() for time, row in zip(t.tolist(), angles, strict=True)})
    assert np.array(torque) == pytest.approx(table, abs=1e-9)


def test_tables_that_do_not_fit_are_refused():
    with pytest.raises(ParameterError, match="must increase"):
        replace(player(), time=TIME[::-1])
    with pytest.raises(ParameterError, match="finite"):
        replace(player(), torque=TORQUE * np.nan)
    with pytest.raises(ParameterError, match="shape"):
        replace(player(), reference=ANGLES[:, :1])
    with pytest.raises(ParameterError, match="1 motors"):
        PlayedCommands(TIME, TORQUE[:, :1], None, 20.0, 0.0, 300.0, (2.5, 2.5), 0.1)


def test_the_excitation_node_plays_a_file_under_its_supervisor(tmp_path):
    path = tmp_path / "motion.csv"
    columns = {"motor_1": 9.0 * TORQUE[:, 0], "motor_2": TORQUE[:, 1]}
    write_table(path, TIME, columns | {"reference_1": ANGLES[:, 0], "reference_2": ANGLES[:, 1]})
    robot = ExcitationParameters(device="qbmove_a", commands=str(path)).build()
    state, limits = robot.supervisor.init(), robot.supervisor.limits.arm.torque_limit
    for k in range(300):
        state, answer = robot.supervisor.step(state, JointSample(1e-3 * k, 0.0, np.zeros(2)), True)
        assert np.all(np.abs(answer.torque) <= limits)
    with pytest.raises(ParameterError, match="antagonistic"):
        ExcitationParameters(device="visco_elastic_demo").build()
    with pytest.raises(SignalError, match="cannot be read"):
        ExcitationParameters(device="qbmove_a", commands=str(tmp_path / "none.csv")).build()
    write_table(path, TIME, columns | {"reference_1": ANGLES[:, 0]})
    with pytest.raises(SignalError, match="reference_2"):
        read_references(path, load_device("qbmove_a"))
