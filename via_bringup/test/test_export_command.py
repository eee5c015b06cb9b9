"""`via export` on an effects file and on a report: the file, what is lost, and the check in MuJoCo."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.command_files import write_table
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.signals import Signals
from via_gap.run.arm_payload import Payload
from via_sim.effects import Effect
from via_sim.effects.files import save_effects
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import simulate


@pytest.fixture
def repair(tmp_path: Path) -> Path:
    path = tmp_path / "repair.yaml"
    effects = [
        Effect("coulomb_friction", "link", {"torque": 0.1}),
        Effect("quadratic_drag", "link", {"coefficient": 0.02}),
    ]
    save_effects(path, effects)
    return path


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(each) for each in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_a_file_and_its_losses(repair: Path, tmp_path: Path) -> None:
    out = tmp_path / "joint.urdf"
    text = run("export", repair, "--device", "dfki_simple_pendulum", "--to", "urdf", "--out", out)
    assert f"wrote {out}" in text
    assert "lost: quadratic_drag at link: no slot; coefficient v^2 is missing" in text
    assert "coulomb_friction" not in text
    assert 'friction="0.28"' in out.read_text()


def test_notes_state_what_is_replaced_and_whether_the_file_loads_where_it_is(repair: Path, tmp_path: Path) -> None:
    (tmp_path / "unit.xml").write_text('<mujocoinclude><compiler angle="radian"/></mujocoinclude>')
    (robot := tmp_path / "robot.xml").write_text(
        '<mujoco><include file="unit.xml"/><worldbody><body><joint name="hip" damping="0.5"/><geom size=".1"/></body>'
        '</worldbody><actuator><motor name="m" joint="hip" gear="50"/></actuator></mujoco>'
    )
    options = ("export", repair, "--device", "dfki_simple_pendulum", "--into", robot, "--joint", "hip", "--out")
    (tmp_path / "elsewhere").mkdir()
    beside, elsewhere = run(*options, tmp_path / "out.xml"), run(*options, tmp_path / "elsewhere" / "out.xml")
    assert "note: the device replaces damping 0.5 by 0.047" in beside and "a control of 1 was 50 N m" in beside
    assert "not where it is" not in beside and "out.xml loads beside the given file, but not where it is" in elsewhere
    mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))


def test_ros2_control_writes_two_files(repair: Path, tmp_path: Path) -> None:
    out = tmp_path / "joint.xacro"
    run("export", repair, "--device", "dfki_simple_pendulum", "--to", "ros2_control", "--out", out)
    assert out.exists() and (tmp_path / "joint.yaml").exists()


def test_the_check_prints_both_simulators(repair: Path, tmp_path: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    time = np.arange(3000) / 1000.0
    torque = 2.0 * np.sin(5.0 * time) + np.sin(13.0 * time)
    commands = Signals(time, {"external_torque": torque}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    plant = JointPlant.from_device(device).with_effects(
        [Effect("coulomb_friction", "link", {"torque": 0.1}), Effect("quadratic_drag", "link", {"coefficient": 0.02})]
    )
    sensors = Sensors(rate=1000.0)
    measured = simulate(plant, commands, 2.999, 1000.0, sensors).measured
    log, out = tmp_path / "log.csv", tmp_path / "joint.xml"
    write_table(log, time, {"position": measured["q"], "torque": torque})
    text = run("export", repair, "--device", "dfki_simple_pendulum", "--out", out, "--check", log)
    mujoco.MjModel.from_xml_path(str(out))
    rows = {
        line.split()[0]: line.split() for line in text.splitlines() if line.strip().startswith(("MuJoCo", "via_sim"))
    }
    before, after = float(rows["MuJoCo"][1]), float(rows["MuJoCo"][3])
    assert before > 10.0 * after
    assert before == pytest.approx(float(rows["via_sim"][1]), rel=0.01)


def test_the_payload_of_an_arm_is_written_into_its_robot(tmp_path: Path) -> None:
    robot, payload, out = tmp_path / "robot.xml", tmp_path / "report_payload.json", tmp_path / "loaded.xml"
    robot.write_text(
        '<mujoco><worldbody><body name="b"><joint name="elbow"/><geom size=".1" mass="1"/></body></worldbody></mujoco>'
    )
    found = Payload("elbow", (), 0.8, 0.01, (0.1, 0.0, -0.3), (0.01, 0.01, 0.01), 0.9)
    payload.write_text(json.dumps(asdict(found)))
    text = run("export", payload, "--to", "mjcf", "--into", robot, "--out", out)
    assert f"wrote {out}" in text
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.body("elbow_payload").mass == pytest.approx(0.8)
    for words, complaint in (((), "add --into ROBOT"), (("--into", robot, "--check", robot), "a report of a joint")):
        with pytest.raises(ViaError, match=complaint):
            run("export", payload, *words)
    with pytest.raises(ViaError, match="--device is missing"):
        run("export", tmp_path / "effects.yaml")
