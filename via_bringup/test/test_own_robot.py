"""A lab's robot: from URDF or MJCF and a recording to a report, one command after `via device new`."""

from pathlib import Path

import mujoco
import numpy as np
import pandas
import pytest
from own_robot import FRICTION, moved, write_arm, write_robot, write_run
from typer.testing import CliRunner, Result
from via_bringup.cli import app
from via_bringup.cli.gap_arm import diagnosed_arm
from via_core.devices import load_device
from via_core.recordings.entries import Constants
from via_gap import diagnose, frames
from via_gap.logs.log import read_log
from via_gap.report.report import read_report
from via_gap.run.arm_model import arm_of_model, under
from via_gap.run.arms import ArmDiagnosis, read_arm_log

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    write_robot(folder)
    write_run(folder / "run.csv")
    return folder


def via(*words: object, **more: object) -> Result:
    return RUNNER.invoke(app, [str(word) for word in words], **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def elbow(folder: Path) -> Path:
    done = via(
        "device",
        "new",
        folder / "robot.urdf",
        "--joint",
        "elbow",
        "--log",
        folder / "run.csv",
        "--out",
        folder / "elbow.yaml",
    )
    assert done.exit_code == 0, done.output
    return folder / "elbow.yaml"


def test_a_device_file_comes_from_model_and_recording(folder: Path, elbow: Path) -> None:
    device, text = load_device(elbow), elbow.read_text()
    assert device.sensors.rate == pytest.approx(500.0, rel=1e-6)
    assert device.sensors.link_quantum == pytest.approx(2.0 * np.pi / 16384, rel=1e-4)
    assert "[Hz] measured:" in text and "[kg m^2] read:" in text and "guessed: the model states no friction" in text
    log = read_log(folder / "run.csv", device)
    run = moved(20.0, locked=True)
    np.testing.assert_allclose(log.measured["q"], run["q"][:, 0], atol=1e-8)
    assert log.commands is not None
    np.testing.assert_allclose(log.commands["external_torque"], run["tau"][:, 0], atol=1e-6)


def test_from_file_to_report_with_one_command(folder: Path, elbow: Path) -> None:
    done = via("gap", "diagnose", folder / "run.csv", "--device", elbow, "--json", folder / "report.json")
    assert done.exit_code == 0, done.output
    report = read_report((folder / "report.json").read_text(), "report")
    (cause,) = report.repair()
    assert cause.name == "coulomb_friction"
    assert cause.parameters["torque"] == pytest.approx(FRICTION["elbow"], rel=0.05)


def test_arrays_give_the_report_of_the_file_and_its_numbers_as_frames(folder: Path, elbow: Path) -> None:
    run = moved(20.0, locked=True)
    arrays = {"time": run["time"], "position": run["q"][:, 0], "torque": run["tau"][:, 0]}
    report = diagnose(arrays, elbow)
    tables = frames(report)
    causes = tables["causes"]
    named = causes[causes["named"]].iloc[0]
    assert named["effect"] == "coulomb_friction" and named["value"] == pytest.approx(FRICTION["elbow"], rel=0.05)
    gap = tables["gap"].set_index("signal")
    assert gap.loc["all", "after"] < 0.2 * gap.loc["all", "before"]
    assert set(tables) == {"causes", "where", "gap", "device", "findings"}
    with pytest.raises(Exception, match="no column looks like a position"):
        diagnose({"time": run["time"], "banana": run["q"][:, 0]}, elbow)


def test_all_joints_of_a_model_come_from_one_recording(folder: Path) -> None:
    run = moved(12.0, 250.0)
    write_arm(folder / "arm.parquet")
    for model in ("robot.urdf", "robot.xml"):
        arm = arm_of_model(folder / model, folder / "arm.parquet")
        assert {each.tolerances.torque_scale for each in arm.devices} == {0.05}
        assert [device.name for device in arm.devices] == ["shoulder", "elbow"]
        follows = "elbow: an arm includes inertia and friction of finger_joint, but not its gravity"
        assert (follows in arm.remarks) == (model == "robot.urdf")
        q, v, a = np.random.default_rng(1).normal(size=(3, 20, 2))
        np.testing.assert_allclose(arm.torques(q, v, a), reference(q, v, a), rtol=1e-5, atol=1e-5)
        logs = read_arm_log(folder / "arm.parquet", arm)
        np.testing.assert_allclose(logs[1].measured["q"], run["q"][:, 1], atol=1e-12)
        assert all(log.commands is not None and "arm_torque" in log.commands for log in logs)


def test_a_recording_of_several_joints_is_diagnosed_with_all_of_them(folder: Path) -> None:
    write_arm(folder / "arm.parquet")
    model, log = folder / "robot.urdf", folder / "arm.parquet"
    done = via("device", "new", model, "--joint", "elbow", "--log", log, "--out", folder / "of_arm.yaml")
    assert done.exit_code == 0, done.output
    assert "the recording also has shoulder" in done.output and f"diagnose {log} --arm {model}" in done.output
    pandas.read_parquet(log).drop(columns="tau_1").to_parquet(folder / "undriven.parquet")
    done = via(
        "device", "new", model, "--joint", "elbow", "--log", folder / "undriven.parquet", "--out", folder / "u.yaml"
    )
    assert "needs torque or current of shoulder" in done.output and "--arm" not in done.output
    pandas.read_parquet(log).rename(columns={"tau_2": "ctrl_2"}).to_parquet(folder / "commands.parquet")
    commands = ("--log", folder / "commands.parquet", "--out", folder / "commands.yaml")
    done = via("device", "new", folder / "robot.xml", "--joint", "shoulder", *commands)
    assert f"--arm {folder / 'robot.xml'}" in done.output  # the elbow's motor makes a torque of its command


def test_the_weight_that_a_robot_compensates_is_no_torque_of_its_drives(folder: Path, tmp_path: Path) -> None:
    """Inverse dynamics of MuJoCo, also under another gravity, and an elbow that keeps its inertia."""
    text = (folder / "robot.xml").read_text().replace('<body name="fore"', '<body name="fore" gravcomp="0.7"')
    (tmp_path / "defaults.xml").write_text((folder / "defaults.xml").read_text())
    (tmp_path / "robot.xml").write_text(text)
    write_arm(tmp_path / "arm.parquet")
    arm = arm_of_model(tmp_path / "robot.xml", tmp_path / "arm.parquet")
    spec = mujoco.MjSpec.from_string(text, {"defaults.xml": (folder / "defaults.xml").read_bytes()})
    spec.delete(spec.mesh("upper"))
    for geom in [each for each in spec.geoms if each.meshname]:
        spec.delete(geom)
    model = spec.compile()
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    rng = np.random.default_rng(2)
    for gravity in ((0.0, 0.0, -9.81), (3.0, 0.0, -2.0)):
        model.opt.gravity[:] = gravity
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.qacc[:] = rng.normal(size=(3, 2))
        q, v, a = (each[None].copy() for each in (data.qpos, data.qvel, data.qacc))
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(under(arm, np.array(gravity)).torques(q, v, a)[0], data.qfrc_inverse, atol=1e-9)


def test_a_diagnosis_of_an_arm_names_what_its_model_states_and_it_does_not_use(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    text = (
        (folder / "robot.xml").read_text().replace('name="elbow" ', 'name="elbow" stiffness="3" springref="28.6479" ')
    )
    (tmp_path / "defaults.xml").write_text((folder / "defaults.xml").read_text())
    (tmp_path / "robot.xml").write_text(text)
    write_arm(tmp_path / "arm.parquet")
    monkeypatch.setattr("via_gap.run.arms.diagnose_arm", lambda *each: ArmDiagnosis((), ()))
    diagnosed_arm(str(tmp_path / "robot.xml"), [tmp_path / "arm.parquet"], [], Constants(), lambda *each: None)
    said = capfd.readouterr().err
    assert "note: elbow: stiffness 3 about 0.5: not used" in said
    assert said.count("assets are left out") == 1 and "taken as rigid" not in said and "--arm" not in said


def test_an_arm_with_goals_and_without_gains_is_refused_with_the_remedy(folder: Path, tmp_path: Path) -> None:
    run, log = moved(12.0, 250.0), tmp_path / "goals.csv"
    counts = np.rint(run["q"] * 4096 / (2.0 * np.pi)) + 2048
    columns = {f"{what}_{k + 1}": counts[:, k] for what in ("position", "goal") for k in (0, 1)}
    pandas.DataFrame({"t": run["time"], **columns}).to_csv(log, index=False)
    done = via("gap", "diagnose", log, "--arm", folder / "robot.urdf")
    assert "add --counts-per-turn" in str(done.exception)
    done = via("gap", "diagnose", log, "--arm", folder / "robot.urdf", "--counts-per-turn", "4096")
    assert "no gains of the position drive of shoulder, elbow: state the gains" in str(done.exception)


def test_the_zero_of_the_recording_is_that_of_the_model_or_the_device_says_so(folder: Path, tmp_path: Path) -> None:
    run = moved(12.0, 250.0)
    counts = np.rint(run["q"] * 4096 / (2.0 * np.pi)) + 2048
    for name, values in (("counts", counts), ("deg", np.degrees(run["q"]) + 170.0)):
        log, out = tmp_path / f"{name}.csv", tmp_path / f"{name}.yaml"
        columns = {"t": run["time"], f"shoulder_pos_{name}": values[:, 0], "shoulder_tau": run["tau"][:, 0]}
        pandas.DataFrame(columns).to_csv(log, index=False)
        words = ["--joint", "shoulder", "--log", log, "--counts-per-turn", "4096", "--out", out]
        done = via("device", "new", folder / "robot.urdf", *words)
        assert done.exit_code == 0, done.output
        read = read_log(log, load_device(out)).measured["q"]
        offset = 0.0 if name == "counts" else np.radians(170.0)
        np.testing.assert_allclose(read, run["q"][:, 0] + offset, atol=1e-3)
        assert ("are beyond the limits of the joint" in done.output) == (name == "deg")


def test_a_check_that_cannot_run_is_refused_before_a_file_is_written(folder: Path, elbow: Path) -> None:
    (folder / "none.yaml").write_text("[]")
    made = folder / "out.urdf"
    done = via("export", folder / "none.yaml", "--device", elbow, "--to", "urdf", "--out", made, "--check", made)
    assert done.exit_code != 0 and not made.exists()


def reference(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques of the arm, written out for two links in a plane; q = 0 hangs down (Spong, planar elbow manipulator)."""
    m2, r2 = 1.5, (1.2 * 0.12 + 0.3 * 0.27) / 1.5
    i2 = 1.2 * 0.12**2 + 0.008 + 0.3 * 0.27**2 + 0.0002
    i1, l1, g, h = 2.0 * 0.15**2 + 0.02, 0.3, 9.81, m2 * 0.3 * r2
    c, s = np.cos(q[:, 1]), np.sin(q[:, 1])
    far = m2 * g * r2 * np.sin(q[:, 0] + q[:, 1])
    first = (i1 + i2 + m2 * l1**2 + 2.0 * h * c) * a[:, 0] + (i2 + h * c) * a[:, 1] - 2.0 * h * s * v[:, 0] * v[:, 1]
    first += -h * s * v[:, 1] ** 2 + (2.0 * 0.15 + m2 * l1) * g * np.sin(q[:, 0]) + far
    return np.stack([first, (i2 + h * c) * a[:, 0] + i2 * a[:, 1] + h * s * v[:, 0] ** 2 + far], axis=1)


def test_a_recording_alone_gives_the_numbers_of_the_joint(folder: Path) -> None:
    done = via("device", "new", "--log", folder / "run.csv", "--out", folder / "alone.yaml", "--joint", "elbow")
    assert done.exit_code == 0, done.output
    link = load_device(folder / "alone.yaml").link
    assert link.inertia == pytest.approx(1.2 * 0.12**2 + 0.008 + 0.3 * 0.27**2 + 0.0002, rel=0.1)
    assert link.gravity_torque == pytest.approx(1.5 * 0.15 * 9.81, rel=0.05)
    assert link.coulomb_friction == pytest.approx(FRICTION["elbow"], rel=0.15)
    assert "measured: least squares on run.csv" in (folder / "alone.yaml").read_text()


def test_bag_map_shows_guesses_and_writes_a_mapping_that_imports(folder: Path, elbow: Path, tmp_path: Path) -> None:
    done = via("bag", "map", folder / "run.csv", "--joint", "elbow", "--out", tmp_path / "map.yaml")
    assert done.exit_code == 0, done.output
    assert "500 Hz" in done.output and "Elbow Position (deg)" in done.output
    done = via("bag", "import", folder, "--mapping", tmp_path / "map.yaml", "--out", tmp_path / "bags")
    assert done.exit_code == 0, done.output
    wire, text = '{"link": "elbow", "motors": ["elbow"]}', elbow.read_text()
    (tmp_path / "named.yaml").write_text(text[: text.index("wire:")] + f"wire: {wire}\n")
    log = read_log(tmp_path / "bags" / "run", load_device(tmp_path / "named.yaml"))
    np.testing.assert_allclose(log.measured["q"], moved(20.0, locked=True)["q"][:, 0], atol=1e-8)


def test_a_joint_may_have_another_name_in_the_recording(folder: Path) -> None:
    run = moved(20.0, locked=True)
    both = {"q": np.stack([run["q"][:, 0], 0.0 * run["time"]], 1), "tau": np.stack([run["tau"][:, 0]] * 2, 1)}
    np.savez(folder / "numbered.npz", time=run["time"], **both)
    body = '<body><joint name="flap" axis="0 1 0"/><geom size=".1" mass="1"/></body>'
    (folder / "one.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    made = ["device", "new", folder / "one.xml", "--log", folder / "numbered.npz"]
    done = via(*made, "--log-joint", "2", "--out", folder / "none.yaml")
    assert "choose with --joint from: 0, 1; beside a model, with --log-joint" in str(done.exception)
    done = via(*made, "--log-joint", "0", "--out", folder / "numbered.yaml")
    assert done.exit_code == 0, done.output
    log = read_log(folder / "numbered.npz", load_device(folder / "numbered.yaml"))
    assert log.device.link_joint == "flap"
    np.testing.assert_allclose(log.measured["q"], run["q"][:, 0])


def test_questions_on_a_terminal_give_a_device_that_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("via_bringup.cli.device_new._on_terminal", lambda: True)
    answers = ["Wrist 2", "300 g", "20 cm", "0", "y", "0", "12 mNm", "n", "1 kHz", "4096"]
    done = via("device", "new", "--out", tmp_path / "w.yaml", input="\n".join(answers) + "\n")
    assert done.exit_code == 0, done.output
    device = load_device(tmp_path / "w.yaml")
    assert device.name == "wrist_2" and device.link.inertia == pytest.approx(0.3 * 0.04)
    assert device.link.coulomb_friction == pytest.approx(0.012) and device.sensors.rate == 1000.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["robot.urdf"], "choose with --joint from: shoulder, elbow, finger_joint"),
        (["robot.urdf", "--joint", "hip"], "no joint 'hip'; there are: shoulder"),
        (["robot.urdf", "--joint", "elbow", "--at", "shoulder"], "write JOINT=ANGLE"),
        (["robot.urdf", "--joint", "elbow", "--log", "nothing.csv"], "cannot be read"),
        (["robot.urdf", "--joint", "elbow", "--log", "counts.csv"], "add --counts-per-turn"),
        ([], "give a URDF or MJCF file, --log FILE, or run it in a terminal"),
    ],
)
def test_errors_say_what_to_write(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(folder)
    (folder / "counts.csv").write_text("t,enc_counts\n" + "".join(f"{k * 0.01},{100 * k}\n" for k in range(50)))
    done = via("device", "new", *words)
    assert message in str(done.exception)
