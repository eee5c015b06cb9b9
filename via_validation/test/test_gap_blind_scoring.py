"""Running, evaluation, scoring and the page, for hand-made reports with known scores."""

from __future__ import annotations

import json
import re
import shlex
import sys
from dataclasses import replace
from math import inf
from pathlib import Path
from xml.etree import ElementTree

import pytest
from gap_verdicts import COULOMB, LAG, key, report, where
from typer.testing import CliRunner
from via_core.errors import ViaError
from via_validation.commands.gap_blind import app
from via_validation.sealed.evaluation import Evaluation, Shrinkage, evaluate
from via_validation.sealed.intervals import IntervalCheck
from via_validation.sealed.measuring import shrinkage_of
from via_validation.sealed.page import as_json, cases_markdown, picture, reason, write_page
from via_validation.sealed.plan import plan
from via_validation.sealed.rightness import Cause
from via_validation.sealed.running import RUNS, command_words, run_cases
from via_validation.sealed.scoring import (
    OVERALL,
    Bin,
    Number,
    Score,
    calibration_error,
    parameter_coverage,
    reliability,
    score,
)


def test_a_right_answer_is_right_everywhere() -> None:
    gap = {"before": 0.4, "after": 0.1, "explained": 0.95}
    answer = report("effect", (COULOMB, 0.9), (LAG, 0.1), where=where(("motor", 1)), equivalence_set=[COULOMB], gap=gap)
    found = evaluate("case_000", key("single", COULOMB), answer, Shrinkage(0.5, 0.1, 0.05), 3.0)
    assert found.where_right and found.top1 and found.place_right and found.in_set and found.right
    assert found.both is None and found.probability == 0.9 and found.explained == 0.95
    assert found.predicted == pytest.approx(0.75) and found.measured == pytest.approx(0.8)
    assert found.measured_explained == pytest.approx(0.4 / 0.45)


def test_the_right_effect_at_the_wrong_motor_has_a_wrong_location() -> None:
    other = {**COULOMB, "motor": 2}
    answer = report("effect", (other, 0.6), where=where(("motor", 2)), equivalence_set=[other, LAG])
    found = evaluate("case_000", key("single", COULOMB), answer, None, None)
    assert found.top1 and found.in_set and not found.place_right and not found.where_right


def test_a_missing_number_is_not_wrong_but_sensor_0_is_the_link() -> None:
    answer = report("effect", (COULOMB, 0.6), where=where(("motor", 0)))
    assert evaluate("a", key("single", COULOMB), answer, None, None).where_right
    for site in ("sensor", "timing"):
        skew = {"effect": "channel_skew", "site": site, "motor": 1}
        link = {**skew, "motor": 0}
        answer = report("effect", (link, 0.6), where=where((site, 0)))
        found = evaluate("a", key("single", skew), answer, None, None)
        assert found.top1 and not found.where_right and not found.place_right
        assert evaluate("a", key("single", link), answer, None, None).where_right


def test_in_the_set_is_not_first() -> None:
    answer = report("effect", (LAG, 0.5), (COULOMB, 0.4), where=where(("command", 0)), equivalence_set=[LAG, COULOMB])
    found = evaluate("case_000", key("single", COULOMB), answer, None, None)
    assert found.in_set and not found.top1 and not found.right and len(found.tied) == 2


@pytest.mark.parametrize("verdict", ["no_gap", "unknown", "cannot_tell"])
def test_no_answer_names_no_cause(verdict: str) -> None:
    """Whatever else such a report lists, it has not named the effect."""
    answer = report(verdict, (COULOMB, 0.2), equivalence_set=[COULOMB])
    found = evaluate("case_000", key("single", COULOMB), answer, None, None)
    assert not found.top1 and not found.in_set and not found.answered


@pytest.mark.parametrize(("written", "read"), [("two_effects", "several_effects"), ("main_effect", "main_effect")])
def test_verdicts_of_today_and_of_older_reports(written: str, read: str) -> None:
    answer = report(written, (COULOMB, 0.9), where=where(("motor", 1)))
    found = evaluate("a", key("single", COULOMB), answer, None, None)
    assert found.verdict == read and found.answered and found.top1 and found.main_right


