"""What all ways of the loop share: device, methods, rate and roles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from via_sim.nodes.round_trips import RoundTrips

DEVICE = "qbmove_a"
METHODS = ("modulated_torque", "modulated_stiffness")
RATE = 1000.0  # [Hz]
LISTENERS = 3  # of samples: both estimators and the controller
ROLES = ("simulator", "estimator 0", "estimator 1", "controller")
# Published per tick: sample, stiffness and motor of the first method, stiffness of the second, command, control state.
MESSAGES = 6


def simulated(samples: int, late: float, trips: RoundTrips) -> dict[str, float]:
    """Counts of a simulator: samples published, share of its ticks that were late, and its round trips."""
    return {
        "samples": samples,
        "late": late,
        "answered": trips.count,
        "p50": trips.percentile(50.0),
        "p99": trips.percentile(99.0),
        "largest": trips.largest,
    }


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
