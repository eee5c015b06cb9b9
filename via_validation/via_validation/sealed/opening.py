"""Open the keys, all or none, and evaluate every report."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from via_core.errors import ViaError

from via_validation.sealed.evaluation import Evaluation, Shrinkage, evaluate
from via_validation.sealed.measuring import shrinkage_of
from via_validation.sealed.running import RUNS
from via_validation.sealed.sealing import DEVICE, Sealed, names_in, opened


def evaluated_cases(
    cases: Path, keys: Path, results: Path, simulate: str, processes: int, progress: Callable[[str], None]
) -> list[Evaluation]:
    """Evaluations of all cases, in order. `simulate`: command that measures the decrease of the gap; '' for none.

    Raises SealError if any key differs from the sealed one; then no case is scored.
    """
    sealed = [opened(name, cases, keys) for name in names_in(cases)]
    runs_file = results / RUNS
    runs = json.loads(runs_file.read_text(encoding="utf-8")) if runs_file.exists() else []
    seconds = {each["name"]: each for each in runs}

    def one(each: Sealed) -> Evaluation:
        report, trouble = _report(results / f"{each.name}.json")
        run = seconds.get(each.name, {})
        if report is None and run.get("said"):
            trouble = run["said"]
        shrunk: Shrinkage | None = None
        effects = results / f"{each.name}.yaml"
        if report is not None and simulate and effects.exists():
            try:
                device = cases / each.name / DEVICE
                shrunk = shrinkage_of(each.withheld, device, effects, results / f"{each.name}.json", simulate)
            except ViaError as error:
                trouble = str(error)
        progress(each.name)
        try:
            return evaluate(each.name, each.key, report, shrunk, run.get("seconds"), trouble)
        except (KeyError, TypeError, ValueError) as error:
            return evaluate(each.name, each.key, None, None, run.get("seconds"), f"not a report: {error!r}")

    with ThreadPoolExecutor(processes) as pool:
        return list(pool.map(one, sealed))


def _report(file: Path) -> tuple[dict[str, Any] | None, str]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except OSError:
        return None, "no report"
    except ValueError as error:
        return None, f"not JSON: {error}"
    return (content, "") if isinstance(content, dict) else (None, "not a report")
