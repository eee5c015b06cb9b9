"""`via gap real`: consistent cases, outcomes of answers, reuse of stored results."""

from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest
from via_core.errors import ViaError
from via_gap.report.report import Cause, EffectLocation, GapReport, Value
from via_validation.commands.gap_real import real
from via_validation.gap_real.cases import CASES, DRY, Case
from via_validation.gap_real.page import page
from via_validation.gap_real.run import Elsewhere, Result, keep, kept, key, missing, run_case
from via_validation.gap_real.summary import summary
from via_validation.gap_real.truth import Truth, confidently_wrong, outcome, sizes

PAYLOAD = frozenset({"payload"})
HEAVIER = Truth("heavier", (PAYLOAD,), DRY, frozenset({"quadratic_drag"}), sizes={"payload": 0.225})


def cause(effect: str, probability: float = 0.9, **values: float) -> Cause:
    parameters = {name: Value(value=value, sd=0.1 * abs(value), unit="-") for name, value in values.items()}
    return Cause(
        effect=effect, site="link", joint="elbow", probability=probability, share=probability, parameters=parameters,
        left=0.1, score=1.0,
    )  # fmt: skip


def place(effect: str) -> EffectLocation:
    return EffectLocation(effect=effect, site="link", joint="elbow")


def report(verdict: str, *named: Cause, tied: tuple[str, ...] = ()) -> GapReport:
    """A report that names these causes."""
    effects = tuple(place(each.effect) for each in named)
    return GapReport(
        joint="elbow", level="full", logs=("a",), holdout=("b",), verdict=verdict, where=(), causes=named,
        equivalence_set=(*effects, *map(place, tied)), effects=effects, gap=None, nuisance=(), data_check=(),
        not_evaluated=(),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (report("effect", cause("payload")), "named"),
        (report("several_effects", cause("coulomb_friction"), cause("payload")), "named"),
        (report("effect", cause("gravity_error"), tied=("payload",)), "rightly tied"),
        (report("main_effect", cause("coulomb_friction")), "silent"),
        (report("effect", cause("coulomb_friction")), "wrong"),
        (report("effect", cause("gravity_error")), "wrong"),
        (report("several_effects", cause("payload"), cause("quadratic_drag")), "wrong"),
        (report("unknown"), "silent"),
    ],
)
def test_an_answer_is_compared_with_the_documented_cause(answer: GapReport, expected: str) -> None:
    assert outcome(answer, HEAVIER) == expected
    assert confidently_wrong(answer, HEAVIER) == (expected == "wrong")


def test_causes_that_an_unknown_verdict_lists_are_not_named() -> None:
    listed = report("unknown", cause("quadratic_drag")).model_copy(update={"effects": ()})
    assert outcome(listed, HEAVIER) == "silent"


def test_a_control_is_honest_unless_a_contradicted_cause_is_named() -> None:
    control = Truth("nothing changed", refuted=PAYLOAD)
    assert outcome(report("effect", cause("torque_gain")), control) == "honest"
    assert outcome(report("effect", cause("payload", 0.3)), control) == "wrong"
    assert not confidently_wrong(report("effect", cause("payload", 0.3)), control)
    silent = Truth("not informative", verdicts=frozenset({"cannot_tell"}))
    assert outcome(report("cannot_tell"), silent) == "honest"
    assert outcome(report("no_gap"), silent) == "wrong"


def test_a_ripple_of_another_order_is_not_the_documented_one() -> None:
    cogging = Truth("cogging", (frozenset({"torque_ripple"}),), orders=(7, 12))
    assert outcome(report("effect", cause("torque_ripple", order=12.02)), cogging) == "named"
    assert outcome(report("effect", cause("torque_ripple", order=3.0)), cogging) == "wrong"


def test_the_size_of_a_payload_is_its_mass_times_its_distance() -> None:
    (found,) = sizes([cause("payload", mass=0.9, distance=0.3)], HEAVIER)
    assert found.found == pytest.approx(0.27)
    assert not found.off
    assert replace(found, found=0.46).off
    assert replace(found, found=-0.2).off


def test_every_case_is_consistent() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:
        assert case.nominal().name == case.device
        assert not set(case.fitted) & {*case.held_out, *case.others}
        assert not case.truth.refuted & case.truth.also.union(*case.truth.causes)
    changed = next(case for case in CASES if case.name == "pendulum_no_friction").nominal()
    assert changed.link.coulomb_friction == 0.0
    (runs,) = [case for case in CASES if case.imported]
    odd, even = runs.fitted[0], runs.held_out[0]
    assert fnmatch("constant/record/record_traj11_3.csv", odd)
    assert not fnmatch("constant/record/record_traj10_3.csv", odd)
    assert fnmatch("constant/record/record_traj10_3.csv", even)


