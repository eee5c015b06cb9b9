"""What launch files share: nodes on the screen, text arguments, a simulation with its recorder, a bag to play."""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def text(name: str) -> ParameterValue:
    """A launch argument as a text parameter, also where it looks like a number."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def number(name: str) -> ParameterValue:
    """A launch argument as a parameter with a fraction, also where it looks whole."""
    return ParameterValue(LaunchConfiguration(name), value_type=float)


def when(name: str, value: str) -> IfCondition:
    """Whether an argument has this value."""
    return IfCondition(PythonExpression(["'", LaunchConfiguration(name), f"' == '{value}'"]))


def node(package: str, executable: str, *parameters: Any, **more: Any) -> Node:
    """A node that logs to the screen; `parameters` are files and dictionaries, later ones win."""
    return Node(package=package, executable=executable, parameters=list(parameters), output="screen", **more)


def parameter_file(default: Any, description: str = "parameter file of the nodes") -> DeclareLaunchArgument:
    """Argument `parameters`; its default is a file of this package's `config`."""
    path = PathJoinSubstitution([FindPackageShare("via_bringup"), "config", default])
    return DeclareLaunchArgument("parameters", default_value=path, description=description)


def simulation(defaults: Any, **more: Any) -> list[Any]:
    """Arguments `mode`, `bag` and `parameters` (as in `parameter_file`), and the recorder that a `bag` starts."""
    return [
        DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
        DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
        parameter_file(defaults, **more),
        node("via_ros", "recorder", {"bag": text("bag")}, condition=_with_a_bag()),
    ]


def playing(fastest: str = "") -> list[Any]:
    """Arguments `bag` and `rate`, and the player that a `bag` starts; `fastest` is said of the rate."""
    return [
        DeclareLaunchArgument("bag", default_value="", description="bag to play; empty: listen to the robot"),
        DeclareLaunchArgument("rate", default_value="1.0", description=f"playing speed{fastest}"),
        node("via_ros", "player", {"bag": text("bag"), "rate": number("rate")}, condition=_with_a_bag()),
    ]


def _with_a_bag() -> IfCondition:
    return IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
