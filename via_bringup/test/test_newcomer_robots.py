"""Trials of a newcomer: a robot's model and a log of another simulator, `via device new`, and one command."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import pytest
from newcomer_robots import BENCH_FRICTION, FRICTION, LOAD, REACH, STIFFNESS, WALL, write_bench_arm, write_vendor_arm
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.devices import load_device
from via_gap.report.report import GapReport, read_report

pytestmark = pytest.mark.slow
RUNNER = CliRunner()


def via(*words: object) -> str:
    done = RUNNER.invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.output


def reported(folder: Path, model: str, joint: str, log: str) -> GapReport:
    """The report of a log after the two commands; the files are in `folder`."""
    made, out = folder / "device.yaml", folder / "report.json"
    via("device", "new", folder / model, "--joint", joint, "--log", folder / log, "--out", made)
    via("gap", "diagnose", folder / log, "--device", made, "--json", out)
    return read_report(out.read_text(), str(out))


def gaps_after(output: str) -> dict[str, float]:
    """Gap after the repair [%] by simulator, as `via export --check` prints it."""
    return {name: float(after) for name, after in re.findall(r"(MuJoCo|via_sim) +\S+ % +(\S+) %", output)}


def test_a_vendors_urdf_without_meshes_and_a_matlab_log(tmp_path: Path) -> None:
    write_vendor_arm(tmp_path)
    report = reported(tmp_path, "arm.urdf", "elbow_joint", "elbow_run3.mat")
    columns = load_device(tmp_path / "device.yaml").wire.columns
    assert (columns["time"].unit, columns["q"].unit, columns["q_velocity"].unit) == ("ms", "deg", "deg/s")
    causes = {each.name: each.parameters for each in report.repair()}
    assert set(causes) == {"payload", "coulomb_friction"}
    assert causes["coulomb_friction"]["torque"] == pytest.approx(FRICTION, rel=0.03)
    # The weight of the link is known to 5 %, which is 9 % of the moment of the load.
    assert causes["payload"]["mass"] * causes["payload"]["distance"] == pytest.approx(LOAD * REACH, rel=0.1)


def test_a_labs_mjcf_and_a_bag_in_sqlite3(tmp_path: Path) -> None:
    write_bench_arm(tmp_path)
    report = reported(tmp_path, "bench_arm.xml", "elbow", "run_07")
    causes = {each.name: each.parameters for each in report.repair()}
    assert set(causes) == {"contact", "coulomb_friction"}
    assert causes["coulomb_friction"]["torque"] == pytest.approx(BENCH_FRICTION, rel=0.02)
    assert causes["contact"]["angle"] == pytest.approx(WALL, abs=1e-3)
    assert causes["contact"]["stiffness"] == pytest.approx(STIFFNESS, rel=0.02)
    made = tmp_path / "repaired.xml"
    words = ["--device", tmp_path / "device.yaml", "--into", tmp_path / "bench_arm.xml", "--joint", "elbow"]
    printed = via("export", tmp_path / "report.json", *words, "--out", made, "--check", tmp_path / "run_07")
    after = gaps_after(printed)
    assert abs(after["MuJoCo"] - after["via_sim"]) < 2.0
    model = mujoco.MjModel.from_xml_path(str(made))
    assert model.joint("elbow").range == pytest.approx([-2.2, WALL], abs=1e-3)
    assert model.actuator("elbow_motor").ctrlrange == pytest.approx([-15.0, 15.0])
