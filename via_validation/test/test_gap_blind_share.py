"""Two cases of the sealed benchmark from end to end: make, run and score."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner
from via_validation.commands.gap_blind import app
from via_validation.exports.exported import exported
from via_validation.exports.reading import read_all
from via_validation.exports.sources import sealed_sources

SEEDS = {"22247": "coulomb_friction", "20943": "quadratic_drag"}  # the first of rigid joints, clean, good recordings


@pytest.mark.timeout(600)  # [s] six processes, each of which compiles or loads the simulators anew
def test_cases_drawn_here_are_answered_right(tmp_path: Path) -> None:
    runner = CliRunner()
    for seed, effect in SEEDS.items():
        cases, keys, results = (str(tmp_path / seed / name) for name in ("cases", "keys", "results"))
        drawn = ["make", "--out", cases, "--keys", keys, "--seed-from", seed, "--count", "1", "--duration", "24"]
        assert runner.invoke(app, [*drawn, "--processes", "1"]).exit_code == 0
        (sealed,) = (json.loads(each.read_text()) for each in Path(keys).glob("case_*.json"))
        assert (sealed["family"], sealed["dirt"], sealed["quality"]) == ("rigid", None, "good")
        assert runner.invoke(app, ["run", cases, "--results", results]).exit_code == 0
        file = tmp_path / seed / "score.json"
        scored = runner.invoke(app, ["score", cases, "--keys", keys, "--results", results, "--json", str(file)])
        assert scored.exit_code == 1  # a limit without a case is not kept
        (case,) = json.loads(file.read_text())["cases"]
        assert (case["right"], case["where_right"], case["truths"][0]["effect"]) == (True, True, effect)
        assert case["explained"] > 0.9
        assert abs(case["predicted"] - case["measured"]) < 0.05
        made = exported(sealed_sources(Path(cases), Path(results))[0], tmp_path / seed / "files")
        assert made.effects == (f"{effect} (link)",) and made.kept and not made.lost_effects
        assert made.mujoco is not None and made.mujoco.after == pytest.approx(made.expected, abs=0.001)
        assert not any(any(files.values()) for files in read_all(tmp_path / seed / "files").values())
