"""Short motions that separate effects, as references of the motors around rest.

Every motion begins and ends at rest. The family covers speeds from creep to fast strokes, reversals that start smaller
than any presliding displacement or backlash, standstill approached from both sides, steps, a rising frequency, and the
same strokes under different loads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.signal import fftconvolve
from via_core.signals import Array

DURATION = 12.0  # [s]
REST = 0.5  # [s] before and after the motion
ROUNDED = 0.05  # [s] smoothing of corners


@dataclass(frozen=True)
class Motion:
    """A motion of the family.

    shows   what it excites, in words
    at      (N,) share -1..1 of the largest angle at shares (N,) of the time
    loaded  (N,) share of the largest preset or load at the same times, 0 where it does not matter
    """

    name: str
    shows: str
    at: Callable[[Array], Array]
    loaded: Callable[[Array], Array] = np.zeros_like

    def reference(self, time: Array) -> Array:
        """(N,) shares, corners rounded, at rest in the beginning and at the end."""
        half = max(1, round(0.5 * ROUNDED / (time[1] - time[0])))
        window = np.hanning(2 * half + 3)[1:-1]
        inside = np.clip(time - REST, 0.0, DURATION - 2.0 * REST) / (DURATION - 2.0 * REST)
        padded = np.pad(self.at(inside), half, mode="edge")
        return np.asarray(fftconvolve(padded, window / window.sum(), mode="valid"))

    def load(self, time: Array) -> Array:
        """(N,) shares."""
        return self.loaded(np.clip(time / DURATION, 0.0, 1.0))


def _strokes(*stops: tuple[float, float]) -> Callable[[Array], Array]:
    """Straight lines through (share of the time, angle)."""
    at, angle = zip(*stops, strict=True)
    return lambda share: np.interp(share, at, angle)


def _triangle(cycles: float, size: float = 1.0) -> Callable[[Array], Array]:
    """There and back on both sides at one speed."""
    return lambda share: np.asarray(size * (2.0 / pi * np.arcsin(np.sin(2.0 * pi * cycles * share))))


def _ladder(share: Array) -> Array:
    """There and back at six speeds, each twice the one before."""
    speeds = 2.0 ** np.arange(6)
    reach = np.minimum(speeds / speeds[-2], 1.0)
    spans = np.repeat(reach / speeds, 2)
    edges = np.concatenate([[0.0], np.cumsum(spans)]) / spans.sum()
    return np.interp(share, edges, np.append(0.0, np.column_stack([reach, np.zeros(6)])))


def _growing(cycles: float) -> Callable[[Array], Array]:
    """Reversals whose amplitude grows from a two-hundredth to the whole; ends at rest."""
    return lambda share: 0.005 ** (1.0 - share) * np.sin(2.0 * pi * cycles * share)


def _chirp(share: Array) -> Array:
    climb = np.log(20.0)
    fade = np.minimum(1.0, 20.0 * (1.0 - share))
    return np.sin(2.0 * pi * 3.0 * (np.exp(climb * share) - 1.0) / climb) * np.exp(-0.7 * climb * share) * fade


def _holds(share: Array) -> Array:
    """Angles approached from below and from above, and held."""
    goals = [0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0]
    edges = np.linspace(0.0, 1.0, len(goals) + 1)
    at = np.sort(np.concatenate([edges[:-1] + 0.03, edges[1:] - 0.005]))
    return np.interp(share, at, np.repeat(goals, 2))


def _steps(share: Array) -> Array:
    return np.tanh(8.0 * np.sin(2.0 * pi * 5.0 * share))


MOTIONS = (
    Motion("slow creep", "friction far below the speed of ordinary motion", _triangle(1.0, 0.15)),
    Motion("slow strokes", "friction at low speed, loading against unloading", _triangle(1.0, 0.6)),
    Motion("ladder of speeds", "how friction depends on speed", _ladder),
    Motion("growing reversals", "presliding and backlash after a reversal", _growing(12.0)),
    Motion("slow growing reversals", "presliding and backlash after a reversal", _growing(5.0)),
    Motion("holds", "standstill approached from both sides", _holds),
    Motion("steps", "high torque, impacts, delays", _steps),
    Motion("rising frequency", "delays, resonance, damping", _chirp),
    Motion(
        "strokes under two loads",
        "the same speeds with little and with much torque in the transmission",
        lambda s: _triangle(6.0, 0.3)(s) + _strokes((0.0, 0.0), (0.45, 0.0), (0.55, 0.7), (0.9, 0.7), (1.0, 0.0))(s),
        _strokes((0.0, 0.0), (0.45, 0.0), (0.55, 1.0), (1.0, 1.0)),
    ),
)  # fmt: skip
