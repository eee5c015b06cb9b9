"""Compiles the kernels of demo and diagnosis once for each state of the sources: `python -m via_bringup.kernels`.

numba compiles a kernel when it is first called and keeps it in NUMBA_CACHE_DIR. The first diagnosis on a new machine
would spend a minute of processor time on that, so `make setup` does it, with progress.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from via_bringup.cli.console import errors

STAMP = ".via-kernels"  # in NUMBA_CACHE_DIR: everything below is compiled
SIZE = 0.3  # [rad] of the motion
FRICTION = 0.1  # [N m] of a motor: a cause that the search finds


def main() -> None:
    """Compile what is not compiled yet. Without NUMBA_CACHE_DIR there is nothing to keep, and nothing is done."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if not folder or (Path(folder) / STAMP).exists():
        return
    columns = (TextColumn("setup: compiling kernels, about two minutes:"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        compile_kernels(lambda share: bar.update(task, completed=share))
    Path(folder).mkdir(parents=True, exist_ok=True)
    (Path(folder) / STAMP).touch()


def compile_kernels(progress: Callable[[float], None]) -> None:
    """Diagnose a simulated joint with all signals and with its link alone, and run the estimator of every drive."""
    from via_core.devices import load_device
    from via_estimators.methods import estimator_for
    from via_gap.design.commands import commands_of, recorded
    from via_gap.design.motions import MOTIONS
    from via_gap.diagnose import diagnose
    from via_gap.logs.log import JointLog
    from via_sim.effects import Effect
    from via_sim.plants import JointPlant

    plant = JointPlant.from_device(load_device("qbmove_a"))
    commands, start = commands_of(plant, MOTIONS[2], SIZE)
    rubbing = plant.with_effects([Effect("coulomb_friction", "motor", {"torque": FRICTION}, 1)])
    log = recorded(rubbing, commands, start, seed=1)
    assert log is not None and log.commands is not None
    link_only = JointLog(log.name, log.device, log.measured.select(["q"]), log.commands)
    diagnose([log], plant.device, progress=lambda _, share: progress(0.7 * share))
    diagnose([link_only], plant.device, progress=lambda _, share: progress(0.7 + 0.25 * share))
    for name in ("qbmove_a", "maccepavd", "compact_vpda"):
        estimator = estimator_for(load_device(name))
        estimator.step(estimator.init(), [0.0] * (1 + len(estimator.inputs)))


if __name__ == "__main__":
    sys.exit(main())
