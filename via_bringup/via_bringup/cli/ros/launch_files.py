"""The part of ROS's `launch` that the launch files of VIA use, for machines without it: wheels have no `launch`.

`described(file)` reads a launch file with these classes in place of `launch` and `launch_ros`. Each class has the name
and the meaning of the one it replaces. A file that uses another class is refused.
"""

from __future__ import annotations

import json
import os
import runpy
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from via_core.errors import ParameterError, ViaError

from via_bringup.cli.run import find_executable, node_command

Context = dict[str, str]  # values of the launch arguments


class Substitution:
    """Text that depends on the launch arguments."""

    def perform(self, context: Context) -> str:
        raise NotImplementedError


@dataclass(frozen=True)
class LaunchConfiguration(Substitution):
    name: str

    def perform(self, context: Context) -> str:
        if self.name not in context:
            raise ParameterError(f"the launch file declares no argument '{self.name}'")
        return context[self.name]


@dataclass(frozen=True)
class FindPackageShare(Substitution):
    package: Any

    def perform(self, context: Context) -> str:
        try:
            return get_package_share_directory(text(self.package, context))
        except PackageNotFoundError:
            raise ViaError(f"package '{text(self.package, context)}' is not in the sourced workspace") from None


@dataclass(frozen=True)
class PathJoinSubstitution(Substitution):
    parts: Iterable[Any]

    def perform(self, context: Context) -> str:
        return str(Path(*(text(each, context) for each in self.parts)))


@dataclass(frozen=True)
class PythonExpression(Substitution):
    parts: Iterable[Any]

    def perform(self, context: Context) -> str:
        return str(eval("".join(text(each, context) for each in self.parts), {}))  # as in `launch`; files are code


@dataclass(frozen=True)
class EnvironmentVariable(Substitution):
    name: Any
    default_value: Any = None

    def perform(self, context: Context) -> str:
        name = text(self.name, context)
        if name not in os.environ and self.default_value is None:
            raise ViaError(f"environment variable {name} is not set")
        return os.environ[name] if name in os.environ else text(self.default_value, context)


@dataclass(frozen=True)
class IfCondition:
    predicate: Any

    def holds(self, context: Context) -> bool:
        return text(self.predicate, context).strip().lower() in ("true", "1")


@dataclass(frozen=True)
class ParameterValue:
    value: Any
    value_type: type = str

    def evaluate(self, context: Context) -> Any:
        given = text(self.value, context)
        if self.value_type is str:
            return given
        read = yaml.safe_load(given)
        if self.value_type is float and type(read) is int:
            read = float(read)
        if type(read) is not self.value_type:
            raise ParameterError(f"'{given}' is not a {self.value_type.__name__}")
        return read


@dataclass(frozen=True)
class DeclareLaunchArgument:
    name: str
    default_value: Any = None
    description: str = ""


@dataclass(frozen=True)
class SetEnvironmentVariable:
    name: Any
    value: Any


@dataclass(frozen=True)
class OpaqueFunction:
    function: Callable[[Context], Iterable[Any]]


@dataclass(frozen=True)
class LogInfo:
    msg: Any


@dataclass(frozen=True)
class Node:
    package: str
    executable: str
    name: str = ""
    parameters: Iterable[Any] = ()
    arguments: Iterable[Any] = ()
    ros_arguments: Iterable[Any] = ()
    condition: IfCondition | None = None
    output: str = "screen"

    def command(self, context: Context) -> list[str]:
        """Executable and arguments. Raises ViaError if the executable is not installed."""
        words = [*(text(each, context) for each in self.arguments), "--ros-args"]
        words += [text(each, context) for each in self.ros_arguments]
        words += ["-r", f"__node:={self.name}"] if self.name else []
        for given in self.parameters:
            if not isinstance(given, dict):
                words += ["--params-file", text(given, context)]
                continue
            for name, value in given.items():
                if isinstance(value, ParameterValue):
                    value = value.evaluate(context)
                elif isinstance(value, Substitution):
                    value = yaml.safe_load(value.perform(context))
                words += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
        return node_command(find_executable(self.package, self.executable), words)


