"""One line of a table: what the document says, what we get, what was to be reached, and how it was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[int, int, str], None]  # done, of how many, what


@dataclass(frozen=True)
class Row:
    """A figure of the document beside ours.

    id        unique, dotted from the section: '3.table2.n2.torque_noise.mse'
    what      the case in words, e.g. 'N = 2, noise on torques, full window'
    quantity  what the number is, with its unit: 'MSE [(N m/rad)^2]'
    document  the printed number; None where the document has none
    ours      what this run measured; None where it cannot be reproduced
    limit     what was to be reached: ours <= limit; None for rows that are shown, not judged
    settings  plant, excitation, noise, parameters: enough to do it again
    seeds     number of noise realisations averaged; 0 for noise-free cases
    remark    why it differs or cannot be reproduced; empty when there is nothing to say
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
        """Whether the limit is kept; None where nothing is judged."""
        if self.limit is None:
            return None
        return self.ours is not None and self.ours <= self.limit
