"""CSV files from other software: column names, units and enable column from the device file."""

import numpy as np
import pytest
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.devices import load_device
from via_gap.logs.log import read_log


def test_counts_and_amperes_are_read_in_si_units(tmp_path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("t,pos,cur\n0.0,100,0.5\n0.01,200,-0.5\n0.02,8192,1\n", encoding="utf-8")
    log = read_log(file, load_device("odrive_rotor"))
    assert log.measured["q"] == pytest.approx(np.array([100, 200, 8192]) * 2.0 * np.pi / 8192.0, rel=1e-6)
    assert log.commands is not None
    assert log.commands["external_torque"] == pytest.approx([0.02755, -0.02755, 0.0551])
    assert (log.level, log.drivable) == ("full", True)


def test_a_disabled_position_drive_has_no_goal(tmp_path) -> None:
    file = tmp_path / "log.csv"
    text = "time,position,goal_position,torque_enable\n0.0,0.1,0.2,1\n0.005,0.1,0.3,0\n0.01,0.1,0.4,1\n"
    file.write_text(text, encoding="utf-8")
    log = read_log(file, load_device("xl330"))
    assert log.commands is not None
    np.testing.assert_array_equal(log.commands["equilibrium"], [0.2, np.nan, 0.4])
    assert (log.level, log.drivable) == ("encoder and command", True)
    file.write_text(text.replace("torque_enable", "tau_1"), encoding="utf-8")
    assert read_log(file, load_device("xl330")).level == "full"
    file.write_text("time,position\n0.0,0.1\n0.005,0.1\n", encoding="utf-8")
    assert not read_log(file, load_device("xl330")).drivable


def test_a_log_of_via_sim_with_goals_of_a_table_can_be_read(tmp_path) -> None:
    """The columns of its log have the names of VIA's channels."""
    motion, record = tmp_path / "motion.csv", tmp_path / "log.csv"
    t = np.arange(400) / 200.0
    goals = np.where(t < 1.5, 0.5 * np.sin(3.0 * t), np.nan)
    rows = "\n".join(f"{a:.9g},{b:.9g}" for a, b in zip(t, goals, strict=True))
    motion.write_text(f"time,equilibrium\n{rows}\n", encoding="utf-8")
    command = ["sim", "xl330", "--commands", str(motion), "--record", str(record), "--rate", "200"]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    log = read_log(record, load_device("xl330"))
    assert log.level == "encoder and command"
    assert np.ptp(log.measured["q"]) > 0.3
    assert log.commands is not None and np.isnan(log.commands["equilibrium"][-1])
