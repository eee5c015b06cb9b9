"""Numbers and sentences of a report: nothing rounds to certainty, and every verdict says what was found and no more."""

import pytest
from gap_reports import BACKLASH, COULOMB, STEPS, VERDICTS, VISCOUS, cause, place, report_of, trial
from hypothesis import given
from hypothesis import strategies as st
from via_gap.rendering.numbers import chance, number, percent, prefix, tick_words, ticks, with_sd
from via_gap.rendering.text import text
from via_gap.rendering.words import (
    boxes,
    cautions,
    equivalence_words,
    findings,
    headline,
    next_steps,
    ruled_out,
    site_words,
    told_apart,
)

HEADLINES = {
    "effect": "Backlash in transmission 1 explains the gap: it closes 97 % of what can be closed.",
    "tied": "One effect explains the gap, but this log cannot tell which: "
    "Coulomb friction at motor 1 or viscous friction at motor 1.",
    "two_effects": "Backlash in transmission 1 and Coulomb friction at motor 1 together explain the gap: "
    "they close 97 % of what can be closed.",
    "no_gap": "No effect is missing: with its own numbers moved inside their tolerance, the model explains this log "
    "down to its sensors.",
    "unknown": "None of the known effects explains the gap: the best, backlash in transmission 1, "
    "leaves 60 % of the squared error.",
    "cannot_tell": "This log cannot tell what causes the gap: 3 causes fit it equally well.",
    "readings": "Encoder quantisation in the link's encoder differs from the device file, as the readings show; "
    "the motion itself shows no gap.",
}


@pytest.mark.parametrize("verdict", HEADLINES)
def test_the_verdict_in_one_sentence(verdict):
    assert headline(report_of(verdict)) == HEADLINES[verdict]


def test_a_refused_log_says_why_and_what_to_do():
    report = report_of("refused")
    assert "neither commands nor torques" in headline(report)
    assert next_steps(report) == ("Mend what the data check refuses, then record again.",)


def test_a_cause_beside_a_reading_keeps_its_doubt():
    report = report_of("tied").model_copy(
        update={
            "verdict": "two_effects",
            "effects": (COULOMB, STEPS),
            "equivalence_set": (COULOMB, VISCOUS, STEPS),
        }
    )
    assert headline(report) == (
        "One effect explains the gap, but this log cannot tell which: Coulomb friction at motor 1 or viscous friction "
        "at motor 1; besides, encoder quantisation in the link's encoder differs from the device file, as the readings "
        "show."
    )
    assert any("may be the wrong one" in said for said in cautions(report))


def test_tied_causes_come_with_why_and_with_what_to_ask_for():
    report = report_of("tied")
    (said,) = equivalence_words(report)
    assert "Coulomb friction at motor 1 from viscous friction at motor 1" in said
    assert "a ladder of speeds" in said
    (step,) = next_steps(report)
    assert "8 s" in step and "12 times the noise" in step and "commands are in motion.csv" in step
    told = report.proposal.model_copy(update={"file": "", "text": "run 'slow ladder' for 8 s"})
    (step,) = next_steps(report.model_copy(update={"proposal": told}))
    assert step.startswith("Run 'slow ladder' for 8 s; via gap propose REPORT.json")
    assert equivalence_words(report_of("effect")) == equivalence_words(report_of("unknown")) == ()


@pytest.mark.parametrize(
    ("by", "ceiling", "told"), [("shots", 0.015, True), ("shots", 0.019, False), ("free run", 0.015, False)]
)
def test_what_a_flexible_model_would_close_beside_an_answer_that_is_none_is_said(by, ceiling, told):
    report = report_of("unknown")
    gap = report_of("effect").gap.model_copy(update={"by": by, "after": 0.02, "ceiling": ceiling})
    said = cautions(report.model_copy(update={"effects": (BACKLASH,), "gap": gap}))
    assert ("Of the 2 % that stay a flexible model beside it leaves 1.5 %." in said) == told


def test_what_ties_with_a_pair_is_said_of_the_cause_it_may_stand_for():
    report = report_of("two_effects")
    trials = (
        trial(BACKLASH, COULOMB, left=0.01, behind=0.0),
        trial(BACKLASH, VISCOUS, left=0.01, behind=0.02),
        trial(VISCOUS, left=0.5, behind=4.0),
    )
    told = {"equivalence_set": (BACKLASH, COULOMB, VISCOUS)}
    tied = report.model_copy(update={**told, "figures": report.figures.model_copy(update={"trials": trials})})
    (said,) = equivalence_words(tied)
    assert said.startswith(
        "This log cannot separate Coulomb friction at motor 1 from viscous friction at motor 1: on held-out data their "
        "scores differ by 0.02"
    )
    assert [each.what for each in ruled_out(tied)] == ["viscous friction at motor 1"]
    (held,) = (each for each in cautions(tied) if "wrong one" in each)
    assert held == "The repair holds Coulomb friction at motor 1, the best of the tied causes: it may be the wrong one."
    assert next_steps(tied) == (
        "Record a motion that separates the tied causes: a ladder of speeds; then diagnose again with both logs.",
    )


