"""The `via` command: one word for everything the suite does without writing code."""

from __future__ import annotations

import sys

import typer
from via_core.errors import ViaError

from via_bringup.cli import bag, demo, devices, estimate, run, simulate
from via_bringup.cli.console import errors

app = typer.Typer(
    help="Estimate, simulate, record and compare variable impedance joints.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("devices")(devices.devices)
app.command("estimate")(estimate.estimate)
app.command("sim")(simulate.simulate)
app.command("run", context_settings=run.PASS_ARGUMENTS_ON)(run.run)
app.add_typer(bag.app, name="bag")


def main() -> None:
    """Run the command; what goes wrong on purpose becomes one line and exit code 2."""
    try:
        app()
    except ViaError as error:
        errors.print(f"[bold red]error:[/] {error}", highlight=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        errors.print("interrupted")
        sys.exit(130)
