"""Numbers and sentences of a report: nothing rounds to certainty, and sentences follow from the decision."""

import pytest
from gap_reports import BACKLASH, COULOMB, KINDS, RIPPLE, STEPS, VISCOUS, cause, place, report_of, trial
from hypothesis import given
from hypothesis import strategies as st
from via_gap.rendering.evidence_words import evidence, findings, rejected, separation, tie_words, values_words
from via_gap.rendering.names import place_words, plain, site_words, where_words
from via_gap.rendering.numbers import chance, number, percent, prefix, prefixed, tick_words, ticks, with_sd
from via_gap.rendering.text import text
from via_gap.rendering.words import boxes, cautions, headline, next_steps, remainder
from via_gap.report.report import Combination, Value, Where

HEADLINES = {
    "effect": "Backlash in transmission 1 explains the gap: 97 % of the explainable error.",
    "tied": "One effect explains the gap (97 % of the explainable error), but this log cannot show which: "
    "Coulomb friction at motor 1 or viscous friction at motor 1.",
    "several_effects": "Backlash in transmission 1 and Coulomb friction at motor 1 together explain the gap: "
    "97 % of the explainable error.",
    "main_effect": "Torque ripple at motor 1 explains most of the gap: 84 % of the explainable error.",
    "no_gap": "No gap: with its parameters inside their tolerances, the model reproduces this log within sensor noise.",
    "unknown": "No effect of the catalogue accounts for the gap; the nearest, backlash in transmission 1, "
    "leaves 60 % of the squared error.",
    "cannot_tell": "The cause of the gap cannot be determined: 4 causes explain these data equally well.",
    "measurements": "Encoder quantisation in the link's encoder differs from the device file, as the measurements "
    "themselves show; the motion itself shows no gap.",
}


@pytest.mark.parametrize("kind", HEADLINES)
def test_the_verdict_in_one_sentence(kind):
    assert headline(report_of(kind)) == HEADLINES[kind]


def test_a_refused_log_says_why_and_what_to_do():
    report = report_of("refused")
    assert headline(report).endswith("neither commands nor torques.")
    assert next_steps(report) == ("Correct what the data check reports, then record again.",)


def test_a_main_effect_says_in_which_motion_it_fails():
    """The halves between which it transfers worst are named, by their own names where they have some."""
    report = report_of("main_effect")
    assert "Fitted to" not in remainder(report)
    slow = report.model_copy(update={"transfer": {"time": 0.1, "speed": 0.22, "load of spring 1": 0.2}})
    said = "and compared on {}, and the reverse, the repair leaves {} % of the squared error."
    assert f"Fitted to slow motion {said.format('fast motion', 22)}" in remainder(slow)
    sized = slow.model_copy(update={"halves": {"amplitude": (0.02, 0.031), "phase": (0.1, 0.2)}})
    assert "squared error; its amplitude is 0.02 N m in the first fit and 0.031 N m in the second." in remainder(sized)
    first, *others = sized.causes
    combined = Combination(expression="amplitude * phase", value=0.1, sd=0.01, unit="N m rad")
    only = sized.model_copy(update={"causes": (first.model_copy(update={"combinations": (combined,)}), *others)})
    assert only.causes[0].place == only.effects[0] and "leaves 22 % of the squared error." in remainder(only)
    loaded = report.model_copy(update={"transfer": {"load of spring 1": 0.25}})
    assert f"Fitted to small load of spring 1 {said.format('large load of spring 1', 25)}" in remainder(loaded)


def test_each_of_several_effects_says_what_the_repair_leaves_without_it():
    first = cause(BACKLASH, 0.9).model_copy(update={"without": 0.4})
    assert evidence(report_of("several_effects"), first).endswith("without this effect, 40 %.")


def test_a_long_reason_is_continued_below_the_headline():
    reason = "tau_1 is a function of the angle alone; it shows no friction. Record motion made by the drive."
    report = report_of("refused").model_copy(update={"reason": reason})
    assert headline(report) == "The cause of the gap cannot be determined: tau_1 is a function of the angle alone."
    assert cautions(report) == ("It shows no friction. Record motion made by the drive.",)