def test_what_was_ruled_out_is_told_from_what_is_only_less_likely():
    report = report_of("effect")
    told = {each.what: each for each in ruled_out(report)}
    assert told.keys() == {"Coulomb friction at motor 1", "viscous friction at motor 1"}
    assert not told["Coulomb friction at motor 1"].decided
    assert told["viscous friction at motor 1"].decided
    assert told["viscous friction at motor 1"].why.startswith("does not help")
    named = {each.what for each in ruled_out(report_of("tied"))}
    assert not named & {"Coulomb friction at motor 1", "viscous friction at motor 1"}


def test_members_of_a_pair_are_shown_alone_and_a_needless_third_is_said_to_be_one():
    report = report_of("two_effects")
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
    more, alone = ruled_out(report.model_copy(update={"figures": figures}))
    assert more.why.startswith("the added effect closes too little")
    assert (alone.what, alone.why[:24]) == ("backlash in transmission 1", "alone leaves 30 % of the")


def test_no_gap_of_a_file_that_is_off_says_so():
    report = report_of("no_gap")
    assert report.gap.before > 2.0 * report.gap.after
    assert any("not those filed" in said for said in cautions(report))
    right = report.model_copy(update={"gap": report.gap.model_copy(update={"before": report.gap.after})})
    assert headline(right).startswith("No gap: ")
    assert cautions(right) == cautions(report)[1:]


def test_what_is_closed_is_shown_only_where_a_cause_is_named():
    shown = {verdict: [what for what, _ in boxes(report_of(verdict))] for verdict in VERDICTS}
    assert all(("closed of what can be" in shown[v]) == (v in ("effect", "tied", "two_effects")) for v in VERDICTS)
    assert shown["cannot_tell"][1] == "gap, best attempt"


def test_what_several_logs_share_is_told_once():
    report = report_of("effect")
    each = report.data_check[0]
    many = tuple(each.model_copy(update={"log": f"run {i}"}) for i in range(12))
    assert findings(report.model_copy(update={"data_check": many})) == (("note", "12 logs, run 0 first", each.text),)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_terminal_tells_the_same_in_the_same_order(verdict):
    report = report_of(verdict)
    lines = text(report).splitlines()
    assert lines[0] == f"joint: {headline(report)}"
    kinds = [line.partition(":")[0].split(" ")[0] for line in lines]
    marks = [k for k in ("where", "1.", "gap", "next", "not") if k in kinds]
    assert [kinds.index(mark) for mark in marks] == sorted(kinds.index(mark) for mark in marks)


def test_the_catalogue_says_what_separates_two_effects():
    assert told_apart("viscous_friction", "coulomb_friction") == "a ladder of speeds"
    assert told_apart("backlash", "presliding_friction") != ""
    assert told_apart("payload", "encoder_offset") == ""
    assert site_words("sensor", 0) == "in the link's encoder"


def test_numbers_have_no_exponents_and_few_digits():
    assert [number(v) for v in (0.0, 0.00123456, 12.345, 123456.0, -0.5)] == ["0", "0.00123", "12.3", "123456", "-0.5"]
    assert number(1.234e-7, 2) == "1.2 × 10⁻⁷"
    assert with_sd(0.029974, 8.1e-6, "N m") == "0.029974 ± 0.000008 N m"
    assert with_sd(12.34, 0.4, "rad") == "12.3 ± 0.4 rad"
    assert with_sd(0.05, 1e12, "N m") == "0.05 N m, not determined by this log"
    assert with_sd(1.02, 0.01, "-") == "1.02 ± 0.01"
    assert with_sd(0.5, 0.1, "N m s^2/rad^2") == "0.5 ± 0.1 N m s²/rad²"
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


def test_a_cause_that_is_not_in_the_figures_is_still_ruled_out():
    report = report_of("refused").model_copy(
        update={"verdict": "effect", "causes": (cause(BACKLASH, 0.9), cause(VISCOUS, 0.1, 0.8)), "effects": (BACKLASH,)}
    )
    (each,) = ruled_out(report)
    assert (each.what, each.why) == ("viscous friction at motor 1", "leaves 80 % of the squared error")
