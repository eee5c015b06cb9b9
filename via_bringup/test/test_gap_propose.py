"""`via gap propose` and `via sim --commands`: from a report to a command file to a log for diagnosis."""

import numpy as np
import pytest
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.command_files import read_motion
from via_core.devices import load_device
from via_gap.logs.log import read_log
from via_gap.report.report import Cause, EffectLocation, GapReport, NuisanceValue, Value, read_report
from via_gap.residual.nuisance import nuisances
from via_sim.plants import JointPlant

DEVICE = "maccepavd"


def report_of(*named: tuple[str, str, str, float, str]) -> GapReport:
    device = load_device(DEVICE)
    places = tuple(EffectLocation(effect=name, site=site, joint=DEVICE) for name, site, _, _, _ in named)
    causes = tuple(
        Cause(
            effect=name, site=site, joint=DEVICE, probability=0.5, share=0.5, left=0.1, score=0.7,
            parameters={parameter: Value(value=value, sd=0.0, unit=unit)},
        )
        for name, site, parameter, value, unit in named
    )  # fmt: skip
    numbers = tuple(
        NuisanceValue(name=n.name, unit=n.unit, filed=n.value, fitted=n.value, offset=0.0, at_bound=False)
        for n in nuisances(JointPlant.from_device(device))
    )
    return GapReport(
        joint=DEVICE, level="full", logs=("a",), holdout=("b",), verdict="effect", where=(), causes=causes,
        equivalence_set=places, effects=places[:1], gap=None, nuisance=numbers, data_check=(), not_evaluated=(),
    )  # fmt: skip


COULOMB = ("coulomb_friction", "link", "torque", 0.05, "N m")
VISCOUS = ("viscous_friction", "link", "coefficient", 0.05, "N m s/rad")


def test_a_proposal_is_written_and_runs_on_the_simulator(tmp_path):
    report, motion, log = tmp_path / "report.json", tmp_path / "motion.csv", tmp_path / "log.csv"
    report.write_text(report_of(COULOMB, VISCOUS).to_json(), encoding="utf-8")
    ran = CliRunner().invoke(app, ["gap", "propose", str(report), "--out", str(motion)])
    assert ran.exit_code == 0, ran.output
    proposal = read_report(report.read_text(encoding="utf-8"), "report").proposal
    assert proposal.motion in proposal.text
    assert {place.effect for place in proposal.separates} == {"coulomb_friction", "viscous_friction"}
    ran = CliRunner().invoke(app, ["sim", DEVICE, "--commands", str(motion), "--record", str(log)])
    assert ran.exit_code == 0, ran.output
    device = load_device(DEVICE)
    recorded = read_log(log, device)
    assert recorded.drivable
    assert recorded.duration == pytest.approx(proposal.duration, abs=0.05)
    commands = read_motion(motion, device)
    assert np.max(np.abs(commands["equilibrium"])) > 0.05
    assert np.ptp(recorded.measured["q"]) > 0.05


def test_without_tied_causes_the_motion_tests_the_model(tmp_path):
    report, motion, log = tmp_path / "report.json", tmp_path / "motion.csv", tmp_path / "log.csv"
    report.write_text(report_of(COULOMB).to_json(), encoding="utf-8")
    ran = CliRunner().invoke(app, ["gap", "propose", str(report), "--out", str(motion)])
    assert ran.exit_code == 0, ran.output
    assert "nothing to decide" in ran.output
    assert "tests the model" in " ".join(ran.output.split())
    ran = CliRunner().invoke(app, ["sim", DEVICE, "--commands", str(motion), "--record", str(log)])
    assert ran.exit_code == 0, ran.output
    assert np.ptp(read_log(log, load_device(DEVICE)).measured["q"]) > 0.05
