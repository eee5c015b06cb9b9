"""The `via` command line: its table of commands, plug-ins and error handling."""

from __future__ import annotations

import io
import sys
from importlib.metadata import entry_points, version
from typing import Annotated, Any, NoReturn

import typer
from rich.text import Text
from typer.core import TyperGroup
from via_core.errors import ViaError

from via_bringup.cli.console import answers, errors
from via_bringup.cli.deferred import Entry, add
from via_bringup.cli.interrupts import ending_on_interrupt, leave

PLUGINS = "via.commands"  # entry point group; each entry point is a dict like COMMANDS
GROUPS = {
    "device": "Describe a joint of your robot.",
    "bag": "Import, inspect, record, play and recover MCAP bags.",
    "gap": "Diagnose the gap between logs and the model of their device.",
    "topic": "List, print, measure and publish topics.",
    "service": "List and call services.",
    "action": "Send goals to actions.",
    "param": "List, read and change parameters of running nodes.",
    "node": "List the nodes that run.",
    "lifecycle": "Read and change the state of lifecycle nodes.",
}
RAW = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
# Commands that `ros2` has too: words after `via`, and function below via_bringup.cli.ros.
ROS = {
    "topic list": "topic:list_topics",
    "topic info": "topic:info",
    "topic echo": "topic:echo",
    "topic hz": "topic:hz",
    "topic pub": "topic:pub",
    "service list": "service:list_services",
    "service call": "service:call",
    "action send": "service:send",
    "node list": "service:list_nodes",
    "param list": "param:list_parameters",
    "param get": "param:get",
    "param set": "param:set_parameter",
    "param describe": "param:describe",
    "lifecycle get": "param:get_state",
    "lifecycle set": "param:set_state",
}
COMMANDS = {
    "demo": Entry("via_bringup.cli.demo:demo"),
    "devices": Entry("via_bringup.cli.devices:devices"),
    "device new": Entry("via_bringup.cli.device_new:new"),
    "estimate": Entry("via_bringup.cli.estimate:estimate"),
    "observe": Entry("via_bringup.cli.observe:observe"),
    "excite": Entry("via_bringup.cli.excite:excite"),
    "export": Entry("via_bringup.cli.export:export"),
    "sim": Entry("via_bringup.cli.simulate:run_simulator"),
    "run": Entry("via_bringup.cli.run:run", RAW),
    "launch": Entry("via_bringup.cli.ros.launch:launch", RAW),
    "watch": Entry("via_bringup.cli.ros.watch:watch"),
    "layout": Entry("via_bringup.cli.layout:layout"),
    "security": Entry("via_bringup.cli.security:security"),
    "bag import": Entry("via_bringup.cli.bag:import_folder"),
    "bag map": Entry("via_bringup.cli.bag_map:map_file"),
    "bag info": Entry("via_bringup.cli.bag:info"),
    "bag check": Entry("via_bringup.cli.bag:check"),
    "bag recover": Entry("via_bringup.cli.bag:recover"),
    "bag record": Entry("via_bringup.cli.bag:record"),
    "bag play": Entry("via_bringup.cli.bag:play"),
    "gap diagnose": Entry("via_bringup.cli.gap:diagnose"),
    "gap render": Entry("via_bringup.cli.gap:render"),
    "gap simulate": Entry("via_bringup.cli.gap:simulate"),
    "gap propose": Entry("via_bringup.cli.gap_propose:propose_motion"),
    "gap fleet": Entry("via_bringup.cli.gap_fleet:fleet"),
    **{
        name: Entry(f"via_bringup.cli.ros.{target}", ros2=name.replace("action send", "action send_goal"))
        for name, target in ROS.items()
    },
}


class Via(TyperGroup):
    """Command group with the commands of this package and of all installed plug-ins."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        add(self, COMMANDS, GROUPS)
        for plugin in entry_points(group=PLUGINS):
            add(self, plugin.load(), GROUPS)

    def invoke(self, context: Any) -> Any:
        """Run the command; Ctrl-C ends the process with one line."""
        try:
            return super().invoke(context)
        except KeyboardInterrupt:
            leave()


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
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for file names that are not valid Unicode
    try:
        with ending_on_interrupt():
            app()
    except ViaError as error:
        _end(str(error))
    except OSError as error:
        _end(f"{error.filename or 'input or output'}: {error.strerror}")


def _end(text: str) -> NoReturn:
    errors.print(Text.assemble(("error:", "bold red"), " ", text), soft_wrap=True)
    sys.exit(2)