def test_with_dirt_the_main_cause_counts() -> None:
    asked = key("single", COULOMB, dirt={"effect": "extra_mode"}, quality="degraded")
    for verdict, right in (("main_effect", True), ("effect", True), ("several_effects", True), ("unknown", False)):
        found = evaluate("a", asked, report(verdict, (COULOMB, 0.9), (LAG, 0.5)), None, None)
        assert found.dirty and found.quality == "degraded" and found.main_right is right
    assert not evaluate("a", asked, report("main_effect", (LAG, 0.9)), None, None).main_right


def test_pairs_need_both_causes_in_any_order_and_nothing_else() -> None:
    asked = key("pair", COULOMB, LAG)
    sites = where(("command", 0), ("motor", 1))
    both = evaluate("a", asked, report("several_effects", (LAG, 0.9), (COULOMB, 0.9), where=sites), None, None)
    assert both.both and both.right and both.where_right
    assert not evaluate("a", asked, report("effect", (LAG, 0.9), (COULOMB, 0.9)), None, None).both
    bias = {"effect": "torque_bias", "site": "motor", "motor": 1}
    one = evaluate("a", asked, report("several_effects", (LAG, 0.9), (bias, 0.9), (COULOMB, 0.5)), None, None)
    assert not one.both and not one.where_right and not one.in_set
    tied = evaluate(
        "a", asked, report("several_effects", (LAG, 0.9), (bias, 0.9), equivalence_set=[bias, COULOMB]), None, None
    )
    assert tied.in_set and not tied.both


def test_a_missing_report_is_wrong() -> None:
    for kind, effects in (("single", [COULOMB]), ("no_gap", []), ("unknown", [LAG]), ("pair", [LAG, COULOMB])):
        assert not evaluate("a", key(kind, *effects), None, None, None, "no report").right


def cases() -> list[Evaluation]:
    """Twelve cases: see the numbers in `test_numbers_are_those_worked_out_by_hand`."""
    right = report("effect", (COULOMB, 0.9), where=where(("motor", 1)), equivalence_set=[COULOMB])
    right["gap"] = {"before": 1.0, "after": 0.2, "explained": 1.0}
    right["conformal_set"] = [COULOMB]
    right["causes"][0]["parameters"] = {"torque": {"value": 0.03, "sd": 0.001, "unit": "N m"}}
    tied = report("effect", (LAG, 0.6), where=where(("motor", 1)), equivalence_set=[LAG, COULOMB])
    tied["gap"] = {"before": 1.0, "after": 0.4, "explained": 0.8}
    tied["conformal_set"] = [LAG, COULOMB]
    dry = {**COULOMB, "parameters": {"torque": 0.031}}
    dirt, last = {"dirt": {"effect": "extra_mode"}}, "encoder_and_command"
    pair = report("several_effects", (LAG, 0.9), (COULOMB, 0.8))
    return [
        evaluate("case_000", key("single", dry), right, Shrinkage(1.0, 0.23, 0.0), 2.0),
        evaluate(
            "case_001", key("single", {**dry, "parameters": {"torque": 0.1}}), right, Shrinkage(1.0, 0.2, 0.0), 4.0
        ),
        evaluate("case_002", key("single", COULOMB), tied, Shrinkage(1.0, 0.6, 0.0), 6.0),
        evaluate("case_003", key("single", COULOMB), report("cannot_tell"), None, None),
        evaluate("case_004", key("no_gap"), report("no_gap"), None, None),
        evaluate("case_005", key("no_gap", quality="degraded"), report("effect", (COULOMB, 0.7)), None, None),
        evaluate("case_006", key("unknown", LAG), report("unknown"), None, None),
        evaluate("case_007", key("pair", COULOMB, LAG), pair, None, None),
        evaluate("case_008", key("single", COULOMB, level=last), report("effect", (COULOMB, 0.9)), None, None),
        evaluate("case_009", key("single", LAG, level=last), None, None, None, "took too long"),
        evaluate("case_010", key("single", COULOMB, **dirt), report("main_effect", (COULOMB, 0.9)), None, None),
        evaluate("case_011", key("single", COULOMB, **dirt), report("unknown", (COULOMB, 0.9)), None, None),
    ]