def test_a_tied_cause_beside_a_sensor_error_keeps_its_doubt():
    report = report_of("tied").model_copy(
        update={
            "verdict": "several_effects",
            "effects": (COULOMB, STEPS),
            "equivalence_set": (COULOMB, VISCOUS, STEPS),
        }
    )
    assert headline(report) == (
        "One effect explains the gap (97 % of the explainable error), but this log cannot show which: Coulomb friction "
        "at motor 1 or viscous friction at motor 1; in addition, encoder quantisation in the link's encoder differs "
        "from the device file, as the measurements themselves show."
    )
    assert any("may be the wrong one" in said for said in cautions(report))


def test_tied_causes_come_with_the_reason_and_a_motion_that_separates_them():
    report = report_of("tied")
    (said,) = tie_words(report)
    assert "Coulomb friction at motor 1 from viscous friction at motor 1" in said
    assert "several speeds" in said
    step = next_steps(report)[0]
    assert "8 s" in step and "12 times the noise" in step and "commands are in motion.csv" in step
    unwritten = report.proposal.model_copy(update={"file": "", "text": "run 'slow ladder' for 8 s"})
    step = next_steps(report.model_copy(update={"proposal": unwritten}))[0]
    assert step.startswith("Run 'slow ladder' for 8 s; via gap propose REPORT.json")
    no = report.proposal.model_copy(update={"text": "no motion separates stribeck friction", "separable": False})
    assert next_steps(report.model_copy(update={"proposal": no}))[0] == "No motion separates Stribeck friction."
    assert tie_words(report_of("effect")) == tie_words(report_of("unknown")) == ()


def test_a_main_effect_comes_with_what_is_left_and_where():
    report = report_of("main_effect")
    said = cautions(report)[0]
    assert said.startswith(
        "Another effect acts as well: an error of 6 % remains, where 1.5 % is achievable and sensor noise alone gives "
        "1 %."
    )
    assert "The remaining error of the" in said and "is largest at" in said
    assert any("remaining error" in step for step in next_steps(report))
    reached = report.gap.model_copy(update={"bound": report.gap.after})
    assert cautions(report.model_copy(update={"explained": 1.0}))[0].startswith("Another effect acts as well")
    done = report.model_copy(update={"explained": 1.0, "gap": reached})
    assert cautions(done)[0].startswith("An error of 6 % remains, where sensor noise alone gives 1 %.")
    assert any("twice" in step for step in next_steps(done))


@pytest.mark.parametrize("verdict", ["unknown", "cannot_tell"])
def test_without_a_named_cause_the_place_of_the_largest_error_is_stated(verdict):
    """A push that nobody recorded may be too short to be named, but the page shows when it was."""
    said = cautions(report_of("main_effect").model_copy(update={"verdict": verdict, "effects": ()}))
    assert sum("error of the" in each and "is largest at" in each for each in said) == 1
    assert not any("is largest at" in each for each in cautions(report_of("no_gap")))


def test_an_unknown_effect_is_looked_for_where_most_of_the_gap_lies():
    report = report_of("unknown")
    (step,) = next_steps(report)
    assert "outside the catalogue, first at transmission 1" in step
    assert "A flexible torque model reduces the error to 1.5 %" in cautions(report)[0]


def test_what_tied_pairs_have_in_common_is_not_said_to_be_in_doubt():
    """Nothing is named: two pairs tie, and only their second members replace one another."""
    report = report_of("cannot_tell")
    trials = (
        trial(COULOMB, BACKLASH, left=0.01, behind=0.0),
        trial(COULOMB, RIPPLE, left=0.01, behind=0.02),
        trial(COULOMB, left=0.5, behind=4.0),
        trial(BACKLASH, left=0.6, behind=4.5),
    )
    tied = report.model_copy(
        update={
            "causes": tuple(cause(*each) for each in ((COULOMB, 1.0), (BACKLASH, 0.5), (RIPPLE, 0.5))),
            "equivalence_set": (COULOMB, BACKLASH, RIPPLE),
            "effects": (),
            "figures": report_of("effect").figures.model_copy(update={"trials": trials}),
        }
    )
    (said,) = tie_words(tied)
    assert said.startswith("These data cannot separate backlash in transmission 1 from torque ripple at motor 1: their")
    assert "differ by 0.02" in said


