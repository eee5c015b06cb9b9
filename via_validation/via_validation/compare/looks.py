"""Colour and marker of each method, the same in every picture."""

from __future__ import annotations

from via_estimators.methods import METHODS

COLOURS = (
    "#d1495b", "#1b4965", "#2a7f62", "#e8871e", "#7d5ba6", "#5a5a5a", "#00a6a6", "#9c6644", "#b5bd00", "#5fb3e8",
    "#e377c2", "#7a1f1f", "#4fc24f",
)  # fmt: skip
MARKERS = "osD^vPX*<>hpd"
LOOKS = {
    method: {"color": colour, "marker": marker, "label": method}
    for method, colour, marker in zip(METHODS, COLOURS, MARKERS, strict=True)
}
