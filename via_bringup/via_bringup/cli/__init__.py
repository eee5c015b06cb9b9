"""The `via` command line: its table of commands, plug-ins and error handling."""

from __future__ import annotations

import io
import signal
import sys
from importlib.metadata import entry_points, version
from typing import Annotated, Any, NoReturn

import typer
from rich.text import Text
from typer.core import TyperGroup
from via_core.errors import ViaError

from via_bringup.cli.console import answers, errors
from via_bringup.cli.deferred import Entry, add

PLUGINS = "via.commands"  # entry point group; each entry point is a dict like COMMANDS
GROUPS = {
    "bag": "Import, inspect, record, play and recover MCAP bags.",
    "gap": "Diagnose the gap between logs and the model of their device.",
}
COMMANDS = {
    "demo": Entry(
        "via_bringup.cli.demo:demo",
        "Run the demo: a real robot's recordings and a simulated joint, shown on one page; or one controller scene.",
    ),
    "devices": Entry(
        "via_bringup.cli.devices:devices",
        "List the shipped devices, or describe one with the source of its parameters.",
    ),
    "estimate": Entry(
        "via_bringup.cli.estimate:estimate", "Estimate stiffness and damping from a bag and print the last values."
    ),
    "observe": Entry(
        "via_bringup.cli.observe:observe",
        "Show which quantities of a joint the signals and the motion determine, how well, and what is missing.",
    ),
    "excite": Entry(
        "via_bringup.cli.excite:excite",
        "Design the shortest motion that reaches a standard deviation of stiffness or damping within the limits.",
    ),
    "export": Entry(
        "via_bringup.cli.export:export",
        "Write a device with the effects of a report for another simulator, and list what that cannot hold.",
    ),
    "sim": Entry(
        "via_bringup.cli.simulate:run_simulator",
        "Run the simulator node until interrupted; it subscribes to VsaCommand on /<device>/command.",
    ),
    "run": Entry(
        "via_bringup.cli.run:run",
        "Run an installed node; all further arguments are passed to it, e.g. --ros-args -p device:=maccepavd.",
        {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
    ),
    "bag import": Entry(
        "via_bringup.cli.bag:import_folder",
        "Convert CSV recordings to bags; refuse unusable ones and list the reasons.",
    ),
    "bag info": Entry("via_bringup.cli.bag:info", "Show the topics and metadata of a bag."),
    "bag check": Entry(
        "via_bringup.cli.bag:check", "Check a bag for faults; the exit code is 1 if any finding is an error."
    ),
    "bag recover": Entry("via_bringup.cli.bag:recover", "Write all readable messages of a damaged bag to a new bag."),
    "bag record": Entry(
        "via_bringup.cli.bag:record",
        "Record topics until interrupted, also those that appear later; a line names each topic at its first message.",
    ),
    "bag play": Entry(
        "via_bringup.cli.bag:play",
        "Play a bag in time stamp order and publish /clock. Gives up after 20 s without a listener; see --listeners.",
    ),
    "gap diagnose": Entry(
        "via_bringup.cli.gap:diagnose",
        "Locate the gap between logs and model, identify its causes, and report the fraction that they explain.",
    ),
    "gap render": Entry(
        "via_bringup.cli.gap:render", "Print a saved report as text; optionally write it as an HTML page."
    ),
    "gap simulate": Entry(
        "via_bringup.cli.gap:simulate",
        "Simulate logs without and with effects and print both errors against the measurement.",
    ),
    "gap propose": Entry(
        "via_bringup.cli.gap_propose:propose_motion",
        "Propose the motion that best separates the tied causes of a report, within the device's limits.",
    ),
    "gap fleet": Entry(
        "via_bringup.cli.gap_fleet:fleet",
        "Diagnose many logs and print one table; also written to fleet.csv and fleet.json in the results folder.",
    ),
}


class Via(TyperGroup):
    """Command group with the commands of this package and of all installed plug-ins."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        add(self, COMMANDS, GROUPS)
        for plugin in entry_points(group=PLUGINS):
            add(self, plugin.load(), GROUPS)


app = typer.Typer(
    cls=Via,
    help="Estimate, simulate, record and compare variable impedance joints.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(requested: bool) -> None:
    if requested:
        answers.print(f"via {version('via_bringup')}")
        raise typer.Exit


@app.callback()
def via(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Estimate, simulate, record and compare variable impedance joints."""


def main() -> None:
    """Run the command. A ViaError or file system error is printed in one line, with exit code 2."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for file names that are not valid Unicode
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
