"""A fault, its outcome, and how a check reports a miss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from via_core.errors import ViaError

from via_validation.reliability.graph import Graph


class MissedError(ViaError):
    """What was seen in place of what must happen."""


@dataclass(frozen=True)
class Fault:
    """A fault and its requirement.

    injected  what is injected
    must      what must happen
    check     injects the fault into a new graph and returns what was seen; raises `MissedError` with what was seen
              if the requirement is missed
    quick     whether it runs in the tests: takes a few seconds and does not depend on the machine's speed
    """

    injected: str
    must: str
    check: Callable[[Graph], str]
    quick: bool = True


@dataclass(frozen=True)
class Outcome:
    """What a fault did."""

    group: str
    injected: str
    must: str
    seen: str
    met: bool
    seconds: float  # wall time


def expect(condition: bool, seen: str) -> None:
    """Raise `MissedError` with what was seen unless the condition holds."""
    if not condition:
        raise MissedError(seen)
