"""What all ways of the loop share: device, methods, rate and roles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

DEVICE = "qbmove_a"
METHODS = ("modulated_torque", "modulated_stiffness")
RATE = 1000.0  # [Hz]
LISTENERS = 3  # of samples: both estimators and the controller
ROLES = ("simulator", "estimator 0", "estimator 1", "controller")
# Published per tick: sample, stiffness and motor of the first method, stiffness of the second, command, control state.
MESSAGES = 6


class Part(NamedTuple):
    """A node in its role.

    counts    its present counts
    finished  done at the end of the loop; only the simulator's
    running   whether the loop runs; only the simulator's
    """

    node: Any
    counts: Callable[[], dict[str, float]]
    finished: Any = None
    running: Callable[[], bool] | None = None
