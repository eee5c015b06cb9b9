"""Compile the numba kernels of demo and diagnosis into the cache: `python -m via_bringup.compile_kernels`.

numba compiles a kernel at its first call and caches it in NUMBA_CACHE_DIR. In the first diagnosis on a new machine this
takes a minute of processor time, so `make setup` does it in advance and shows its progress.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from via_bringup.cli.console import errors, working
from via_bringup.cli.interrupts import ending_on_interrupt, leave

STAMP = ".via-kernels"  # file in NUMBA_CACHE_DIR that marks a complete cache
AMPLITUDE = 0.3  # [rad] of the simulated motion
RATE, TICKS = 1000.0, 3  # [Hz], length of the runs of all devices
FRICTION = 0.1  # [N m] Coulomb friction of a motor; large enough for the diagnosis to find it


def main() -> None:
    """Compile the kernels unless the cache is complete. Does nothing if NUMBA_CACHE_DIR is not set."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if not folder or (Path(folder) / STAMP).exists():
        return
    what = "setup: compiling kernels, about two minutes"
    if not errors.is_terminal:
        errors.print(f"{what} ...")
    with working(what) as show:
        compile_kernels(lambda share: show(what, share))
    Path(folder).mkdir(parents=True, exist_ok=True)
    (Path(folder) / STAMP).touch()


def compile_kernels(progress: Callable[[float], None]) -> None:
    """Diagnose a joint with all signals and with its link angle only, estimate for each drive, simulate all devices."""
    from via_core.devices import device_names, load_device
    from via_estimators.methods import estimator_for
    from via_gap.design.commands import commands_of, recorded
    from via_gap.design.motions import MOTIONS
    from via_gap.diagnosis import diagnose
    from via_gap.logs.log import JointLog
    from via_sim.effects import Effect
    from via_sim.plants import JointPlant
    from via_sim.sensors import IDEAL, Sensors
    from via_sim.simulate import simulate

    plant = JointPlant.from_device(load_device("qbmove_a"))
    commands, start = commands_of(plant, MOTIONS[2], AMPLITUDE)
    with_friction = plant.with_effects([Effect("coulomb_friction", "motor", {"torque": FRICTION}, 1)])
    log = recorded(with_friction, commands, start, seed=1)
    assert log is not None and log.commands is not None
    link_only = JointLog(log.name, log.device, log.measured.select(["q"]), log.commands)
    diagnose([log], plant.device, progress=lambda _, share: progress(0.6 * share))
    diagnose([link_only], plant.device, progress=lambda _, share: progress(0.6 + 0.2 * share))
    for name in ("qbmove_a", "maccepavd", "compact_vpda"):
        estimator = estimator_for(load_device(name))
        estimator.step(estimator.init(), [0.0] * (1 + len(estimator.inputs)))
    for n, name in enumerate(names := device_names()):
        device = load_device(name)
        progress(0.8 + 0.2 * n / len(names))
        for sensors in (IDEAL, Sensors.of_device(device)):  # joints of each structure have their own kernel
            simulate(JointPlant.from_device(device), None, TICKS / RATE, RATE, sensors)


if __name__ == "__main__":
    with ending_on_interrupt():
        try:
            main()
        except KeyboardInterrupt:
            leave()
