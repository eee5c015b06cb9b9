"""The `via` command: one word for everything that the suite does without writing code."""

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

PLUGINS = "via.commands"  # entry points, each a dict of commands such as COMMANDS
GROUPS = {
    "bag": "Import, inspect, record, play and recover MCAP bags.",
    "gap": "Diagnose the gap between a log and its model.",
}
COMMANDS = {
    "demo": Entry(
        "via_bringup.cli.demo:demo",
        "A real robot's log and a simulated joint, from bags over DDS to one page; or a scene of a controller.",
    ),
    "devices": Entry("via_bringup.cli.devices:devices", "List the shipped devices, or describe one."),
    "estimate": Entry(
        "via_bringup.cli.estimate:estimate", "Estimate stiffness and damping from a bag and print the last values."
    ),
    "sim": Entry(
        "via_bringup.cli.simulate:simulate",
        "Run the simulator node until interrupted; it takes VsaCommand on /<device>/command.",
    ),
    "run": Entry(
        "via_bringup.cli.run:run",
        "Run an installed node; all further arguments go to the node, e.g. --ros-args -p device:=maccepavd.",
        {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
    ),
    "bag import": Entry(
        "via_bringup.cli.bag:import_folder",
        "Convert recordings to bags; impossible recordings are refused, each with its reason.",
    ),
    "bag info": Entry("via_bringup.cli.bag:info", "Show what is in a bag."),
    "bag check": Entry(
        "via_bringup.cli.bag:check", "Look for faults in a bag; exit code 1 when one of the findings is an error."
    ),
    "bag recover": Entry(
        "via_bringup.cli.bag:recover", "Write a complete bag from all messages that are left in a damaged one."
    ),
    "bag record": Entry("via_bringup.cli.bag:record", "Record topics until interrupted."),
    "bag play": Entry("via_bringup.cli.bag:play", "Play a bag in stamp order, with /clock."),
    "gap diagnose": Entry(
        "via_bringup.cli.gap:diagnose",
        "Report where the gap between logs and model lies, which effect causes it and how far it shrinks.",
    ),
    "gap render": Entry("via_bringup.cli.gap:render", "Show a report again: as text, and as a page."),
    "gap simulate": Entry(
        "via_bringup.cli.gap:simulate",
        "Simulate logs without and with effects and print the error of each against the measurement.",
    ),
    "gap propose": Entry(
        "via_bringup.cli.gap_propose:propose_motion",
        "Propose the motion that best distinguishes tied causes, within the device's limits.",
    ),
    "gap fleet": Entry(
        "via_bringup.cli.gap_fleet:fleet",
        "Diagnose many logs and print one table; also as fleet.csv and fleet.json in the folder of results.",
    ),
}


class Via(TyperGroup):
    """The commands of this package and those of every installed plug-in."""

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


def _print_version(wanted: bool) -> None:
    if wanted:
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
    """Run the command. Expected errors, and those of the file system, become one line and exit code 2."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # file names may be no text, terminals no Unicode
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
