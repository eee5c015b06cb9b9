"""`via sim DEVICE`: the simulator node with its parameters as options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_core.devices import load_device
from via_sim.effects_file import load_effects

from via_bringup.cli.console import answers
from via_bringup.cli.run import become, parameters
from via_bringup.recorded_run import run_file


def simulate(
    device: Annotated[str, typer.Argument(help="Device name (see `via devices`) or path to its YAML.")],
    mode: Annotated[str, typer.Option(help="realtime, lockstep or free.")] = "realtime",
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    rate: Annotated[float, typer.Option(help="Ticks per second [Hz].")] = 1000.0,
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = 0,
    commands: Annotated[Path | None, typer.Option(help="Run these commands (.csv) at once, without ROS.")] = None,
    record: Annotated[Path, typer.Option(help="With --commands: the log to write.")] = Path("log.csv"),
) -> None:
    """Run the simulator node until interrupted; it takes VsaCommand on /<device>/command."""
    described = load_device(device)  # said here in one line rather than by the node
    added = load_effects(effects) if effects is not None else ()
    if commands is not None:
        run_file(described, added, commands, record, rate, seed)
        answers.print(f"wrote {record}")
        return
    become(
        "via_sim",
        "simulator",
        parameters(device=device, mode=mode, effects=str(effects or ""), rate=rate, seed=seed),
    )
