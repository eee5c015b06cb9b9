"""From files alone: a log, its diagnosis, and the effects file with which `via sim` has the gap that was claimed."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from via_bringup import cli
from via_core.command_files import write_table
from via_core.devices import load_device
from via_gap.report.report import GapReport, read_report

RATE, SECONDS = 250, 16.0
PLANTED = [
    {"effect": "coulomb_friction", "site": "link", "parameters": {"torque": 0.03}},
    {"effect": "device_numbers", "site": "device", "parameters": {"link inertia": 1.04, "spring 1 torque": 0.97}},
]


def run(*words: str) -> None:
    """`via` with these words in this process; it must not fail."""
    argv, sys.argv = sys.argv, ["via", *words]
    try:
        with pytest.raises(SystemExit) as end:
            cli.main()
    finally:
        sys.argv = argv
    assert end.value.code == 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """device.yaml, motion.csv, planted.yaml; log.csv, report.json and repair.yaml as the commands write them.

    ideal.yaml is the same joint with encoders that show what the simulation computes.
    """
    here = tmp_path_factory.mktemp("repair")
    device = load_device("maccepavd").model_dump(mode="json", exclude_none=True)
    device["sensors"]["rate"] = RATE
    (here / "device.yaml").write_text(yaml.safe_dump(device), encoding="utf-8")
    device["sensors"] = {"rate": RATE, "link_quantum": 1e-7, "motor_quantum": 1e-7}
    (here / "ideal.yaml").write_text(yaml.safe_dump(device), encoding="utf-8")
    (here / "planted.yaml").write_text(yaml.safe_dump(PLANTED), encoding="utf-8")
    time = np.arange(round(100 * SECONDS)) / 100
    wave = 0.5 * np.sin(0.9 * time) + 0.3 * np.sin(2.3 * time + 1.0) + 0.15 * np.sin(5.1 * time)
    angle = np.clip(time, 0.0, 1.0) * wave
    preset, damping = 0.9 + 0.3 * np.sin(0.7 * time), 0.5 + 0.5 * np.sin(1.4 * time)
    write_table(here / "motion.csv", time, {"equilibrium": angle, "preset": preset, "damping": damping})
    simulated(here, "device.yaml", "log.csv", "--effects", str(here / "planted.yaml"))
    asked = ("--json", str(here / "report.json"), "--effects-out", str(here / "repair.yaml"))
    run("gap", "diagnose", str(here / "log.csv"), "--device", str(here / "device.yaml"), *asked)
    return here


def simulated(here: Path, device: str, name: str, *words: str) -> dict[str, np.ndarray]:
    """`via sim` under the commands of motion.csv -> the columns that it recorded."""
    run(
        "sim", str(here / device), "--commands", str(here / "motion.csv"), "--rate", str(RATE),
        "--record", str(here / name), *words,
    )  # fmt: skip
    return columns(here / name)


def columns(path: Path) -> dict[str, np.ndarray]:
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


def report_in(here: Path) -> GapReport:
    return read_report((here / "report.json").read_text(encoding="utf-8"), "report.json")


def nrmse(log: dict[str, np.ndarray], other: dict[str, np.ndarray], report: GapReport) -> float:
    """Error of the link angle over its standard deviation on the held-out intervals, the mean of eight blocks."""
    time = log["time"]
    ends = [np.inf if s.end >= time[-1] else s.end for s in report.held_out]
    held = np.any([(s.begin <= time) & (time < end) for s, end in zip(report.held_out, ends, strict=True)], axis=0)
    square, block = (other["q"] - log["q"]) ** 2, np.minimum((time - time[0]) / (time[-1] - time[0]) * 8 // 1, 7)
    blocks = [np.mean(square[held & (block == b)]) for b in np.unique(block[held])]
    return float(np.sqrt(np.mean(blocks)) / np.std(log["q"][held]))


def test_the_planted_effect_is_named_and_written(folder):
    report, repair = report_in(folder), yaml.safe_load((folder / "repair.yaml").read_text(encoding="utf-8"))
    assert report.verdict == "effect"
    assert [(each["effect"], each["site"]) for each in repair] == [
        ("coulomb_friction", "link"), ("device_numbers", "device")
    ]  # fmt: skip
    low, high = repair[0]["intervals"]["torque"]
    assert low < repair[0]["parameters"]["torque"] < high
    assert repair[0]["parameters"]["torque"] == pytest.approx(0.03, rel=0.05)


def test_via_sim_with_the_effects_file_has_the_claimed_gap(folder):
    report, log = report_in(folder), columns(folder / "log.csv")
    nominal = simulated(folder, "ideal.yaml", "nominal.csv")
    assert nrmse(log, nominal, report) == pytest.approx(report.gap.before, rel=1e-5)
    repaired = simulated(folder, "ideal.yaml", "repaired.csv", "--effects", str(folder / "repair.yaml"))
    assert nrmse(log, repaired, report) == pytest.approx(report.gap.after, rel=1e-5)
    assert nrmse(log, repaired, report) < 0.1 * report.gap.before


def test_the_claimed_gap_is_measured_again_from_the_files(folder):
    report = report_in(folder)
    words = ("--device", str(folder / "device.yaml"), "--effects", str(folder / "repair.yaml"))
    again = (*words, "--report", str(folder / "report.json"), "--json", str(folder / "again.json"))
    run("gap", "simulate", str(folder / "log.csv"), *again)
    found = json.loads((folder / "again.json").read_text(encoding="utf-8"))
    assert (found["before"], found["after"]) == pytest.approx((report.gap.before, report.gap.after), rel=1e-9)
