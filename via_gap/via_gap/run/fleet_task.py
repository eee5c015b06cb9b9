"""What a process of a fleet does: one log diagnosed, with compiled kernels of its own.

Workers that fill one cache of numba at the same time can give one signature the code of another (numba issue 4807), so
each gets a copy. For that this module must not import what is compiled: only a task does, when the copy is there.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin

CACHE = "NUMBA_CACHE_DIR"


@dataclass(frozen=True)
class Outcome:
    """What became of one log: a report (JSON), or else the reason why there is none, in one line."""

    report: str
    reason: str
    seconds: float  # it took
    process: int  # id of the one that did it


class OwnKernels(WorkerPlugin):
    """Gives a worker that has compiled nothing yet a copy of the cache of kernels, in its temporary folder."""

    name = "via_gap kernels"

    def setup(self, worker: Any) -> None:
        if "numba" in sys.modules:
            return  # somebody else's worker, with a cache already chosen
        own = Path(worker.local_directory) / "numba"
        shared = Path(os.environ.get(CACHE) or own)
        if shared != own and shared.is_dir():
            shutil.copytree(shared, own, ignore=shutil.ignore_patterns("*.tmp.*"), dirs_exist_ok=True)
        os.environ[CACHE] = str(own)


def diagnose_file(path: str, device: str, joint_topic: str) -> Outcome:
    """Diagnose the log at `path` against `device` (JSON). What is wrong with the log is an outcome, not an error."""
    from via_core.devices import Device
    from via_core.errors import ViaError

    from via_gap.design.proposal import with_proposal
    from via_gap.diagnose import diagnose
    from via_gap.logs.log import read_log

    begin = time.perf_counter()
    described = Device.model_validate_json(device)
    report = reason = ""
    try:
        found = diagnose([read_log(path, described, joint_topic)], described)
        report = with_proposal(found, described).to_json()
    except (ViaError, OSError) as error:
        reason = " ".join(str(error).split())
    return Outcome(report, reason, time.perf_counter() - begin, os.getpid())