def test_numbers_are_those_worked_out_by_hand() -> None:
    scored = score(cases())
    got = {(number.group, number.name): number for number in scored.numbers}

    def number(name: str, group: str = OVERALL) -> Number:
        return got[group, name]

    def value(name: str, group: str = OVERALL) -> float:
        found = number(name, group).value
        assert found is not None
        return found

    # of clean recordings of good quality with more than encoder and command: 000 to 003
    assert value("where right") == pytest.approx(3 / 4)
    assert value("top-1") == pytest.approx(2 / 4) and number("top-1").cases == 4 and number("top-1").kept is False
    assert value("in set") == value("named or rightly tied") == pytest.approx(3 / 4)
    assert value("mean set size") == pytest.approx((1 + 1 + 2) / 3)
    assert value("main cause named, with dirt") == pytest.approx(1 / 2)
    assert value("false alarms on no gap") == pytest.approx(1 / 2)  # the one that was degraded counts
    assert value("confidently wrong") == pytest.approx(2 / 12)  # 002 and 005
    assert value("unknown recognised") == 1.0 and number("unknown recognised").kept is True
    assert value("two effects: both named") == value("two effects: both named or in the set") == 1.0
    assert value("explained, of what is achievable") == pytest.approx((1.0 + 1.0 + 0.8) / 3)
    # predicted .8, .8, .6; measured .77, .8, .4
    assert value("predicted less measured shrinkage, absolute") == pytest.approx((0.03 + 0.0 + 0.2) / 3)
    assert value("abstained (cannot_tell)") == pytest.approx(1 / 12)
    assert value("without a report") == pytest.approx(1 / 12)
    assert value("seconds per case") == pytest.approx(4.0)
    # answers: .9 right (000, 001, 007, 008, 010), .6 wrong (002), .7 wrong (no gap)
    assert number("expected calibration error").cases == 7
    assert value("expected calibration error") == pytest.approx((5 * 0.1 + 0.6 + 0.7) / 7)
    assert value("bins that hold answers") == 3.0 and number("bins that hold answers").kept is False
    assert value("Brier score") == pytest.approx((5 * 0.01 + 0.36 + 0.49) / 7)
    assert [(each.low, each.count, each.right) for each in scored.reliability] == [
        (0.6, 1, 0.0),
        (0.7, 1, 0.0),
        (0.9, 5, 1.0),
    ]
    assert [each.name for each in scored.missed] == ["case_002", "case_003", "case_005", "case_009", "case_011"]
    # intervals .030 +- .00196: hold .031, not .1
    held = [each for each in scored.numbers if each.name == "parameter intervals hold the truth"]
    assert [(each.value, each.limit, each.at_least, each.kept) for each in held[:2]] == [
        (0.5, 0.90, True, False),
        (0.5, 0.98, False, True),
    ]
    assert parameter_coverage(scored.evaluations) == (("coulomb_friction: torque", 2, 0.5),)


def test_groups_are_clean_and_dirty_signal_sets_and_degraded_recordings() -> None:
    got = {(number.group, number.name): number for number in score(cases()).numbers}
    assert got["encoder and command", "named or rightly tied"].value == pytest.approx(1 / 2)
    assert got["encoder and command", "named or rightly tied"].limit == 0.80
    assert got["encoder and command, clean", "top-1"].value == pytest.approx(1 / 2)
    assert got["full, clean", "top-1"].value == pytest.approx(2 / 4)
    assert got["full, dirty", "main cause named"].value == pytest.approx(1 / 2)
    assert got["full", "conformal set holds the truth"].value == 1.0
    assert got["full", "mean size of the conformal set"].value == pytest.approx(4 / 3)
    assert got["full", "mean size of the conformal set"].limit == 1.5
    assert got["degraded recordings", "false alarms on no gap"].value == 1.0
    assert ("link only", "false alarms on no gap") not in got  # no case, no number
    assert all(each.limit is None for (group, _), each in got.items() if "," in group or "degraded" in group)


