"""`via sim DEVICE`: the simulator node with its parameters as options, or without ROS one run of a command file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from via_core.command_files import columns_of, read_motion, write_table
from via_core.devices import Device, load_device
from via_sim.effects import Effect
from via_sim.effects.files import load_effects
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

from via_bringup.cli.console import answers
from via_bringup.cli.options import DeviceName, OwnEffects
from via_bringup.cli.outputs import check_files
from via_bringup.cli.run import execute_node, ros_arguments


def run_simulator(
    device: DeviceName,
    mode: Annotated[str, typer.Option(help="realtime, lockstep or free (as fast as possible).")] = "realtime",
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    rate: Annotated[float, typer.Option(help="Samples per second \\[Hz].")] = 1000.0,
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = 0,
    commands: Annotated[
        Path | None, typer.Option(help="Simulate the commands of this .csv file instead, without ROS.")
    ] = None,
    record: Annotated[Path, typer.Option(help="With --commands: log to write (.csv).")] = Path("log.csv"),
    own_effects: OwnEffects = None,
) -> None:
    """Run the simulator node until interrupted; it subscribes to VsaCommand on /<device>/command."""
    described = load_device(device)  # errors appear here in one line, before the node starts
    added = load_effects(effects) if effects is not None else ()
    if commands is not None:
        check_files(record)
        simulate_file(described, added, commands, record, rate, seed)
        answers.print(f"wrote {record}")
        return
    given = {"effects": str(effects or ""), "own_effects": ",".join(own_effects or ())}
    arguments = ros_arguments(device=device, mode=mode, rate=rate, seed=seed, **given)
    execute_node("via_sim", "simulator", arguments)


def simulate_file(
    device: Device, effects: Sequence[Effect], commands: Path, record: Path, rate: float, seed: int
) -> None:
    """Simulate a file of commands and write a log with measurements and commands.

    The joint starts at rest at the first equilibrium. If its position drive is off at first, it starts hanging.

    Raises ViaError for files that cannot be read or written, and for commands that the device does not accept.
    """
    given = read_motion(commands, device)
    start = np.zeros(6)
    if device.drive == "servo" and "equilibrium" in given:
        preset = given["preset"][0] if "preset" in given else 0.0
        start[1 : 1 + device.n_motors] = device.motor_angles(given["equilibrium"][0], preset)
        start[0] = given["equilibrium"][0]
    if device.drive == "position" and "equilibrium" in given:
        goal = given["equilibrium"][0]
        start[0] = goal if np.isfinite(goal) else device.link.gravity_angle
    period = given.time[-1] - given.time[-2] if len(given) > 1 else 1.0 / rate
    plant, duration = JointPlant.from_device(device).with_effects(effects), given.time[-1] - given.time[0] + period
    initial = InitialConditions(start, seed=seed, time=float(given.time[0]))
    run = simulate(plant, given, float(duration), rate, Sensors.of_device(device), initial)
    measured = run.measured.select([n for n, values in run.measured.channels.items() if np.isfinite(values).any()])
    write_table(record, measured.time, {**columns_of(measured), **columns_of(given.resample(measured.time))})