def test_a_cause_that_ties_with_one_of_a_pair_is_stated_beside_that_one():
    report = report_of("several_effects")
    trials = (
        trial(BACKLASH, COULOMB, left=0.01, behind=0.0),
        trial(BACKLASH, VISCOUS, left=0.01, behind=0.02),
        trial(VISCOUS, left=0.5, behind=4.0),
    )
    changed = {"equivalence_set": (BACKLASH, COULOMB, VISCOUS)}
    tied = report.model_copy(update={**changed, "figures": report.figures.model_copy(update={"trials": trials})})
    (said,) = tie_words(tied)
    assert said.startswith(
        "These data cannot separate Coulomb friction at motor 1 from viscous friction at motor 1: their held-out "
        "scores differ by 0.02"
    )
    assert [each.what for each in rejected(tied)] == ["viscous friction at motor 1"]
    (held,) = (each for each in cautions(tied) if "wrong one" in each)
    assert held == "Of the tied causes, the repair contains Coulomb friction at motor 1: it may be the wrong one."
    assert next_steps(tied)[0] == (
        "Record a motion that separates the tied causes (several speeds), then diagnose again with both logs."
    )


def test_rejected_candidates_come_with_their_evaluation():
    first, second = rejected(report_of("effect"))
    assert (first.what, first.left, first.behind) == ("Coulomb friction at motor 1", "2 %", "0.02 ± 0.03")
    assert (second.what, second.left) == ("viscous friction at motor 1", "110 %")
    named = {each.what for each in rejected(report_of("tied"))}
    assert not named & {"Coulomb friction at motor 1", "viscous friction at motor 1"}


def test_a_member_of_a_pair_is_listed_alone():
    report = report_of("several_effects")
    third = place("payload", "link")
    figures = report.figures.model_copy(
        update={
            "trials": (
                trial(BACKLASH, COULOMB, left=0.01, behind=0.0),
                trial(BACKLASH, COULOMB, third, left=0.01, behind=0.0),
                trial(BACKLASH, left=0.3, behind=2.0),
            )
        }
    )
    more, alone = rejected(report.model_copy(update={"figures": figures}))
    assert more.what.endswith("and payload at the link")
    assert (alone.what, alone.left) == ("backlash in transmission 1 alone", "30 %")


def test_rejected_candidates_of_a_report_without_figures_are_its_causes():
    report = report_of("refused").model_copy(
        update={"verdict": "effect", "causes": (cause(BACKLASH, 0.9), cause(VISCOUS, 0.1, 0.8)), "effects": (BACKLASH,)}
    )
    (each,) = rejected(report)
    assert (each.what, each.left) == ("viscous friction at motor 1", "80 %")


def test_the_fraction_explained_is_shown_only_where_a_cause_is_named():
    shown = {kind: [what for what, _ in boxes(report_of(kind))] for kind in KINDS}
    named = ("effect", "tied", "several_effects", "main_effect")
    assert all(("explained" in shown[kind]) == (kind in named) for kind in KINDS)
    assert shown["cannot_tell"][1] == "gap, best of the tied causes"


def test_a_finding_of_several_logs_is_listed_once():
    report = report_of("effect")
    each = report.data_check[0]
    many = tuple(each.model_copy(update={"log": f"run {i}"}) for i in range(12))
    assert findings(report.model_copy(update={"data_check": many})) == (("note", "12 logs (run 0, ...)", each.text),)


@pytest.mark.parametrize("kind", KINDS)
def test_the_terminal_has_the_order_of_the_page(kind):
    report = report_of(kind)
    lines = text(report).splitlines()
    assert lines[0] == f"joint: {headline(report)}"
    kinds = [line.partition(":")[0].split(" ")[0] for line in lines]
    marks = [k for k in ("where", "1.", "gap", "next", "not") if k in kinds]
    assert [kinds.index(mark) for mark in marks] == sorted(kinds.index(mark) for mark in marks)


def test_the_catalogue_states_what_separates_two_effects():
    assert separation("viscous_friction", "coulomb_friction") == "several speeds"
    assert separation("backlash", "presliding_friction") != ""
    assert separation("payload", "encoder_offset") == ""


