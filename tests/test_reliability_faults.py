"""Faults injected into the live graph: those that take a few seconds; `via reliability` injects all."""

import pytest
from via_validation.provenance import provenance
from via_validation.reliability import page, run
from via_validation.reliability.fault import Fault, Outcome, expect
from via_validation.reliability.run import Name, groups, outcomes, run_one

QUICK = [(group, fault) for group, faults in groups().items() for fault in faults if fault.quick]


@pytest.mark.parametrize(("group", "fault"), QUICK, ids=[fault.injected for _, fault in QUICK])
def test_a_fault_does_what_it_must(group, fault):
    outcome = run_one(group, fault)
    assert outcome.met, outcome.seen


def test_every_fault_has_a_name_of_its_own():
    names = [(group, fault.injected) for group, faults in groups().items() for fault in faults]
    assert len(set(names)) == len(names) >= 60


def test_a_requirement_that_is_missed_and_an_error_of_a_node_are_outcomes():
    missed = run_one("a", Fault("x", "y", lambda _: str(expect(False, "nothing of it"))))
    assert (missed.met, missed.seen) == (False, "nothing of it")
    failed = run_one("a", Fault("x", "y", lambda _: str(1 / 0)))
    assert (failed.met, failed.seen) == (False, "ZeroDivisionError: division by zero")


def test_a_crash_is_an_outcome_and_the_next_fault_runs(monkeypatch):
    name = Name("Samples of an estimator", "nothing: sound samples")
    monkeypatch.setattr(run, "_work", _crash_once)
    found = list(outcomes([name, name], limit=60.0))
    assert [each.seen for each in found] == ["the process of the graph crashed"] * 2


def _crash_once(end):
    end.recv()


def test_the_page_has_groups_misses_and_what_is_left(tmp_path):
    met, missed = Outcome("A", "x", "a | b", "fine", True, 1.0), Outcome("B", "y", "c", "bad", False, 1.0)
    page.write([met, missed], [Name("B", "z")], provenance("via reliability"), tmp_path / "reliability.md")
    text = (tmp_path / "reliability.md").read_text("utf-8")
    assert "**1 of 2 faults do what they must.**" in text and "| x | a \\| b | fine |" in text
    assert "| y | c | **missed:** bad |" in text and "Missed: B: y." in text and "Not injected: B: z." in text
