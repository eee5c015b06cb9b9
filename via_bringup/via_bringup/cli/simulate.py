"""`via sim DEVICE`: the simulator node with its parameters as options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_core.devices import load_device
from via_sim.effects_file import load_effects

from via_bringup.cli.run import become, parameters


def simulate(
    device: Annotated[str, typer.Argument(help="Device name (see `via devices`) or path to its YAML.")],
    mode: Annotated[str, typer.Option(help="realtime, lockstep or free.")] = "realtime",
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    rate: Annotated[float, typer.Option(help="Ticks per second [Hz].")] = 1000.0,
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = 0,
) -> None:
    """Run the simulator node until interrupted; it answers VsaCommand on /<device>/command."""
    load_device(device)  # said here in one line rather than by the node
    if effects is not None:
        load_effects(effects)
    become(
        "via_sim",
        "simulator",
        parameters(device=device, mode=mode, effects=str(effects or ""), rate=rate, seed=seed),
    )
