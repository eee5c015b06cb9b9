"""Results of the checks of bags and recordings: one sentence each, with a number and its limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One observation.

    severity  'note': information; 'warning': part of the data is unreliable; 'error': all of it is
    check     short name of the check, e.g. 'servo_response'
    subject   topic or column
    text      one sentence with units
    value     the number found
    limit     its largest valid value, None without limit
    """

    severity: Literal["note", "warning", "error"]
    check: str
    subject: str
    text: str
    value: float
    limit: float | None = None

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text}"
