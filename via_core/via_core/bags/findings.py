"""What checks of bags and recordings report: one sentence each, with the number and the limit it was held against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One observation.

    severity  'note': good to know; 'warning': part of the data is not to be trusted; 'error': none of it is
    check     short name of the check, e.g. 'servo_response'
    subject   topic or column it is about
    text      one sentence with units
    value     the number found; `limit` the one it must not exceed, None where there is none
    """

    severity: Literal["note", "warning", "error"]
    check: str
    subject: str
    text: str
    value: float
    limit: float | None = None

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text}"
