"""Decrease of the gap on the withheld log, measured by a command so that no code is shared with the simulator."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

from via_core.errors import ViaError

from via_validation.sealed.evaluation import Shrinkage
from via_validation.sealed.running import command_words


def shrinkage_of(
    log: Path, device: Path, effects: Path, report: Path, template: str, patience: float = 300.0
) -> Shrinkage:
    """Gap before and after the repair on a log. The command writes {json}: `before`, `after` and optionally `floor`.

    Raises ViaError if the command fails or writes something else. `patience`: time limit [s].
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "gap.json"
        words = command_words(
            template,
            log=log.resolve(),
            device=device.resolve(),
            effects=effects.resolve(),
            report=report.resolve(),
            json=out,
        )
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=patience, check=False)
            if done.returncode:
                raise ViaError(f"command '{words[0]}' ended with {done.returncode}: {done.stderr.strip()[-300:]}")
            gap = json.loads(out.read_text(encoding="utf-8"))
            gap = gap.get("gap", gap)
            floor = gap.get("floor")
            return Shrinkage(float(gap["before"]), float(gap["after"]), None if floor is None else float(floor))
        except subprocess.TimeoutExpired:
            raise ViaError(f"command '{words[0]}' took longer than {patience:g} s") from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ViaError(f"command '{words[0]}' wrote no gap: {error}") from None
