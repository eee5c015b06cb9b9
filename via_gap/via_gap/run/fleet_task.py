"""The task of a fleet's process: the diagnosis of one log, with a cache of compiled kernels of its own.

Workers that fill one numba cache at the same time can mix up the code of two signatures (numba issue 4807), so each
gets a copy. This module must not import compiled code: only the task does, once the copy exists.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from distributed import WorkerPlugin

if TYPE_CHECKING:
    from via_gap.run.worker import Failed, Finished

CACHE = "NUMBA_CACHE_DIR"


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


def diagnose_file(path: str, device: str, own_effects: tuple[str, ...] = ()) -> tuple[Finished | Failed, float]:
    """Diagnose the log at `path` against `device` (JSON): the outcome, and how long it took [s].

    own_effects  modules and files that add effects to the catalogue
    """
    from via_core.devices import Device

    from via_gap.run.worker import Job, diagnosed

    begin = time.perf_counter()
    outcome = diagnosed(Job(Device.model_validate_json(device), Path(path), own_effects=own_effects))
    return outcome, time.perf_counter() - begin
