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


def _ros(name: str, target: str, text: str, ros2: str = "") -> dict[str, Entry]:
    """A command that `ros2` has too, under the same name or as `ros2`."""
    return {name: Entry(f"via_bringup.cli.ros.{target}", text, ros2=ros2 or name)}


COMMANDS = {
    "demo": Entry(
        "via_bringup.cli.demo:demo",
        "Run the demo: a real robot's recordings and a simulated joint, shown on one page; or one controller scene.",
    ),
    "devices": Entry(
        "via_bringup.cli.devices:devices",
        "List the shipped devices, or describe one with the source of its parameters.",
    ),
    "device new": Entry(
        "via_bringup.cli.device_new:new",
        "Write a commented device file from a model (URDF, MJCF), a recording, both, or the answers to questions.",
    ),
    "estimate": Entry(
        "via_bringup.cli.estimate:estimate",
        "Estimate stiffness and damping from a bag or a table and print the last values.",
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
        RAW,
    ),
    "launch": Entry(
        "via_bringup.cli.ros.launch:launch",
        "Start the nodes of a launch file and end them together; --show-args lists its arguments.",
        RAW,
    ),
    "watch": Entry(
        "via_bringup.cli.ros.watch:watch",
        "Show rate, stiffness, damping, status, gap and causes of every joint, and the warnings of all nodes, live.",
    ),
    "layout": Entry(
        "via_bringup.cli.layout:layout",
        "Write a layout for Foxglove or PlotJuggler that shows samples, commands, estimates and gap of a joint.",
    ),
    "security": Entry(
        "via_bringup.cli.security:security",
        "Make an SROS2 key store for the nodes of VIA: keys, governance, and permissions for these devices and arms.",
    ),
    "bag import": Entry(
        "via_bringup.cli.bag:import_folder",
        "Convert recordings to bags; refuse unusable ones and list the reasons.",
    ),
    "bag map": Entry(
        "via_bringup.cli.bag_map:map_file",
        "Show columns or topics of a recording with rates and guesses, and write the commented mapping.",
    ),
    "bag info": Entry("via_bringup.cli.bag:info", "Show the topics and metadata of a bag."),
    "bag check": Entry(
        "via_bringup.cli.bag:check", "Check a recording for faults; the exit code is 1 if any finding is an error."
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
    **_ros("topic list", "topic:list_topics", "List the topics."),
    **_ros("topic info", "topic:info", "Show type, publishers and subscribers of a topic, with their QoS."),
    **_ros("topic echo", "topic:echo", "Print the messages of a topic as YAML until interrupted."),
    **_ros(
        "topic hz",
        "topic:hz",
        "Print the rate of a topic and the intervals between its messages every second, until interrupted.",
    ),
    **_ros(
        "topic pub",
        "topic:pub",
        "Publish a message, once it has a subscriber; until interrupted, unless --once or --times is given.",
    ),
    **_ros("service list", "service:list_services", "List the services."),
    **_ros("service call", "service:call", "Call a service and print its response as YAML."),
    **_ros(
        "action send",
        "service:send",
        "Send a goal to an action and print its result as YAML. Ctrl-C cancels the goal.",
        "action send_goal",
    ),
    **_ros("node list", "service:list_nodes", "List the nodes."),
    **_ros("param list", "param:list_parameters", "List the parameters of a node, or of all nodes."),
    **_ros("param get", "param:get", "Print the value of a parameter as YAML."),
    **_ros(
        "param set",
        "param:set_parameter",
        "Change a parameter of a running node. The node refuses invalid values and parameters that are fixed.",
    ),
    **_ros(
        "param describe",
        "param:describe",
        "Describe a parameter: meaning and unit, type, range, and whether it can change while the node runs.",
    ),
    **_ros("lifecycle get", "param:get_state", "Print the state of a lifecycle node."),
    **_ros("lifecycle set", "param:set_state", "Change the state of a lifecycle node."),
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