def test_names_of_effects_and_locations_are_words():
    assert site_words("sensor", 0) == "in the link's encoder"
    assert place_words(place("coulomb_friction", "motor")) == "Coulomb friction at both motors alike"
    assert place_words(place("backlash", "transmission")) == "backlash in both transmissions alike"
    assert where_words(Where(joint="a", site="motor", equation="link", share=1.0)) == "both motors"
    assert plain("what coulomb_friction at motor 1 would explain in run_1.csv") == (
        "what Coulomb friction at motor 1 would explain in run_1.csv"
    )


def test_a_periodic_effect_is_written_harmonic_by_harmonic():
    ripple = report_of("main_effect").causes[0]
    more = {f"{name}_2": value for name, value in ripple.parameters.items()}
    shown = values_words(ripple.model_copy(update={"parameters": {**ripple.parameters, **more}}))
    assert shown == 2 * ("order 7.00 ± 0.01: amplitude 0.030 ± 0.001 N m, phase 0.40 ± 0.01 rad",)


def test_well_known_combinations_are_beside_the_parameters():
    moment = Combination(expression="mass * distance", value=0.225, sd=0.013, unit="kg m")
    shown = values_words(cause(BACKLASH, 0.9).model_copy(update={"combinations": (moment,)}))
    assert shown == ("gap 0.0200 ± 0.0001 rad", "mass · distance 0.23 ± 0.01 kg m")


def test_what_only_combinations_determine_has_no_number():
    """Of a payload on a vertical axis the inertia alone is seen: five kilograms plus or minus ten tons are none."""
    mass, distance = (
        Value(value=value, sd=1e4, unit=unit, low=0.0, high=1e6, neutral=0.0)
        for value, unit in ((5.2, "kg"), (0.1, "m"))
    )
    moment = Combination(expression="mass * distance", value=0.5, sd=800.0, unit="kg m")
    inertia = Combination(expression="mass * distance^2", value=0.09, sd=0.01, unit="kg m^2")
    parts = {"parameters": {"mass": mass, "distance": distance}, "combinations": (moment, inertia)}
    shown = values_words(cause(BACKLASH, 0.9).model_copy(update=parts))
    assert shown == ("mass · distance² 0.09 ± 0.01 kg m²", "mass and distance not determined separately")
    alone = values_words(cause(BACKLASH, 0.9).model_copy(update={**parts, "combinations": ()}))
    assert "5 ± 10000 kg" in alone[0]  # nothing better is known


def test_numbers_have_no_exponents_and_few_digits():
    assert [number(v) for v in (0.0, 0.00123456, 12.345, 123456.0, -0.5)] == ["0", "0.00123", "12.3", "123456", "-0.5"]
    assert number(1.234e-7, 2) == "1.2 × 10⁻⁷"
    assert with_sd(0.029974, 8.1e-6, "N m") == "0.029974 ± 0.000008 N m"
    assert with_sd(12.34, 0.4, "rad") == "12.3 ± 0.4 rad"
    assert with_sd(0.05, 1e12, "N m") == "0.05 N m, not determined by these data"
    assert with_sd(1.02, 0.01, "-") == "1.02 ± 0.01"
    assert with_sd(0.5, 0.1, "N m s^2/rad^2") == "0.5 ± 0.1 N m s²/rad²"
    assert (prefixed(0.00012, "rad"), prefixed(0.0, "s"), prefixed(0.5, "-")) == ("0.12 mrad", "0 s", "0.5 -")
    assert prefix(0.012, "rad") == (1e3, "mrad") and prefix(0.012, "-") == (1.0, "-")


@given(st.floats(0.0, 0.999999))
def test_what_is_not_all_is_never_a_hundred_percent(share):
    assert not percent(share).startswith("100")
    assert not chance(share).startswith("100")


@given(st.floats(-1e5, 1e5), st.floats(1e-6, 1e5))
def test_ticks_are_round_and_inside(low, span):
    values = ticks(low, low + span)
    assert 2 <= len(values) <= 7
    assert all(low - 1e-6 * span <= v <= low + span + 1e-6 * span for v in values)
    assert len(set(tick_words(values))) == len(values)
