"""For all tests: one numba cache per worker, and no time limit per hypothesis example.

Workers that fill numba's cache at the same time can give one signature the code of another (numba issue 4807): a crash.
The first example of a test may compile a kernel, and the machine may be busy.
"""

import os
import shutil
from pathlib import Path

from hypothesis import settings

if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    common = Path(os.environ.get("NUMBA_CACHE_DIR", ".numba_cache"))
    own = common / worker
    if (common / ".via-kernels").exists() and not own.exists():  # what `make setup` compiled serves every worker
        shutil.copytree(common, own, ignore=shutil.ignore_patterns("gw*"))
    os.environ["NUMBA_CACHE_DIR"] = str(own)

settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")
