"""The `via` command: one word for everything the suite does without writing code."""

from __future__ import annotations

import io
import signal
import sys
from typing import NoReturn

import typer
from rich.text import Text
from via_core.errors import ViaError

from via_bringup.cli import bag, bench, compare, demo, devices, estimate, gap, run, simulate, tables
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
app.command("compare")(compare.compare)
app.command("tables")(tables.tables)
app.add_typer(bag.app, name="bag")
app.add_typer(bench.app, name="bench")
app.add_typer(gap.app, name="gap")


def main() -> None:
    """Run the command; what goes wrong on purpose, or in the file system, becomes one line and exit code 2."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files may be no text, terminals no Unicode
    try:
        app()
    except ViaError as error:
        _end(str(error))
    except OSError as error:
        _end(f"{error.filename or 'input or output'}: {error.strerror}")
    except KeyboardInterrupt:
        errors.print("interrupted")
        sys.exit(130)


def _end(text: str) -> NoReturn:
    errors.print(Text.assemble(("error:", "bold red"), " ", text), soft_wrap=True)
    sys.exit(2)
