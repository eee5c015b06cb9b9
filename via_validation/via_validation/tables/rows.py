"""One row of a table: printed number, our number, limit and settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[int, int, str], None]  # done, of how many, description


@dataclass(frozen=True)
class Row:
    """A number of the document and ours.

    id        unique, dotted, starts with the section: '3.table2.n2.torque_noise.mse'
    what      description of the case, e.g. 'N = 2, noise on torques, full window'
    quantity  name and unit of the number: 'MSE [(N m/rad)^2]'
    document  the printed number; None if the document has none
    ours      the number of this run; None if it cannot be reproduced
    limit     required: ours <= limit; None for rows without a limit
    settings  plant, excitation, noise, parameters: sufficient to repeat the run
    seeds     number of averaged noise realisations; 0 for noise-free cases
    remark    why it differs or cannot be reproduced; may be empty
    """

    id: str
    what: str
    quantity: str
    document: float | None
    ours: float | None
    limit: float | None
    settings: str
    seeds: int = 0
    remark: str = ""

    @property
    def ok(self) -> bool | None:
        """Whether the limit is kept; None for a row without a limit."""
        if self.limit is None:
            return None
        return self.ours is not None and self.ours <= self.limit
