"""Location of the gap before any cause is known: equation, site, and region of the motion.

A torque that is missing only in the equation of the link belongs to the link, and only in that of one motor, to that
motor. An error of a transmission acts on both of its sides with opposite sign. So each site gives the second moments of
the residuals a pattern of its own. The measured moments are fitted by a non-negative combination of these patterns, and
the weights are the energy of each site. Errors without a pattern (of both motors at once, of the link angle in every
equation) may belong to sensors, timing or commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.optimize import nnls
from via_core.devices import Device
from via_core.signals import Array, Indices

from via_gap.logs.findings import Number, Record, Share
from via_gap.residual.inverse_dynamics import MissingTorque
from via_gap.residual.segments import Segments

Quantity = Literal["speed", "deflection", "angle", "motor angle", "torque", "time", "reversal"]
BINS = 5
STANDS_OUT = 1.6  # times its share of the data: energy from which a region is listed


class Region(Record):
    """A range of one quantity that contains more of the gap than its share of the data."""

    by: Quantity
    unit: str
    low: Number
    high: Number
    share: Share  # of the excess residual energy
    data: Share  # of the samples


@dataclass(frozen=True)
class SiteShare:
    """Energy at one site, as a share of the residual energy above the noise."""

    site: str
    motor: int
    equation: str
    share: float
    regions: tuple[Region, ...]


def localise(
    segments: Sequence[Segments], missing: Sequence[MissingTorque | None], device: Device
) -> tuple[SiteShare, ...]:
    """Shares of the sites that the equations distinguish, largest first; empty if a log allows no equation."""
    known = [each for each in missing if each is not None]
    if not known or len(known) < len(missing):
        return ()
    axes = known[0].axes
    torques = np.concatenate([each.torque for each in known])
    floors = np.concatenate([np.broadcast_to(each.floor, each.torque.shape) for each in known])
    scale = np.sqrt(np.mean(floors**2, axis=0))
    whitened = torques / scale
    moments = whitened.T @ whitened / len(whitened) - np.diag(np.mean((floors / scale) ** 2, axis=0))
    patterns, names = [], []
    for k, (axis, direction) in enumerate(zip(axes, np.eye(len(axes)), strict=True)):
        patterns.append(direction)
        names.append(("link", 0, "link") if axis == 0 else ("motor", axis, f"motor {axis}"))
        if axis > 0 and axes[0] == 0 and axis <= device.n_transmissions:
            both = direction / scale[k]
            both[0] = -1.0 / scale[0]
            patterns.append(both / np.linalg.norm(both))
            names.append(("transmission", axis, f"link and motor {axis}"))
    upper = np.triu_indices(len(axes))
    columns = np.stack([np.outer(p, p)[upper] for p in patterns], axis=1)
    energy, _ = nnls(columns, moments[upper])
    total = float(energy.sum())
    if total <= 0.0:
        return ()
    found = []
    for (site, motor, equation), amount, pattern in zip(names, energy, patterns, strict=True):
        if amount > 0.02 * total:
            excess = (whitened @ pattern) ** 2
            centres = [each.centre for each in known]
            regions = _regions(segments, centres, excess, device, motor if site != "link" else 0)
            found.append(SiteShare(site, motor, equation, float(amount / total), regions))
    return tuple(sorted(found, key=lambda each: -each.share))


def _regions(
    segments: Sequence[Segments], centres: Sequence[Indices], excess: Array, device: Device, axis: int
) -> tuple[Region, ...]:
    """Ranges of speed, deflection, angle and time that contain more of the energy than of the data."""
    states = np.concatenate([s.start[c] for s, c in zip(segments, centres, strict=True)])
    time = np.concatenate([c / s.rate for s, c in zip(segments, centres, strict=True)])
    against: dict[Quantity, tuple[str, Array]] = {
        "speed": ("rad/s", np.abs(states[:, 3 + axis])),
        "angle": ("rad", states[:, 0]),
        "time": ("s", time),
    }
    if device.n_transmissions:
        motor = max(axis, 1)
        against["deflection"] = ("rad", states[:, 0] - states[:, motor])
        against["motor angle"] = ("rad", states[:, motor])
    total = float(excess.sum())
    found = []
    for name, (unit, values) in against.items():
        if not np.isfinite(values).all() or total <= 0.0:
            continue
        edges = np.quantile(values, np.linspace(0.0, 1.0, BINS + 1))
        for low, high in pairwise(edges):
            inside = (values >= low) & (values <= high)
            share, data = float(excess[inside].sum() / total), float(inside.mean())
            if data > 0.0 and share > STANDS_OUT * data:
                ends = {"low": float(low), "high": float(high)}
                found.append(Region(by=name, unit=unit, share=min(share, 1.0), data=data, **ends))
    return tuple(sorted(found, key=lambda each: -each.share / each.data)[:4])
