"""Provenance of results: commit, command and versions. No dates, so that a repeated run changes nothing."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from importlib.metadata import version

from via_bringup.commit import commit


@dataclass(frozen=True)
class Provenance:
    """What is needed to reproduce results."""

    commit: str  # as in `via_bringup.commit`
    command: str
    python: str
    numpy: str
    numba: str

    def __str__(self) -> str:
        return f"commit {self.commit}, Python {self.python}, numpy {self.numpy}, numba {self.numba}: {self.command}"


def provenance(command: str) -> Provenance:
    """Provenance of the results of `command`, run now with the current sources."""
    return Provenance(commit(), command, platform.python_version(), version("numpy"), version("numba"))
