"""`via gap render`: a stored report as text and as a page; what is none is one line and exit code 2."""

import sys

import pytest
from via_bringup import cli
from via_gap.logs.findings import Finding
from via_gap.report.figures import Figures, JointSketch
from via_gap.report.report import GapReport

REFUSED = GapReport(
    joint="elbow", level="link only", logs=("run.csv",), holdout=("blocks of the same logs",), verdict="cannot_tell",
    where=(), causes=(), equivalence_set=(), effects=(), gap=None, nuisance=(), not_evaluated=(),
    data_check=(
        Finding(log="run.csv", check="drive", signal="commands", severity="refuse", value=0.0, text="no commands"),
    ),
    figures=Figures(
        joint=JointSketch(arrangement="flexible", drive="torque", motors_seen=(False,), torque_seen=False)
    ),
)  # fmt: skip


@pytest.fixture
def via(monkeypatch, capfd, tmp_path):
    """Run `via` with these words in a folder of its own: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["via", *words])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capfd.readouterr()
        return end.value.code, out, err

    return run


def test_a_stored_report_is_shown_and_written_as_a_page(via, tmp_path):
    (tmp_path / "report.json").write_text(REFUSED.to_json(), encoding="utf-8")
    code, out, err = via("gap", "render", "report.json", "--html", "report.html")
    assert (code, err) == (0, "")
    assert out.startswith("elbow: The cause of the gap cannot be determined: run.csv: no commands.")
    assert "wrote report.html" in out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "The cause of the gap cannot be determined: run.csv: no commands." in page


def test_what_cannot_be_read_or_written_is_one_line(via, tmp_path):
    (tmp_path / "report.json").write_text(REFUSED.to_json(), encoding="utf-8")
    (tmp_path / "other.json").write_text("{}", encoding="utf-8")
    for words in (("missing.json",), ("other.json",), ("report.json", "--html", "nowhere/report.html")):
        code, _, err = via("gap", "render", *words)
        assert code == 2 and len(err.strip().splitlines()) == 1
