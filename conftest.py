"""For all tests: the mark `slow`, one numba cache per worker, and no time limit per hypothesis example.

tests/slow.txt lists the tests that `make test` leaves out; `make test-all` runs every test.

Workers that fill numba's cache at the same time can give one signature the code of another (numba issue 4807): a crash.
The first example of a test may compile a kernel, and the machine may be busy.
"""

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import settings

SLOW = Path(__file__).resolve().parent / "tests" / "slow.txt"

if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    common = Path(os.environ.get("NUMBA_CACHE_DIR", ".numba_cache"))
    own = common / worker
    if (common / ".via-kernels").exists() and not own.exists():  # what `make setup` compiled serves every worker
        shutil.copytree(common, own, ignore=shutil.ignore_patterns("gw*"))
    os.environ["NUMBA_CACHE_DIR"] = str(own)

settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")


@pytest.hookimpl(tryfirst=True)  # before pytest deselects by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests and modules of tests/slow.txt."""
    slow = {line for line in SLOW.read_text("utf-8").splitlines() if line and not line.startswith("#")}
    for item in items:
        test = item.nodeid.partition("[")[0]
        if test in slow or test.partition("::")[0] in slow:
            item.add_marker(pytest.mark.slow)
