"""`via gap fleet`: its table as CSV, Markdown and terminal cells, and its report of unreadable logs."""

import csv
import io
import json

from typer.testing import CliRunner
from via_bringup.cli import app
from via_bringup.cli.gap_fleet import HEADER, as_csv, as_markdown, cells
from via_gap.run.fleet import Row

DONE = Row(
    "a|b.csv", "k1", "", "effect", "motor 1", 0.9, "backlash at transmission 1", 0.98, "gap 0.02 +- 1e-4 rad",
    0.5, 0.01, 0.004, 0.97, 2.5, "reports/a.json",
)  # fmt: skip
BAD = Row("c.csv", "k2", 'c.csv: cannot be read, "really"')


def test_csv_contains_all_fields_and_can_be_read_back():
    first, second = csv.DictReader(io.StringIO(as_csv([DONE, BAD])))
    assert (first["log"], float(first["after"]), first["report"]) == ("a|b.csv", 0.01, "reports/a.json")
    assert (second["reason"], second["verdict"], second["after"]) == (BAD.reason, "", "")


def test_markdown_has_a_cell_per_column_and_row():
    lines = as_markdown([DONE, BAD]).splitlines()
    assert len(lines) == 4
    assert {line.replace("\\|", "").count("|") for line in lines} == {len(HEADER) + 1}


def test_cells_of_a_failed_log_show_the_reason():
    assert cells(DONE) == (
        "a|b.csv", "effect", "motor 1 90 %", "backlash at transmission 1", "98 %", "0.5", "0.01", "97 %",
    )  # fmt: skip
    assert cells(BAD) == ("c.csv", "-", "", BAD.reason, "", "", "", "")


def test_unreadable_logs_get_a_row_and_the_exit_code_is_2(tmp_path):
    words = ["gap", "fleet", str(tmp_path / "none.csv"), "--device", "cubic_demo", "--results", str(tmp_path / "out")]
    answer = CliRunner().invoke(app, words)
    assert answer.exit_code == 2 and "1 of 1 logs have no report" in answer.output
    assert {"No", "such", "file", "or", "directory"} <= set(answer.output.split())  # the cell may be wrapped
    (row,) = json.loads((tmp_path / "out" / "fleet.json").read_text())
    assert row["reason"].endswith("No such file or directory") and row["verdict"] == ""
    assert len((tmp_path / "out" / "fleet.csv").read_text().splitlines()) == 2
