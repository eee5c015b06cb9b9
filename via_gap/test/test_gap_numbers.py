"""The numbers of docs/method.md are those of the code, and none of the decision is missing there."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import pytest
import via_gap.selection
from via_gap.selection.numbers import NUMBERS, Numbers

METHOD = (Path(__file__).resolve().parents[2] / "docs" / "method.md").read_text(encoding="utf-8")
THRESHOLDS = re.findall(r"^\| (\w+)\.(\w+)\.([A-Z_]+) \| (\S+) \|", METHOD, re.MULTILINE)
EFFORT = [
    (folder, module, *each)
    for folder, module, text in re.findall(r"^\| (\w+)\.(\w+) \| (.+) \|$", METHOD, re.MULTILINE)
    for each in re.findall(r"`([A-Z_]+) = (\S+)`", text)
]
CONSTANTS = [*THRESHOLDS, *EFFORT]
# Finite-difference steps, and details of an approximation that the page leaves to the files.
UNLISTED = {"between.STEP", "bound.PULSE", "information.EXHAUSTIVE"} | {
    f"basis.{name}" for name in ("STEP", "KNOTS", "TIME_KNOTS", "FAR")
}


@pytest.mark.parametrize(("folder", "module", "name", "value"), CONSTANTS)
def test_every_constant_of_the_tables_has_its_value(folder, module, name, value):
    assert getattr(import_module(f"via_gap.{folder}.{module}"), name) == pytest.approx(float(value))


def test_every_number_that_decides_is_in_the_table():
    table = METHOD[METHOD.index("## Numbers that decide") :]
    rows = dict(re.findall(r"^\| (\w+) \| ([\d.]+)", table, re.MULTILINE))
    assert {name: float(rows[name]) for name in Numbers.model_fields} == NUMBERS.model_dump()
    assert len(THRESHOLDS) > 20
    assert len(EFFORT) > 30


def test_every_constant_of_the_selection_is_in_a_table():
    listed = {f"{module}.{name}" for folder, module, name, _ in CONSTANTS if folder == "selection"}
    defined = {
        f"{each.name}.{name}"
        for each in iter_modules(via_gap.selection.__path__)
        for name, value in re.findall(
            r"^([A-Z_]+) = (-?[\d.]+(?:e-?\d+)?)\b",
            (Path(via_gap.selection.__path__[0]) / f"{each.name}.py").read_text("utf-8"),
            re.MULTILINE,
        )
    }
    assert defined - listed == UNLISTED
