"""`via observe` and `via excite`: answers, files and errors of the commands."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.command_files import write_table
from via_core.devices import device_names, load_device
from via_gap.design.default_motion import default_motion
from via_gap.design.observed import observe_default, torque_noise_of

BAR = """name: bar
title: Bar with a damper
source: [test]
confidence: assumed
arrangement: rigid
link: {inertia: 0.1, viscous_friction: 0.05}
damper: {site: link, map: linear, minimum: 0.5, maximum: 2.0}
sensors: {rate: 200.0, link_quantum: 1.0e-4, link_torque_noise: 0.05}
"""


def run(*arguments: str) -> str:
    ran = CliRunner().invoke(app, list(arguments))
    assert ran.exit_code == 0, ran.output
    return ran.output


def log_of(path, device: str, columns: tuple[str, ...]):
    """A log of the default motion with encoder steps and torque noise, with these columns."""
    described = load_device(device)
    measured = default_motion(described).simulation.measured
    random, step = np.random.default_rng(4), described.sensors.link_quantum
    found = {"q": np.round(measured["q"] / step) * step}
    for i in range(described.n_motors):
        found[f"theta_{i + 1}"] = np.round(measured["theta"][:, i] / step) * step
        found[f"tau_{i + 1}"] = measured["tau"][:, i] + 0.02 * random.normal(size=len(measured))
    write_table(path, measured.time, {name: values for name, values in found.items() if name in columns})


def test_a_log_without_motor_torques_names_the_scale_and_the_remedy(tmp_path):
    log, out = tmp_path / "log.csv", tmp_path / "out.json"
    log_of(log, "cubic_demo", ("q", "theta_1", "theta_2"))
    text = run("observe", "cubic_demo", str(log), "--json", str(out))
    assert "scale together without a torque measurement" in text and "state the link inertia" in text
    assert "torque of motor 1 and motor 2 not measured" in text
    (found,) = json.loads(out.read_text())["signal_sets"]
    assert found["rank"] < len(found["quantities"]) and found["channels"] == ["q", "theta_1", "theta_2"]
    names = {each["name"] for each in found["quantities"]}
    assert "inertia of the link" in names and "inertia of motor 1" not in names


def test_a_complete_log_agrees_with_the_prediction_for_its_noise(tmp_path):
    log, out = tmp_path / "log.csv", tmp_path / "out.json"
    log_of(log, "cubic_demo", ("q", "theta_1", "theta_2", "tau_1", "tau_2"))
    run("observe", "cubic_demo", str(log), "--json", str(out))
    (found,) = json.loads(out.read_text())["signal_sets"]
    logged = {each["name"]: each["standard_deviation"] for each in found["quantities"]}
    predicted = observe_default(load_device("cubic_demo"), 0.02)[1][0].information
    for name in ("inertia of motor 1", "viscous friction of motor 2"):
        assert logged[name] == pytest.approx(predicted.standard_deviation(name), rel=0.25)


def test_without_a_log_each_signal_set_has_a_column_and_its_gaps(tmp_path):
    file = tmp_path / "bar.yaml"
    file.write_text(BAR)
    text = run("observe", str(file))
    assert "link angle and joint torque" in text and "rank" in text
    assert "scale of the damper" in text and "4 of 4" in text and "2 of 2" in text
    assert "the scale of torque sensors" in text


KINDS = {(each.arrangement, each.drive): each.name for each in map(load_device, reversed(device_names()))}
MAIN = (
    "stiffness",
    "gain of spring",
    "position gain",
    "scale of the damper",
)  # what each kind of joint is identified for


@pytest.mark.parametrize("device", [*KINDS.values(), "xl330_kp800"])
def test_all_signals_of_a_shipped_device_determine_what_it_is_identified_for(device):
    described = load_device(device)
    _, sets = observe_default(described)
    for each in sets:
        assert each.information.rank == len(each.information.unknowns) > 0 or each.remedies
    last = sets[-1].information
    main = [each for each in last.unknowns if each.name.startswith(MAIN)]
    assert main and all(last.standard_deviation(each.name) <= 0.05 * each.value for each in main)
    assert torque_noise_of(described) > 1e-5 or described.drive == "torque"  # a commanded torque is exact


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("excite", "qbmove_a", "--stiffness-sd", "two"), "--stiffness-sd must be a share"),
        (("excite", "qbmove_a", "--stiffness-sd", "any"), "must state a wanted standard deviation"),
        (("excite", "qbmove_a", "--within", "walls"), "--within must be"),
        (("excite", "xl330"), "no torque motors on springs"),
        (("observe", "nothing"), "no device"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    ran = CliRunner().invoke(app, list(arguments))
    assert message in str(ran.exception)


def test_a_design_is_written_as_commands_that_the_simulator_runs(tmp_path):
    motion, log, out = tmp_path / "motion.csv", tmp_path / "log.csv", tmp_path / "out.json"
    text = run(
        "excite", "cubic_demo", "--stiffness-sd", "5%", "--max-duration", "3", "--seeds", "2", "--out", str(motion),
        "--json", str(out),
    )  # fmt: skip
    assert "stiffness" in text and "coverage" in text
    assert motion.read_text().splitlines()[0] == "time,motor_1,motor_2,reference_1,reference_2"
    assert json.loads(out.read_text())["verification"]["seeds"] == 2
    run("sim", "cubic_demo", "--commands", str(motion), "--record", str(log))
    assert log.exists()
