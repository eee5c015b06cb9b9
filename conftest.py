"""For all tests: the mark `slow`, the order of modules, and no time limit per hypothesis example.

tests/slow.txt lists the tests that `make test` leaves out; `make test-all` runs every test.

The first example of a test may compile a kernel, and the machine may be busy.
"""

from pathlib import Path

import pytest
from hypothesis import settings

SLOW = Path(__file__).resolve().parent / "tests" / "slow.txt"

settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")


@pytest.hookimpl(tryfirst=True)  # before pytest deselects by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests and modules of tests/slow.txt, and begin with their modules, so that no worker waits for one."""
    slow = {line for line in SLOW.read_text("utf-8").splitlines() if line and not line.startswith("#")}
    modules = {line.partition("::")[0] for line in slow}
    items.sort(key=lambda item: item.nodeid.partition("::")[0] not in modules)
    for item in items:
        test = item.nodeid.partition("[")[0]
        if test in slow or test.partition("::")[0] in slow:
            item.add_marker(pytest.mark.slow)
