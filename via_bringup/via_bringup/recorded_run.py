"""A file of commands run on the simulator, and what the sensors saw written as a log that the diagnosis reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from via_core.devices import Device
from via_core.signals import Signals
from via_gap.design.motion_file import columns_of, read_motion, write_table
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate


def run_file(device: Device, effects: Sequence[Effect], commands: Path, record: Path, rate: float, seed: int) -> None:
    """Commands of a table, from rest where they begin, to a table of measurements and the commands beside them.

    A joint whose drive is off at first begins where its link hangs.

    Raises ViaError for files that cannot be read or written, and for commands that the device does not understand.
    """
    asked = read_motion(commands, device)
    start = np.zeros(6)
    if device.drive == "servo" and "equilibrium" in asked:
        preset = asked["preset"][0] if "preset" in asked else 0.0
        start[1 : 1 + device.n_motors] = device.motor_angles(asked["equilibrium"][0], preset)
        start[0] = asked["equilibrium"][0]
    if device.drive == "position" and "equilibrium" in asked:
        goal = asked["equilibrium"][0]
        start[0] = goal if np.isfinite(goal) else device.link.gravity_angle
    period = asked.time[-1] - asked.time[-2] if len(asked) > 1 else 1.0 / rate
    plant, duration = JointPlant.from_device(device).with_effects(effects), asked.time[-1] - asked.time[0] + period
    initial = InitialConditions(start, seed=seed, time=float(asked.time[0]))
    run = simulate(plant, asked, float(duration), rate, Sensors.of_device(device), initial)
    seen = run.measured.select([n for n, values in run.measured.channels.items() if np.isfinite(values).any()])
    beside = Signals(asked.time, asked.channels, asked.units, asked.held).resample(seen.time)
    write_table(record, seen.time, {**columns_of(seen), **columns_of(beside)})
