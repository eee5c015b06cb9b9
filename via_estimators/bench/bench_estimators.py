"""Time of one full step of every estimator: window, least squares and standard deviations; one sample at a time and
folded over a log. The limit is 10 us for one step (two transmissions, 200 intervals per window)."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from via_core.devices import load_device
from via_core.signals import Array
from via_estimators.contract import Estimator
from via_estimators.methods import estimator_for

SAMPLES, REPEATS = 1000, 20


def moving_rows(estimator: Estimator, count: int) -> Array:
    """Rows (count, 1 + k) with every column in smooth motion."""
    t = np.arange(count) * 1e-3
    columns = [0.4 * np.sin((5.0 + at) * t + at) for at, _ in enumerate(estimator.inputs)]
    return np.column_stack([t, *columns])


def best_times(estimator: Estimator) -> tuple[float, float]:
    """[s] per sample: by `step`, and folded by `run_rows`; the best of several, the machine being busy at times."""
    rows = moving_rows(estimator, 3 * SAMPLES)
    state, _ = estimator.run_rows(rows[: 2 * SAMPLES])
    steps, runs = [], []
    for _ in range(REPEATS):
        start = perf_counter()
        for row in rows[2 * SAMPLES :]:
            estimator.step(state, row)
        middle = perf_counter()
        estimator.run_rows(rows[2 * SAMPLES :], state)
        steps.append(middle - start)
        runs.append(perf_counter() - middle)
    return min(steps) / SAMPLES, min(runs) / SAMPLES


def main() -> None:
    print("Estimators: time per sample, best of", REPEATS)
    for name in ("cubic_demo", "qbmove_a", "maccepavd"):
        estimator = estimator_for(load_device(name))
        step, run = best_times(estimator)
        print(f"  {name:12} {type(estimator).__name__:16} step {1e6 * step:5.1f} us   in a log {1e6 * run:5.1f} us")


if __name__ == "__main__":
    main()
