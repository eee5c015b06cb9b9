"""Results of independent parts of an experiment from two processes, and the number of seeds that a budget allows."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from via_core.errors import ViaError

from via_validation.side_by_side import Send, side_by_side

Part = TypeVar("Part")
Result = TypeVar("Result")
Report = Callable[[str], None]
Progress = Callable[[int, int, str], None]  # reports received, reports expected, description
STEPS = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 500, 1000)  # numbers of seeds, so that few depend on the machine


def results_of(
    work: Callable[[Part, Report], Result], parts: Sequence[Part], reports: int, progress: Progress
) -> list[Result]:
    """work(part, report) of every part, in the order of the parts; `reports` is the expected number of reports.

    Raises ViaError for a part without a result, and KeyboardInterrupt where an interrupt ended the run.
    """
    found: dict[int, Result] = {}
    failed: list[str] = []
    done = 0

    def receive(number: int, sent: tuple[str, Any]) -> None:
        nonlocal done
        kind, content = sent
        if kind == "report":
            progress(done, reports, content)
            done += 1
        elif kind == "result":
            found[number] = content
        else:
            failed.append(content)

    progress(0, reports, "starting")
    jobs = [(_work, (work, part)) for part in parts]
    if not side_by_side(jobs, receive, lambda _: None, lambda _: None):
        raise KeyboardInterrupt
    if failed or len(found) < len(parts):
        raise ViaError(failed[0] if failed else "a process ended without a result")
    progress(reports, reports, "done")
    return [found[number] for number in range(len(parts))]


def _work(work: Callable[[Any, Report], Any], part: Any, send: Send) -> None:
    try:
        send(("result", work(part, lambda words: send(("report", words)))))
    except Exception as error:  # any error of a part is reported by the parent
        send(("failed", f"{type(error).__name__}: {error}"))


def within_budget(run: Callable[[int], Result], seeds: int, budget: float, least: int = 1) -> list[Result]:
    """run(0), run(1), ...: `seeds` of them, or as many as fit into `budget` [s] of processor time, at least `least`.

    The time of the first run decides, rounded down to one of STEPS.
    """
    begin = time.process_time()
    first = run(0)
    taken = max(time.process_time() - begin, 1e-9)
    allowed = max((step for step in STEPS if step * taken <= budget), default=1)
    return [first, *(run(seed) for seed in range(1, min(seeds, max(allowed, least))))]
