"""A short benchmark of the estimator node over DDS: every estimate is counted."""

from __future__ import annotations

import subprocess

import pytest
from via_core.errors import ViaError
from via_validation.bench import node


def test_every_estimate_of_a_second_arrives():
    rows = {row.id: row for row in node.node_rows(1.0, 2, "qbmove_b", separate=True)}
    assert rows["node.expected"].ours == 4000.0
    assert (rows["node.lost"].ours, rows["node.out_of_order"].ours) == (0.0, 0.0)
    assert 0.0 < rows["node.latency.p50"].ours <= rows["node.latency.worst"].ours
    assert rows["node.cpu.node"].settings == "2 x qbmove_b, 1000 Hz, 1 s, one JointState per joint"


@pytest.mark.parametrize(
    ("ends", "message"), [("node", "the node ended with code 1"), ("listener", "the listener ended")]
)
def test_a_process_that_ends_is_reported_instead_of_waited_for(ends, message):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes = {name: subprocess.Popen("false" if name == ends else "cat", **pipes) for name in ("node", "listener")}
    with pytest.raises(ViaError, match=message):
        node.Peers(**processes).line(lambda: None)
    for process in processes.values():
        process.communicate()


def test_missing_and_unordered_estimates_are_counted():
    sent = {"steps": 100.0, "node": 0.5, "robot": 0.1, "late ticks": 3.0}
    heard = {"counts": {"/a": 98, "/b": 100}, "wrong": ["/a: 5 after 2"], "latency": [1.0, 2.0, 3.0, 4.0]}
    rows = {row.id: row for row in node._rows(sent, heard, "s", 2)}
    assert (rows["node.lost"].ours, rows["node.lost"].ok) == (2.0, False)
    assert (rows["node.out_of_order"].ours, rows["node.out_of_order"].ok) == (1.0, False)
    assert (rows["node.cpu.node"].ours, rows["node.cpu.node"].ok) == (50.0, True)
    assert rows["node.latency.worst"].ours == 4.0
