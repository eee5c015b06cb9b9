"""Rows of the runs: this project's nodes beside plain ones, in one process and in four, and many joints in one node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from via_validation.bench.node import Show, node_rows
from via_validation.bench.realtime.loop import DEVICE, RATE
from via_validation.bench.realtime.run import Loop, run
from via_validation.tables.rows import Row

RUNS = (("suite", 1), ("plain", 1), ("suite", 4), ("plain", 4))  # way and number of processes
WAYS = {"suite": "these nodes", "plain": "plain rclpy"}
PROCESSES = {1: "one process", 4: "four processes"}
LATE = {1: 1.0, 4: 5.0}  # [%] of the ticks, by processes
ROUND_TRIP = 1.0  # [ms] that 99 % do not exceed, in one process
COST = 1.0 / 3.0  # of the processor time of the plain way, in one process
JOINTS = 16  # of two transmissions, in one estimator node

Loops = Mapping[tuple[str, int], Loop]


def measured(seconds: float, show: Show) -> tuple[Loops, list[Row]]:
    """All loops, and the rows of the estimator node with many joints, each for `seconds`."""
    loops = {}
    for way, processes in RUNS:
        title = f"{WAYS[way]}, {PROCESSES[processes]}"
        show(f"{title}: starting", float("nan"))
        loops[way, processes] = run(way, processes, seconds, partial(_within, show, title))
    return loops, node_rows(seconds, JOINTS, DEVICE, False, show)


def _within(show: Show, title: str, step: str, share: float) -> None:
    show(f"{title}: {step}", share)


def rows(loops: Loops) -> Iterator[Row]:
    """Rows of all loops."""
    for (way, processes), loop in loops.items():
        yield from _rows(way, processes, loop)
    ratio = loops["suite", 1].cost / loops["plain", 1].cost
    what = f"{WAYS['suite']} over {WAYS['plain']}, {PROCESSES[1]}"
    yield Row("realtime.cost", what, "processor time per message [-]", None, ratio, COST, _settings(loops["suite", 1]))


def _settings(loop: Loop) -> str:
    return f"{DEVICE}, {RATE:g} Hz, {loop.seconds:.0f} s"


def _rows(way: str, processes: int, loop: Loop) -> Iterator[Row]:
    own, one = way == "suite", processes == 1

    def row(name: str, quantity: str, ours: float, limit: float | None = None) -> Row:
        identity = f"realtime.{way}.{processes}.{name}"
        return Row(identity, f"{WAYS[way]}, {PROCESSES[processes]}", quantity, None, ours, limit, _settings(loop))

    yield row("samples", "samples published", loop.samples)
    yield row("late", "ticks late or left out [%]", 100.0 * loop.late, LATE[processes] if own else None)
    yield row("p50", "round trip, median [ms]", loop.p50)
    yield row("p99", "round trip, 99 % [ms]", loop.p99, ROUND_TRIP if own and one else None)
    yield row("largest", "round trip, largest [ms]", loop.largest)
    yield row("unanswered", "samples without a command", loop.samples - loop.answered, 0.0 if own else None)
    yield row("lost", "samples lost by the estimators", loop.lost, 0.0 if own else None)
    yield row("cpu", "processor time, share of a core [%]", 100.0 * loop.processor)
    yield row("cost", "processor time per message [us]", loop.cost)
