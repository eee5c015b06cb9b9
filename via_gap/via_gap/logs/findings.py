"""Findings of the log checks, and types of the numbers in a report; Record is the base class of its parts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, get_args

from pydantic import Field
from via_core.records import Record as Record

Number = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Severity = Literal["refuse", "downgrade", "note"]  # worst first


class Finding(Record):
    """One result of the data check."""

    log: str
    check: str
    signal: str
    severity: Severity
    value: Number
    text: str


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Findings by severity; those of one severity in the given order."""
    return sorted(findings, key=lambda each: get_args(Severity).index(each.severity))
