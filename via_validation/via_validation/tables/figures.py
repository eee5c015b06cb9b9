"""Saving of figures."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt

matplotlib.use("Agg")


def save_figure(figure: plt.Figure, path: Path) -> Path:
    """Write and close the figure; makes the folder if necessary. Returns `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)
    return path
