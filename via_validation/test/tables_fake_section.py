"""A section as small as can be, for the tests of the frame around it."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_validation.tables.rows import Progress, Row


def rows(seeds: int, progress: Progress) -> list[Row]:
    progress(1, 2, "rows")
    return [
        Row("9.kept", "a | case", "MSE [-]", 1.0, np.float64(0.5), 1.0, "plant A", seeds),
        Row("9.missed", "another", "MSE [-]", 1.0, 2.0, 1.0, "plant A", seeds, "it is hard"),
        Row("9.shown", "shown", "share [-]", None, 0.123456, None, "plant B"),
        Row("9.lost", "not printed", "MSE [-]", 3.0, None, None, "plant B", 0, "the printed number says too little"),
        Row("9.diverged", "not a number", "MSE [-]", None, float("nan"), 1.0, "plant B"),
    ]


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """One picture with so much noise on it that it compresses badly."""
    progress(2, 2, "pictures")
    path = folder / "noise.png"
    plt.imsave(path, np.random.default_rng(0).random((500, 700, 3)))
    return [path]