def test_a_kept_result_is_used_until_the_case_changes(tmp_path: Path) -> None:
    case = CASES[0]
    result = Result(case=case.name, key=key(case), seconds=1.0, report=report("unknown"))
    assert kept(case, tmp_path) is None
    keep(result, tmp_path)
    assert kept(case, tmp_path) == result
    assert kept(replace(case, truth=HEAVIER), tmp_path) == result  # evaluated again, not diagnosed again
    assert kept(replace(case, changes={"link": {"viscous_friction": 0.0}}), tmp_path) is None
    failed = result.model_copy(update={"report": None, "failure": "ValueError: x"})
    keep(failed, tmp_path)
    assert kept(case, tmp_path) == failed
    (tmp_path / f"{case.name}.json").write_text("{", encoding="utf-8")
    assert kept(case, tmp_path) is None


def test_an_exception_of_the_diagnosis_is_a_failed_result(tmp_path: Path) -> None:
    folder = tmp_path / "dfki_simple_pendulum"
    folder.mkdir()
    (folder / "energy_shaping_1kg.csv").write_text("nothing\n1\n", encoding="utf-8")
    case = next(case for case in CASES if case.name == "pendulum_payload")
    assert missing(case, tmp_path) == ""
    result = run_case(case, tmp_path, lambda _what, _share: None)
    assert result.report is None
    assert result.failure.startswith("SignalError")
    assert summary([(case, result)]).failed == 1


def test_page_and_summary_show_every_case_and_its_misses() -> None:
    def made(case: Case, answer: GapReport | None, **more: object) -> tuple[Case, Result]:
        return case, Result(case=case.name, key="", seconds=2.0, report=answer, **more)  # type: ignore[arg-type]

    first, second, third = CASES[0], CASES[2], CASES[1]
    worse = Elsewhere(log="other.csv", before=0.1, after=0.2, ratio=(1.5, 2.5))
    pairs = [
        made(first, report("effect", cause("payload", mass=0.95, distance=0.5)), elsewhere=(worse,)),
        made(second, report("effect", cause("payload", mass=0.4, distance=0.5))),
        made(third, None, failure="ValueError: no"),
    ]
    counts = summary(pairs)
    assert (counts.known, counts.named, counts.failed, counts.controls, counts.honest) == (2, 1, 1, 1, 0)
    assert (counts.wrong, counts.confidently_wrong, counts.compared, counts.worse, counts.sized, counts.off) == (
        1,
        1,
        1,
        1,
        1,
        1,
    )
    text = page(pairs, "a commit")
    assert f"## {first.name}: named" in text
    assert f"Not run: {CASES[3].name}, " in text
    assert "payload 0.475 (0.225 documented, off)" in text
    assert f"## {second.name}: wrong" in text
    assert f"## {third.name}: failed" in text
    assert "`other.csv` 10 -> 20 % (worse; ratio 1.50 to 2.50)" in text


def test_without_recordings_it_is_skipped_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "clone").mkdir()
    monkeypatch.chdir(tmp_path / "clone")
    real(write=tmp_path / "out")
    assert capsys.readouterr().out.startswith("skipped: ")
    assert not (tmp_path / "out").exists()
    (tmp_path / "empty").mkdir()
    real(["pendulum_payload"], data=tmp_path / "empty")
    assert "skipped pendulum_payload: no folder dfki_simple_pendulum in" in capsys.readouterr().out
    with pytest.raises(ViaError, match="no folder"):
        real(data=tmp_path / "nowhere")
    with pytest.raises(ViaError, match="no case nonsense; there are: pendulum_payload"):
        real(["nonsense"], data=tmp_path)


def test_the_ratio_of_errors_is_resampled_in_pairs() -> None:
    from via_gap.residual.errors import Errors
    from via_validation.gap_real.run import _ratio

    squares = np.random.default_rng(0).uniform(0.1, 10.0, (50, 1))
    before = Errors(("q",), squares, np.ones(1), np.zeros(1))
    low, high = _ratio(before, replace(before, squares=1.21 * squares))
    assert low == pytest.approx(1.1)
    assert high == pytest.approx(1.1)