def test_calibration_of_certainty_and_of_nothing() -> None:
    certain = replace(cases()[0], probability=1.0)
    (only,) = reliability([certain])
    assert only == Bin(0.9, 1, 1.0, 1.0) and calibration_error([only]) == 0.0
    assert reliability([]) == () and calibration_error([]) is None
    assert score([]).numbers[0].value is None and score([]).numbers[0].kept is False


def test_the_pages_list_every_number_and_every_case_once(tmp_path: Path) -> None:
    scored = score(cases())
    write_page(scored, tmp_path, "commit abc: via gap blind score")
    text = (tmp_path / "gap.md").read_text()
    listed = (tmp_path / "gap-cases.md").read_text()
    misses = listed.partition("## Not missed")[0]
    assert re.findall(r"case_\d+", misses) == ["case_002", "case_003", "case_005", "case_009", "case_011"]
    assert sorted(re.findall(r"case_\d+", listed)) == [f"case_{number:03}" for number in range(12)]
    assert "5 cases missed;\n[every case](gap-cases.md)." in text and "](gap.md)" in listed and "commit abc" in listed
    assert "### Full, dirty" in text and "### Encoder and command" in text and "### Degraded recordings" in text
    assert "| coulomb_friction: torque | 2 | 0.50 |" in text
    assert "took too long" in misses and "commit abc" in text and "MISSED" in text
    for line in [*text.splitlines(), *listed.splitlines()]:
        if line.startswith("|"):
            assert line.endswith("|")
    ElementTree.fromstring((tmp_path / "gap-reliability.svg").read_text())
    assert picture(()).count("<circle") == 0
    assert json.loads(json.dumps(as_json(scored), allow_nan=False))["cases"][5]["right"] is False
    lacking = replace(scored.evaluations[5], inside=(IntervalCheck("torque_ripple", "amplitude", inf),))
    written = json.dumps(as_json(replace(scored, evaluations=(lacking,))), allow_nan=False)
    assert json.loads(written)["cases"][0]["inside"][0]["distance"] is None
    assert cases_markdown(Score((), (), ()), "").count("None.") == 2


def fake(folder: Path, script: str) -> str:
    """A command that runs `script` with the placeholders as arguments."""
    file = folder / "fake.py"
    file.write_text(script)
    return f"{shlex.quote(sys.executable)} {shlex.quote(str(file))}"


def folders(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name / "bag").mkdir(parents=True)
        (folder / name / "seal.txt").write_text("x\n")
        (folder / name / "joint.yaml").write_text("name: joint\n")
    return folder


def test_a_diagnosis_gets_only_its_case_and_is_not_repeated(tmp_path: Path) -> None:
    cases_folder = folders(tmp_path / "cases", "case_000", "case_001")
    script = "import json, os, sys; json.dump([sys.argv[1:], os.getcwd()], open(sys.argv[3], 'w'))\n"
    command = fake(tmp_path, script) + " {bag} {device} {json} {effects}"
    ran = run_cases(cases_folder, tmp_path / "results", command, 60.0, 2, lambda _: None)
    assert [(each.name, each.code) for each in ran] == [("case_000", 0), ("case_001", 0)]
    arguments, where_it_ran = json.loads((tmp_path / "results" / "case_001.json").read_text())
    assert arguments[:2] == [str(cases_folder / "case_001" / "bag"), str(cases_folder / "case_001" / "joint.yaml")]
    assert arguments[3] == str(tmp_path / "results" / "case_001.yaml") and where_it_ran == str(tmp_path / "results")
    again: list[str] = []
    run_cases(cases_folder, tmp_path / "results", command, 60.0, 1, lambda each: again.append(each.name))
    assert again == []
    (tmp_path / "results" / "case_000.json").unlink()
    run_cases(cases_folder, tmp_path / "results", command, 60.0, 1, lambda each: again.append(each.name))
    assert again == ["case_000"]
    (tmp_path / "results" / RUNS).unlink()  # interrupted between a report and its line
    ran = run_cases(cases_folder, tmp_path / "results", command, 60.0, 2, lambda _: None)
    assert [each.name for each in ran] == ["case_000", "case_001"]


