"""The numbers of docs/method.md are those of the code."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest
from via_gap.selection.numbers import NUMBERS, Numbers

METHOD = (Path(__file__).resolve().parents[2] / "docs" / "method.md").read_text(encoding="utf-8")
CONSTANTS = re.findall(r"^\| (\w+)\.(\w+)\.([A-Z_]+) \| (\S+) \|", METHOD, re.MULTILINE)


@pytest.mark.parametrize(("folder", "module", "name", "value"), CONSTANTS)
def test_every_constant_of_the_table_has_its_value(folder, module, name, value):
    assert getattr(import_module(f"via_gap.{folder}.{module}"), name) == pytest.approx(float(value))


def test_every_number_that_decides_is_in_the_table():
    table = METHOD[METHOD.index("## Numbers that decide") :]
    rows = dict(re.findall(r"^\| (\w+) \| ([\d.]+)", table, re.MULTILINE))
    assert {name: float(rows[name]) for name in Numbers.model_fields} == NUMBERS.model_dump()
    assert len(CONSTANTS) > 25
