"""The report: its JSON round-trips, its schema is the shipped one, its repair is what the simulator loads."""

import json
from importlib import resources

import pytest
from via_core.errors import ParameterError
from via_gap.report.report import Cause, EffectLocation, GapReport, NuisanceValue, Value, Where, read_report
from via_gap.selection.gap import Gap, SignalGap
from via_sim.effects import Effect
from via_sim.effects.files import load_effects, save_effects


def report() -> GapReport:
    cause = Cause(
        effect="backlash", site="transmission", joint="elbow", motor=1, probability=0.9, share=0.9,
        parameters={"gap": Value(value=0.02, sd=1e-4, unit="rad")}, left=0.01, score=0.7,
    )  # fmt: skip
    place = EffectLocation(effect="backlash", site="transmission", joint="elbow", motor=1)
    gap = Gap(
        by="segments", before=0.2, tuned=0.1, after=0.02, interval=(0.01, 0.03), floor=0.01, bound=0.02, explained=1.0,
        signals={"q": SignalGap(before=0.2, after=0.02, floor=0.01, bound=0.02, explained=1.0)},
    )  # fmt: skip
    return GapReport(
        joint="elbow", level="full", logs=("a",), holdout=("b",), verdict="effect",
        where=(Where(joint="elbow", site="transmission", motor=1, equation="link and motor 1", share=1.0),),
        causes=(cause,), equivalence_set=(place,), effects=(place,), gap=gap, nuisance=(), data_check=(),
        not_evaluated=(),
    )  # fmt: skip


def test_json_round_trips():
    assert read_report(report().to_json(), "report.json") == report()


def test_the_shipped_schema_is_that_of_the_report():
    shipped = resources.files("via_gap.report").joinpath("gap_report.schema.json").read_text(encoding="utf-8")
    assert json.loads(shipped) == json.loads(json.dumps(GapReport.model_json_schema()))


def test_documented_keys_are_in_the_json():
    content = json.loads(report().to_json())
    assert content.keys() >= {
        "verdict",
        "where",
        "causes",
        "equivalence_set",
        "gap",
        "nuisance",
        "data_check",
        "noise",
        "reason",
        "explained",
        "proposal",
    }
    assert content["where"][0].keys() >= {"joint", "site", "equation", "share", "regions"}
    assert content["causes"][0].keys() >= {"effect", "site", "joint", "probability", "parameters"}
    assert content["causes"][0]["parameters"]["gap"].keys() >= {"value", "sd", "unit"}
    assert content["gap"].keys() >= {"before", "after", "interval", "floor", "bound", "explained", "signals"}


def test_what_is_no_report_is_refused_in_one_line():
    for text in ("", "{}", '{"version": "3", "verdict": "guilty"}', "[1]"):
        with pytest.raises(ParameterError, match=r"^r\.json: not a gap report") as caught:
            read_report(text, "r.json")
        assert "\n" not in str(caught.value)


def test_repair_is_an_effects_file_that_the_simulator_loads(tmp_path):
    (effect,) = report().repair()
    assert effect == Effect("backlash", "transmission", {"gap": 0.02}, 1)
    save_effects(tmp_path / "repair.yaml", report().repair())
    assert load_effects(tmp_path / "repair.yaml") == (effect,)


def test_a_device_parameter_filed_as_zero_has_no_factor():
    given = {"name": "n", "unit": "-", "filed": 0.0, "fitted": 1.0, "offset": 0.0, "at_bound": False}
    with pytest.raises(ValueError, match="which is no factor"):
        NuisanceValue.model_validate(given)
    assert NuisanceValue.model_validate(given | {"fitted": 0.0}).filed == 0.0


def test_effects_that_are_no_causes_are_refused():
    given = json.loads(report().to_json())
    given["effects"][0]["effect"] = "stiction"
    with pytest.raises(ParameterError, match="stiction at transmission 1 is not among the causes"):
        read_report(json.dumps(given), "report.json")