def test_a_failing_diagnosis_has_its_error_and_a_slow_one_is_stopped(tmp_path: Path) -> None:
    cases_folder = folders(tmp_path / "cases", "case_000")
    command = fake(tmp_path, "import sys; sys.exit('error: this log holds nothing')\n")
    (failed,) = run_cases(cases_folder, tmp_path / "a", command, 60.0, 1, lambda _: None)
    assert failed.code == 1 and "this log holds nothing" in failed.said
    command = fake(tmp_path, "import threading; threading.Event().wait(60)\n")
    (slow,) = run_cases(cases_folder, tmp_path / "b", command, 0.5, 1, lambda _: None)
    assert slow.code is None and "longer than 0.5 s" in slow.said


def test_an_unknown_placeholder_is_an_error() -> None:
    with pytest.raises(ViaError, match=r"\('keys'\); placeholders are \{bag\}, \{json\}"):
        command_words("diagnose {keys}", bag=Path("b"), json=Path("j"))


def test_shrinkage_is_read_from_the_command(tmp_path: Path) -> None:
    paths = (tmp_path / "log", tmp_path / "d.yaml", tmp_path / "e.yaml", tmp_path / "r.json")
    script = (
        "import json, sys; json.dump({'gap': {'before': 0.5, 'after': 0.1, 'floor': 0.05}}, open(sys.argv[1], 'w'))\n"
    )
    assert shrinkage_of(*paths, fake(tmp_path, script) + " {json} {log}") == Shrinkage(0.5, 0.1, 0.05)
    with pytest.raises(ViaError, match="ended with 3"):
        shrinkage_of(*paths, fake(tmp_path, "raise SystemExit(3)\n") + " {json}")
    with pytest.raises(ViaError, match="wrote no gap"):
        shrinkage_of(*paths, fake(tmp_path, "pass\n") + " {json}")
    assert Shrinkage(0.0, 0.0).share is None and Shrinkage(0.1, 0.05, 0.2).explained is None


def test_make_run_and_score_from_the_command(tmp_path: Path) -> None:
    """The whole protocol with a diagnosis that always says 'no gap'."""
    runner = CliRunner()
    cases_folder, keys, results = tmp_path / "cases", tmp_path / "keys", tmp_path / "results"
    seed = next(seed for seed in range(1000) if plan(seed).kind == "no_gap")
    words = ["make", "--out", str(cases_folder), "--keys", str(keys), "--seed-from", str(seed), "--count", "1"]
    done = runner.invoke(app, [*words, "--duration", "5", "--processes", "1"])
    assert done.exit_code == 0, done.output
    (digest,) = re.findall(r"^([0-9a-f]{64})  case_000\.json$", done.stdout, re.M)
    assert (cases_folder / "case_000" / "seal.txt").read_text().strip() == digest
    answer = json.dumps(report("no_gap"))
    command = fake(tmp_path, f"import sys; open(sys.argv[1], 'w').write({answer!r})\n") + " {json}"
    done = runner.invoke(app, ["run", str(cases_folder), "--results", str(results), "--command", command])
    assert done.exit_code == 0, done.output
    words = ["score", str(cases_folder), "--keys", str(keys), "--results", str(results), "--simulate", ""]
    done = runner.invoke(app, [*words, "--json", str(tmp_path / "s.json"), "--write", str(tmp_path / "docs")])
    assert done.exit_code == 1  # limits without a case are not kept
    (case,) = json.loads((tmp_path / "s.json").read_text())["cases"]
    assert case["kind"] == "no_gap" and case["right"] is True and Cause(**COULOMB) not in case["named"]
    assert "via gap blind score" in (tmp_path / "docs" / "gap.md").read_text()
    (keys / "case_000.json").write_text("{}")
    done = runner.invoke(app, words)
    assert isinstance(done.exception, ViaError) and "differs from the sealed one" in str(done.exception)


def test_the_reason_of_a_crash_is_its_exception():
    trace = (
        'line 3, in solve\n    a\n  File \n"some/where.py"\n    raise LinAlgError(\nnumpy.LinAlgError: not \ndefinite'
    )
    assert reason(trace) == "numpy.LinAlgError: not definite"
    assert reason("no log to diagnose") == "no log to diagnose"
