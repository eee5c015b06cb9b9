"""The link-side estimator on the real runs in this repository (repeat 3, four strategies).

No truth is known there. What is held: motion decides when there is an estimate, and its size is that of a damper whose
published range is .0077 to .0362 N m s/rad and of a spring within a factor of two of the published one.
"""

from importlib import resources

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.status import Status
from via_estimators.contract import summarise
from via_estimators.methods import estimator_for

SAMPLES = resources.files("via_core").joinpath("samples", "maccepavd")
DEVICE = load_device("maccepavd")
RUNS = sorted(
    (strategy.name, int(record.name.removesuffix("_3.csv").removeprefix("record_traj")))
    for strategy in SAMPLES.iterdir()
    if strategy.is_dir()
    for record in strategy.joinpath("record").iterdir()
    if record.name.endswith("_3.csv")
)


def rows_of_run(strategy, run):
    """Rows (N, 5) of a run: time, q, logged servo angle, held equilibrium and preset; NaN before the first command."""
    record, command = (
        np.genfromtxt(str(SAMPLES.joinpath(strategy, *name)), delimiter=",", skip_header=1)
        for name in (("record", f"record_traj{run}_3.csv"), ("command", f"traj{run}.csv"))
    )
    at = np.searchsorted(command[:, 0], record[:, 1], side="right") - 1
    held = np.where(at[:, None] >= 0, command[np.maximum(at, 0), 1:3], np.nan)
    return np.column_stack([record[:, 1], record[:, 2], record[:, 4], held])


def test_every_strategy_is_present():
    assert {strategy for strategy, _ in RUNS} == {"constant", "fixdamp", "optimal", "vardamp"} and len(RUNS) >= 8


@pytest.mark.parametrize(("strategy", "run"), RUNS)
def test_every_good_run_gives_an_estimate_of_the_right_size(strategy, run):
    rows = rows_of_run(strategy, run)
    _, estimates = estimator_for(DEVICE).run_rows(rows)
    assert np.isfinite(estimates.value).all() and np.isfinite(estimates.standard_deviation).all()
    assert 40 <= (estimates.status == Status.OK).sum() <= 250
    damping, sd, _ = summarise(estimates, "damping")
    assert 0.004 <= damping <= 0.04
    assert 0.002 <= sd <= 0.012
    gain = summarise(estimates, "gain")
    assert 0.5 <= gain.value <= 2.0 and gain.standard_deviation <= 0.5