@dataclass(frozen=True)
class LaunchDescription:
    entities: Iterable[Any] = field(default_factory=list)


MODULES: dict[str, tuple[type, ...]] = {
    "launch": (LaunchDescription, type("LaunchContext", (dict,), {})),
    "launch.actions": (DeclareLaunchArgument, LogInfo, OpaqueFunction, SetEnvironmentVariable),
    "launch.conditions": (IfCondition,),
    "launch.substitutions": (EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution, PythonExpression),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
    "launch_ros.parameter_descriptions": (ParameterValue,),
    "launch_ros.substitutions": (FindPackageShare,),
}


def text(value: Any, context: Context) -> str:
    """The text of a substitution, of a list of them, or of a plain value."""
    if isinstance(value, Substitution):
        return value.perform(context)
    if isinstance(value, list | tuple):
        return "".join(text(each, context) for each in value)
    return str(value)


def described(file: Path) -> tuple[Any, ...]:
    """Entities of a launch file. Raises ViaError if it needs more of `launch` than this module has."""
    with _replaced():
        try:
            content = runpy.run_path(str(file))
            return tuple(content["generate_launch_description"]().entities)
        except KeyError:
            raise ViaError(f"{file}: has no function generate_launch_description") from None
        except (ImportError, SyntaxError, TypeError) as error:
            raise ViaError(f"{file}: {error}; files beyond those of VIA need ROS's own `launch`") from None


def arguments(entities: Iterable[Any]) -> list[DeclareLaunchArgument]:
    """The declared launch arguments."""
    return [each for each in entities if isinstance(each, DeclareLaunchArgument)]


def configured(entities: Iterable[Any], given: dict[str, str]) -> Context:
    """Values of all launch arguments. Raises ParameterError for an unknown one, and for one without a value."""
    declared = arguments(entities)
    unknown = given.keys() - {each.name for each in declared}
    if unknown:
        names = ", ".join(sorted(each.name for each in declared))
        raise ParameterError(f"no launch argument {', '.join(sorted(unknown))}; there are: {names}")
    context: Context = {}
    for each in declared:
        if each.name not in given and each.default_value is None:
            raise ParameterError(f"add {each.name}:=VALUE, {each.description}")
        default = "" if each.default_value is None else each.default_value
        context[each.name] = given[each.name] if each.name in given else text(default, context)
    return context


def expanded(entities: Iterable[Any], context: Context) -> Iterator[Any]:
    """The entities, with those that functions return for these values in place of the functions."""
    for each in entities:
        if isinstance(each, OpaqueFunction):
            yield from expanded(each.function(context), context)
        else:
            yield each


def nodes(entities: Iterable[Any], context: Context) -> Iterator[Node]:
    """The nodes to start with these values."""
    for each in expanded(entities, context):
        if isinstance(each, Node) and (each.condition is None or each.condition.holds(context)):
            yield each


def messages(entities: Iterable[Any], context: Context) -> Iterator[str]:
    """The texts to print with these values."""
    return (text(each.msg, context) for each in expanded(entities, context) if isinstance(each, LogInfo))


def environment(entities: Iterable[Any], context: Context) -> dict[str, str]:
    """The environment variables that a launch file sets for its nodes, by name."""
    variables = [each for each in entities if isinstance(each, SetEnvironmentVariable)]
    return {text(each.name, context): text(each.value, context) for each in variables}


@contextmanager
def _replaced() -> Iterator[None]:
    """`launch` and `launch_ros` are the classes of this module inside the `with` statement."""
    ours = {name: ModuleType(name) for name in MODULES}
    for name, module in ours.items():
        module.__path__ = []
        vars(module).update({each.__name__: each for each in MODULES[name]})
    # This module of ours imports them, too.
    before = {name: sys.modules.pop(name, None) for name in (*MODULES, "via_bringup.launching")}
    sys.modules.update(ours)
    try:
        yield
    finally:
        for name, earlier in before.items():
            sys.modules.pop(name, None)
            if earlier is not None:
                sys.modules[name] = earlier
