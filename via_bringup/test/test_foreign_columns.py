"""CSV files from other software: column names, units and enable column from the device file."""

from importlib import resources
from pathlib import Path

import numpy as np
import pandas
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


@pytest.fixture(scope="module")
def excited(tmp_path_factory) -> pandas.DataFrame:
    """A log of a simulated joint of variable stiffness."""
    folder = tmp_path_factory.mktemp("excited")
    motion, record = folder / "motion.csv", folder / "log.csv"
    t = np.arange(6000) / 1000.0
    torque = np.stack([0.8 + 0.5 * np.sin(9.0 * t), -0.8 + 0.5 * np.sin(13.0 * t)], axis=1)
    pandas.DataFrame({"time": t, "motor_1": torque[:, 0], "motor_2": torque[:, 1]}).to_csv(motion, index=False)
    ran = CliRunner().invoke(app, ["sim", "cubic_demo", "--commands", str(motion), "--record", str(record)])
    assert ran.exit_code == 0, ran.output
    return pandas.read_csv(record)


def estimated(folder: Path, log: Path, device: str | Path) -> pandas.DataFrame:
    words = ["estimate", str(log), "--device", str(device), "--csv", str(folder / "estimates.csv")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    return pandas.read_csv(folder / "estimates.csv")


def test_estimates_come_from_tables_of_other_columns_and_units(excited: pandas.DataFrame, tmp_path: Path) -> None:
    excited.to_csv(tmp_path / "own.csv", index=False)
    own = estimated(tmp_path, tmp_path / "own.csv", "cubic_demo")
    foreign = {
        "ms": 1e3 * excited["time"],
        "arm_deg": np.degrees(excited["q"]),
        **{f"drive{k}_deg": np.degrees(excited[f"theta_{k}"]) for k in (1, 2)},
        **{f"drive{k}_mNm": 1e3 * excited[f"tau_{k}"] for k in (1, 2)},
    }
    pandas.DataFrame(foreign).to_parquet(tmp_path / "foreign.parquet")
    entries = ["time: {column: ms, unit: ms}", "q: {column: arm_deg, unit: deg}"]
    entries += [f"theta_{k}: {{column: drive{k}_deg, unit: deg}}" for k in (1, 2)]
    entries += [f"tau_{k}: {{column: drive{k}_mNm, unit: mN m}}" for k in (1, 2)]
    text = Path(str(resources.files("via_core") / "devices" / "cubic_demo.yaml")).read_text(encoding="utf-8")
    (tmp_path / "lab.yaml").write_text(f"{text}\nwire:\n  columns: {{{', '.join(entries)}}}\n", encoding="utf-8")
    lab = estimated(tmp_path, tmp_path / "foreign.parquet", tmp_path / "lab.yaml")
    assert (own["status"] == "OK").mean() > 0.5
    for name in ("stiffness_1", "stiffness_2", "motor_inertia_1"):
        np.testing.assert_allclose(lab[name].iloc[-500:], own[name].iloc[-500:], rtol=1e-6)
    device = load_device("cubic_demo")
    angles = excited[["q", "theta_1", "theta_2"]].to_numpy()[-1]
    for k in (1, 2):
        truth = float(device.springs[k - 1].stiffness(angles[0] - angles[k]))
        value, sd = own[f"stiffness_{k}"].iloc[-1], own[f"stiffness_{k}_standard_deviation"].iloc[-1]
        assert abs(value - truth) < 4.0 * sd + 0.05 * truth


def test_an_estimate_of_a_table_without_a_signal_says_so(excited: pandas.DataFrame, tmp_path: Path) -> None:
    excited.drop(columns=["tau_2"]).to_csv(tmp_path / "log.csv", index=False)
    done = CliRunner().invoke(app, ["estimate", str(tmp_path / "log.csv"), "--device", "cubic_demo"])
    assert done.exit_code == 0 and "tau_2 was not recorded" in done.output
