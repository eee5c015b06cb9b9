"""`via gap real`: without recordings it says so, and what it says of a report is what the report says."""

from pathlib import Path

import pytest
from via_bringup.cli.gap_real import real
from via_bringup.gap_real.page import causes, numbers, verdict
from via_core.errors import ViaError
from via_gap.report.report import Cause, GapReport, NuisanceValue, Place, Value

FRICTION = Cause(
    effect="coulomb_friction", site="link", joint="elbow", motor=0, probability=0.9, left=0.07, score=1.0,
    parameters={"torque": Value(value=0.1234, sd=0.001, unit="N m")},
)  # fmt: skip
PLACE = Place(effect="coulomb_friction", site="link", joint="elbow", motor=0)
MOVED = NuisanceValue(name="link inertia", unit="kg m^2", filed=1.0, fitted=1.05, deviations=1.3, at_bound=True)
REPORT = GapReport(
    joint="elbow", level="full", logs=("a",), holdout=("b",), verdict="unknown", where=(), causes=(FRICTION,),
    equivalence_set=(PLACE, PLACE.model_copy(update={"effect": "torque_gain"})), effects=(PLACE,), gap=None,
    nuisance=(MOVED,), data_check=(), not_judged=(),
)  # fmt: skip


def test_without_recordings_it_is_skipped_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "clone").mkdir()
    monkeypatch.chdir(tmp_path / "clone")
    real(None, tmp_path / "out")
    assert capsys.readouterr().out.startswith("skipped: ")
    assert not (tmp_path / "out").exists()
    with pytest.raises(ViaError, match="no folder maccepavd in"):
        real(tmp_path, None)


def test_the_page_says_what_the_report_says() -> None:
    told = verdict(REPORT)
    assert "None of the known effects alone" in told
    assert "coulomb_friction (link)" in told
    assert "Not told apart: coulomb_friction, torque_gain" in told
    both = REPORT.model_copy(update={"effects": REPORT.equivalence_set})
    assert "as good" not in verdict(both) and "Not told apart" not in verdict(both)
    more = both.model_copy(
        update={"equivalence_set": (*both.effects, Place(effect="payload", joint="joint", site="link"))}
    )
    assert verdict(more).endswith("In place of one of them as good: payload.")
    assert "nothing is repaired" in verdict(REPORT.model_copy(update={"effects": ()}))
    assert verdict(REPORT.model_copy(update={"effects": (), "equivalence_set": (PLACE,)})).endswith("is repaired.")
    assert "| coulomb_friction | link | 0.90 | 7 % | torque 0.123 +- 0.001 N m |" in causes(REPORT)
    assert "| link inertia [kg m^2] | 1 | 1.05 | at the end of its tolerance |" in numbers(REPORT)
