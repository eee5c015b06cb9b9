"""`via bench realtime`: short runs of the loop, and what its rows and page say about given ones."""

from __future__ import annotations

import time
from dataclasses import replace
from select import select

import pytest
from via_core.errors import ViaError
from via_validation.bench.realtime import page
from via_validation.bench.realtime import run as measuring
from via_validation.bench.realtime.loop import MESSAGES
from via_validation.bench.realtime.rows import RUNS, rows
from via_validation.bench.realtime.run import Loop, Worker, run
from via_validation.bench.scheduling import GRANTED
from via_validation.provenance import Provenance
from via_validation.tables.rows import Row

SECONDS = 1.0
LOOP = Loop(10.0, 10_000, 0.004, 10_000, 0, 0.2, 0.6, 3.0, 0.3, {"SCHED_FIFO": GRANTED, "affinity": "not granted: no"})
PLAIN = replace(LOOP, samples=4000, late=0.6, answered=3900, lost=50, processor=0.9)
LOOPS = {(way, processes): PLAIN if way == "plain" else LOOP for way, processes in RUNS}


def missed(loops):
    return {row.id.removeprefix("realtime.") for row in rows(loops) if row.ok is False}


@pytest.mark.parametrize("processes", [1, 4])
def test_every_sample_of_these_nodes_is_answered_and_estimated(processes):
    loop = run("suite", processes, SECONDS, lambda step, share: None)
    assert (loop.samples, loop.answered, loop.lost) == (1001, 1001, 0)
    assert 0.0 < loop.p50 <= loop.p99 <= loop.largest and loop.processor > 0.0
    assert loop.granted.keys() == {"SCHED_FIFO", "affinity", "memory locking"}


def test_the_plain_loop_runs_as_long_though_the_process_that_measures_looks_late(monkeypatch):
    def late(*arguments):
        time.sleep(4 * SECONDS)
        return select(*arguments)

    monkeypatch.setattr(measuring, "select", late)
    loop = run("plain", 1, SECONDS, lambda step, share: None)
    assert loop.seconds >= 0.9 * SECONDS
    assert 0 < loop.answered <= loop.samples <= 1001 and 0.0 <= loop.late < 1.0 and loop.lost >= 0


def test_a_process_that_ends_is_reported_instead_of_waited_for(domain):
    worker = Worker("suite", SECONDS, [0], ["nobody"], domain)
    with pytest.raises(ViaError, match="the process of nobody ended with code 1"):
        worker.until("begun", worker.check)


def test_rows_compare_with_the_limits():
    found = {row.id.removeprefix("realtime."): row for row in rows(LOOPS)}
    assert missed(LOOPS) == set()
    assert found["suite.1.cost"].ours == pytest.approx(1e6 * 3.0 / (MESSAGES * 10_000))
    assert found["cost"].ours == pytest.approx((3.0 / 10_000) / (9.0 / 4000))
    assert found["plain.1.unanswered"].ours == 100.0
    worse = replace(LOOP, late=0.03, p99=1.2, answered=9999, lost=1, processor=0.8)
    assert missed({**LOOPS, ("suite", 1): worse}) == {
        "suite.1.late", "suite.1.p99", "suite.1.unanswered", "suite.1.lost", "cost",
    }  # fmt: skip
    assert missed({**LOOPS, ("suite", 4): worse}) == {"suite.4.unanswered", "suite.4.lost"}


def test_the_page_has_every_run_and_says_what_is_missed_and_granted(tmp_path):
    loops = {**LOOPS, ("suite", 1): replace(LOOP, late=0.03)}
    node = Row("node.lost", "lost estimates", "count", None, 0.0, 0.0, "16 joints")
    page.write(loops, [*rows(loops), node], Provenance("abc", "via bench", "3.11", "2", "0.6"), tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text("utf-8")
    assert "**Missed: these nodes, one process: ticks late or left out [%].**" in text
    assert "| ticks late or left out [%] | 3 | 60 | 0.4 | 60 |" in text
    assert "- SCHED_FIFO: granted\n- affinity: not granted: no\n" in text
    assert "- rclcpp: not measured, " in text
