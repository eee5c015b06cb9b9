"""Parts that launch files share: typed launch arguments, nodes, a simulation with a recorder, a bag to play."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    PathJoinSubstitution,
    PythonExpression,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from via_bringup.enclaves import enclave_arguments


def string(name: str) -> ParameterValue:
    """Value of a launch argument as a string parameter, even if it looks like a number."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def number(name: str) -> ParameterValue:
    """Value of a launch argument as a float parameter, even if it looks like an integer."""
    return ParameterValue(LaunchConfiguration(name), value_type=float)


def flag(name: str) -> ParameterValue:
    """Value of a launch argument, true or false, as a boolean parameter."""
    return ParameterValue(LaunchConfiguration(name), value_type=bool)


def if_equal(name: str, value: str) -> IfCondition:
    """Condition that a launch argument has this value."""
    return IfCondition(PythonExpression(["'", LaunchConfiguration(name), f"' == '{value}'"]))


def node(package: str, executable: str, *parameters: Any, **more: Any) -> Node:
    """A node that logs to the screen. `parameters` are files and dictionaries; later ones override earlier ones."""
    if package.startswith("via_"):
        more["ros_arguments"] = enclave_arguments(executable)
    return Node(package=package, executable=executable, parameters=list(parameters), output="screen", **more)


def missing(packages: Iterable[str]) -> list[str]:
    """Those of these packages that are not installed."""

    def is_missing(package: str) -> bool:
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            return True
        return False

    return [each for each in packages if is_missing(each)]


def network() -> list[Any]:
    """Launch argument `discovery`: where the nodes are found. Nodes of this launch file that follow it obey it."""
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    given = EnvironmentVariable(name, default_value="LOCALHOST")
    return [
        DeclareLaunchArgument(
            "discovery", default_value=given, description="LOCALHOST: this host only; SUBNET: open to the network"
        ),
        SetEnvironmentVariable(name, LaunchConfiguration("discovery")),
    ]


def parameter_file(default: Any, description: str = "parameter file of the nodes") -> DeclareLaunchArgument:
    """Launch argument `parameters`. `default` is the name of a file in this package's `config` folder."""
    path = PathJoinSubstitution([FindPackageShare("via_bringup"), "config", default])
    return DeclareLaunchArgument("parameters", default_value=path, description=description)


def simulation(defaults: Any, **more: Any) -> list[Any]:
    """Launch arguments `discovery`, `mode`, `bag`, `parameters` (as in `parameter_file`); `bag` starts a recorder."""
    return [
        *network(),
        DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
        DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
        parameter_file(defaults, **more),
        node("via_ros", "recorder", {"bag": string("bag")}, condition=_if_bag()),
    ]


def playback(speed: str = "playback speed") -> list[Any]:
    """Launch arguments `discovery`, `bag` and `rate`; a player starts if `bag` is given. `speed` describes `rate`."""
    played = {"bag": string("bag"), "rate": number("rate")}
    return [
        *network(),
        DeclareLaunchArgument("bag", default_value="", description="bag to play; empty: use the robot's topics"),
        DeclareLaunchArgument("rate", default_value="1.0", description=speed),
        node("via_ros", "player", played, condition=_if_bag()),
    ]


def _if_bag() -> IfCondition:
    return IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
