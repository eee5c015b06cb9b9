"""The task of a fleet's process: the diagnosis of one log, with a cache of compiled kernels of its own.

Workers that fill one numba cache at the same time can mix up the code of two signatures (numba issue 4807), so each
gets a copy. This module must not import compiled code: only the task does, once the copy exists.
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
    """The result of one log: a report (JSON), or the reason in one line why there is none."""

    report: str
    reason: str
    seconds: float  # duration
    process: int  # its id


class OwnKernels(WorkerPlugin):
    """Copies the cache of kernels into a worker's temporary folder, unless the worker has already loaded numba."""

    name = "via_gap kernels"

    def setup(self, worker: Any) -> None:
        if "numba" in sys.modules:
            return  # an external worker whose cache is already set
        own = Path(worker.local_directory) / "numba"
        shared = Path(os.environ.get(CACHE) or own)
        if shared != own and shared.is_dir():
            shutil.copytree(shared, own, ignore=shutil.ignore_patterns("*.tmp.*"), dirs_exist_ok=True)
        os.environ[CACHE] = str(own)


def diagnose_file(path: str, device: str, joint_topic: str) -> Outcome:
    """Diagnose the log at `path` against `device` (JSON). A faulty log is an outcome, not an error."""
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
