"""Named positions in the flat float64 rows (parameters, state) that compiled kernels read.

    P = slots("memory", "max_gap")            # P.memory == 0, P.max_gap == 1, P.size == 2
    MORE = slots("forgetting", after=P)       # the names of P, then its own
    keep = exp(-elapsed / par[P.memory])      # in a kernel: numba folds the position into a constant

Entries whose number varies (priors, windows, matrices) follow behind `size`. The steps of a kernel are compiled with
`forceinline`, since passing their many arrays would cost up to 15 % of the time per sample.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from via_core.signals import Array


def slots(*names: str, after: Any = None) -> Any:
    """A named tuple with the position of each name, those of `after` first, and their number `size`."""
    every = (*(after._fields[:-1] if after else ()), *names)
    return namedtuple("Slots", (*every, "size"))(*range(len(every) + 1))  # type: ignore[misc]


def row_of(table: Any, parameters: object, **given: float) -> Array:
    """The row (table.size,): each entry as `given`, else the attribute of that name of `parameters`."""
    entries = [given[name] if name in given else getattr(parameters, name) for name in table._fields[:-1]]
    return np.array(entries, dtype=np.float64)
