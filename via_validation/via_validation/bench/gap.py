"""The same parameter fit by three programs, and the cost of a diagnosis for a log ten times as long, in one run.

The fit finds dry friction, viscous friction and inertia of the motor of a flexible joint from one log of 40 s at 1 kHz,
with the same bounds and start values. Contenders:

    via_gap       its Gauss-Newton on whitened segments, `candidates.refinement.refine`
    scipy         least_squares (trust region, 2-point differences) on the same segments, simulator and whitening
    mujoco.sysid  as in its documentation: one parameter per modifier of the spec, one sequence, default residual,
                  optimiser and threads; the joint in MuJoCo with implicitfast at 1 ms

mujoco.sysid simulates the whole log from rest in one sequence. That suits this joint, since gravity and friction keep a
free simulation near the log, and the program, since it simulates every sequence in a separate call: segments would take
several times longer. The time to cut a log into segments counts for the contenders that cut it. The log comes from
via_sim, whose dry friction sticks. MuJoCo's default dry friction is a soft constraint, which causes most of its
parameter error (with a stiff constraint the inertia is correct). Two logs of 400 and 40 s (the beginning of the longer
one) are then diagnosed completely.

Processor times include all threads of the process and depend little on other processes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time

import numpy as np
from via_bringup.cli.console import answers, print_table
from via_core.signals import Array
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog

from via_validation.bench.gap_contenders import (
    CONTENDERS,
    NAMES,
    RATE,
    TRUE,
    beginning,
    log_of,
    totals,
)
from via_validation.bench.timing import keep

SHORT, LONG = 40.0, 400.0  # [s]
FIRST = 6.0  # [s] of the log for a first run that is not timed, in which code is compiled and loaded
TURNS = 3


@dataclass(frozen=True)
class Result:
    """Result and time of one contender.

    found      (3,) in the order of NAMES
    wall       [s] wall time, minimum over the turns
    processor  [s] processor time, minimum over the turns
    ratio      processor time over that of via_gap, median over the turns
    """

    found: Array
    wall: float
    processor: float
    ratio: float


def fitted(log: JointLog, turns: int = TURNS) -> dict[str, Result]:
    """Results of all contenders on a log, which alternate after a first round on its beginning that compiles."""
    found: dict[str, Array] = {}
    walls: dict[str, list[float]] = {name: [] for name in CONTENDERS}
    processors: dict[str, list[float]] = {name: [] for name in CONTENDERS}
    for turn in range(turns + 1):
        for name, work in CONTENDERS.items():
            wall, processor = perf_counter(), process_time()
            found[name] = work(log if turn else beginning(log, FIRST))
            if turn:
                walls[name].append(perf_counter() - wall)
                processors[name].append(process_time() - processor)
    own = processors["via_gap"]
    return {
        name: Result(
            found[name], min(walls[name]), min(processors[name]),
            median(a / b for a, b in zip(processors[name], own, strict=True)),
        )
        for name in CONTENDERS
    }  # fmt: skip


@dataclass(frozen=True)
class Cost:
    """Cost of a whole diagnosis."""

    wall: float  # [s]
    processor: float  # [s]
    verdict: str


def diagnosed(log: JointLog) -> Cost:
    """Cost of a diagnosis with the whole catalogue."""
    wall, processor = perf_counter(), process_time()
    report = diagnose([log], log.device)
    return Cost(perf_counter() - wall, process_time() - processor, report.verdict)


def main(turns: int = TURNS) -> None:
    long = log_of(LONG)
    short = beginning(long, SHORT)
    results, true = fitted(short, turns), totals(TRUE)
    cells = (
        (
            *(name, f"{each.wall:.3f}", f"{each.processor:.3f}", f"{each.ratio:.1f}"),
            ", ".join(f"{v:.5f}" for v in each.found),
            ", ".join(f"{100.0 * e:.2f}" for e in np.abs(each.found / true - 1.0)),
        )
        for name, each in results.items()
    )
    print_table(
        f"{', '.join(NAMES)} from {SHORT:g} s at {RATE:g} Hz; true: {', '.join(f'{value:g}' for value in true)}",
        ("fit by", "wall [s]", "processor [s]", "x via_gap", "found", "error [%]"), cells,
    )  # fmt: skip
    if "mujoco.sysid" not in results:
        answers.print("mujoco.sysid cannot be loaded: one of its dependencies is not installed")
    answers.print(f"{os.cpu_count()} cores; diagnosis with the whole catalogue:")
    diagnosed(beginning(short, FIRST))
    costs = {log.name: diagnosed(log) for log in (short, long)}
    for name, cost in costs.items():
        answers.print(f"  log of {name}: {cost.wall:.1f} s, processor {cost.processor:.1f} s, verdict {cost.verdict}")
    first, second = costs[short.name], costs[long.name]
    walls, processors = second.wall / first.wall, second.processor / first.processor
    answers.print(
        f"  {LONG / SHORT:g} times the log takes {walls:.1f} times the wall and {processors:.1f} times the CPU time"
    )
    content = {
        "cores": os.cpu_count(),
        "true": list(true),
        "fit": {name: vars(each) | {"found": list(each.found)} for name, each in results.items()},
        "diagnosis": {name: vars(cost) for name, cost in costs.items()},
    }
    keep("gap", content)
