"""`via gap exports`: what counts as kept, what readers complain about, resuming, and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.devices import load_device
from via_core.errors import SignalError, ViaError
from via_core.signals import Signals
from via_export import export
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate
from via_validation.exports.exported import Exported, Lost, Sides, exported, keep, kept
from via_validation.exports.page import page, summaries
from via_validation.exports.reading import read_all
from via_validation.exports.sources import Source

LOST = Lost(
    item="joint_coupling", place="link", kind="none", text="joint_coupling at link: no slot; needs the neighbour"
)


def made(name: str = "case_000", **values: object) -> Exported:
    """A repair that MuJoCo reproduces."""
    plain = {
        "group": "sealed", "key": "", "seconds": 1.0, "effects": ("payload (link)",), "report": 0.02, "by": "segments",
        "via_sim": Sides(before=0.2, after=0.02), "mujoco": Sides(before=0.2, after=0.021),
    }  # fmt: skip
    return Exported.model_validate({"name": name, **plain, **values})


def test_a_difference_of_two_points_is_a_miss_unless_the_list_of_losses_explains_it() -> None:
    far = Sides(before=0.2, after=0.18)
    assert made().kept and made().difference == pytest.approx(0.001)
    assert not made(mujoco=far).kept
    assert made(mujoco=far, lost=(LOST,), remaining=(0.17, 0.175)).kept
    assert not made(mujoco=far, lost=(LOST,), remaining=(0.17, 0.2)).kept
    assert not made(failure="no samples").kept


def test_reports_by_equations_are_compared_with_the_simulator() -> None:
    equations = made(report=0.4, by="inverse dynamics")
    assert equations.difference == pytest.approx(0.001) and equations.kept


def test_the_share_of_the_repair_is_that_of_its_decrease() -> None:
    assert made(mujoco=Sides(before=0.2, after=0.11)).reproduced == pytest.approx(0.5)
    assert made(via_sim=Sides(before=0.02, after=0.0199)).reproduced is None


def test_readers_complain_about_what_they_cannot_read_and_about_nothing_else(tmp_path: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    for to, suffix in (("mjcf", ".xml"), ("urdf", ".urdf"), ("sdf", ".sdf")):
        text = export(device, (), to).text
        (tmp_path / f"sound{suffix}").write_text(text)
        (tmp_path / f"broken{suffix}").write_text(text.replace("revolute", "hinged").replace('hinge"', 'wheel"'))
    found = read_all(tmp_path)
    assert {"MuJoCo (MJCF)", "MuJoCo (URDF)", "pinocchio (URDF)"} <= found.keys()
    for reader, files in found.items():
        (sound,) = [lines for name, lines in files.items() if name.startswith("sound")]
        (broken,) = [lines for name, lines in files.items() if name.startswith("broken")]
        assert not sound and broken, reader


@pytest.fixture(scope="module")
def source() -> Source:
    """A pendulum with viscous friction, moved by waves, and its report."""
    effect = Effect("viscous_friction", "link", {"coefficient": 0.2})
    device, time = load_device("dfki_simple_pendulum"), np.arange(0.0, 16.0, 2e-3)
    torque = 2.0 * np.sin(4.1 * time) + 1.3 * np.sin(9.7 * time) + 0.8 * np.sin(1.9 * time)
    commands = Signals(time, {"external_torque": torque}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    plant = JointPlant.from_device(device).with_effects([effect])
    run = simulate(plant, commands, 16.0, 500.0, Sensors.of_device(device), InitialConditions(np.zeros(6), seed=1))
    log = JointLog("log", device, run.measured.select(["q"]), commands)
    return Source("pendulum", "sealed", diagnose([log], device), lambda: (device, [log]))


def test_a_repair_is_exported_stored_and_used_again(source: Source, tmp_path: Path) -> None:
    found = exported(source, tmp_path / "files")
    assert found.kept and not found.lost_effects and found.remaining is None
    assert found.effects == ("viscous_friction (link)",) and found.reproduced == pytest.approx(1.0, abs=0.01)
    assert sorted(each.name for each in (tmp_path / "files").iterdir()) == [
        "pendulum.sdf", "pendulum.urdf", "pendulum.xml",
    ]  # fmt: skip
    keep(found, tmp_path)
    assert kept(source, tmp_path) == found
    changed = Source("pendulum", "sealed", source.report.model_copy(update={"lined": 0.001}), source.read)
    assert kept(changed, tmp_path) is None


def test_a_recording_that_cannot_be_simulated_is_a_failure_of_its_case(source: Source, tmp_path: Path) -> None:
    def read() -> tuple:
        raise SignalError("no samples")

    assert exported(Source("pendulum", "sealed", source.report, read), tmp_path).failure == "no samples"


def test_the_page_shows_every_case_and_every_loss() -> None:
    cases = [
        made(), made("case_001", mujoco=Sides(before=0.2, after=0.1)),
        made("case_002", lost=(LOST,), remaining=(0.17, 0.175)), made("arm", group="real", failure="no samples"),
    ]  # fmt: skip
    sealed, real = summaries(cases)
    assert (sealed.slotted, sealed.within, sealed.lossy, sealed.explained) == (2, 1, 1, 1)
    assert sealed.difference == pytest.approx(0.08) and (real.all, real.failed) == (1, 1)
    text = page(cases, {"MuJoCo (MJCF)": {"a.xml": [], "b.xml": ["unknown element"]}}, (1, 9), "commit abc")
    assert text.count("**MISSED**") == 1 and "| case_002 |" in text and "seeds 1 to 9" in text
    assert "| MuJoCo (MJCF) | 2 | 1 | 1 |" in text and "`b.xml`: unknown element" in text
    assert "| joint_coupling at link: no slot; needs the neighbour | 1: case_002 |" in text
    assert "| no samples | | | | | | **failed** |" in text


def test_nothing_to_export_is_said(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["gap", "exports", "--real", str(tmp_path), "--data", str(tmp_path)])
    assert isinstance(done.exception, ViaError) and "nothing to export" in str(done.exception), done.output
