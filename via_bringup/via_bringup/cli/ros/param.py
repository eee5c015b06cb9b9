"""`via param list|get|set|describe` and `via lifecycle get|set`."""

from __future__ import annotations

from typing import Annotated, Any

import typer
import yaml
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.exceptions import ParameterException
from rclpy.parameter import Parameter, parameter_value_to_python
from via_core.errors import ViaError

from via_bringup.cli.console import answers
from via_bringup.cli.ros.session import Session, absolute, session
from via_bringup.cli.ros.values import plain

NodeName = Annotated[str, typer.Argument(help="Node, e.g. /estimator.")]
Name = Annotated[str, typer.Argument(help="Parameter.")]


def list_parameters(node: Annotated[str, typer.Argument(help="Node; default: every node.")] = "") -> None:
    """List the parameters of a node, or of all nodes."""
    with session() as now:
        if node:
            nodes = [now.node_named(node)]
        else:
            now.discover()
            served = {name for name, _ in now.node.get_service_names_and_types()}
            nodes = [each for each in sorted(now.nodes()) if f"{each}/list_parameters" in served]
        for each in nodes:
            if not node:
                answers.print(f"{each}:")
            for name in sorted(_names(now, each)):
                answers.print(name if node else f"  {name}")


def get(node: NodeName, name: Name) -> None:
    """Print the value of a parameter as YAML."""
    with session() as now:
        full = now.node_named(node)
        _describe(now, full, name)
        value = now.call(GetParameters, f"{full}/get_parameters", GetParameters.Request(names=[name])).values[0]
        print(_yaml(parameter_value_to_python(value)), end="")


def set_parameter(
    node: NodeName, name: Name, value: Annotated[str, typer.Argument(help="New value as YAML, e.g. 0.05 or '[1, 2]'.")]
) -> None:
    """Change a parameter of a running node. The node refuses invalid values and parameters that are fixed."""
    try:
        given = yaml.safe_load(value)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ViaError(f"the value is not YAML: {' '.join(str(error).split())}") from None
    with session() as now:
        full = now.node_named(node)
        about = _describe(now, full, name)
        if about.read_only:
            raise ViaError(f"{name} of {full} is fixed when the node starts; give it there as -p {name}:={value}")
        kind = Parameter.Type(about.type)
        if kind == Parameter.Type.DOUBLE and type(given) is int:
            given = float(given)
        if kind == Parameter.Type.DOUBLE_ARRAY and isinstance(given, list):
            given = [float(each) if type(each) is int else each for each in given]
        if kind == Parameter.Type.STRING and isinstance(given, int | float):
            given = value
        try:
            message = Parameter(name, value=given).to_parameter_msg()
        except (TypeError, ParameterException):
            raise ViaError(f"{value!r} is no value of a parameter") from None
        request = SetParameters.Request(parameters=[message])
        answer = now.call(SetParameters, f"{full}/set_parameters", request).results[0]
    if not answer.successful:
        raise ViaError(f"{full} keeps {name}: {answer.reason or 'it gave no reason'}")
    answers.print(f"{full} {name}: {value}")


def describe(node: NodeName, name: Name) -> None:
    """Describe a parameter: meaning and unit, type, range, and whether it can change while the node runs."""
    with session() as now:
        about = _describe(now, now.node_named(node), name)
    answers.print(f"{name}: {about.description or 'no description'}")
    ranges = [*about.floating_point_range, *about.integer_range]
    lines = [f"type: {Parameter.Type(about.type).name.lower()}"]
    lines += [f"range: [{each.from_value:g}, {each.to_value:g}]" for each in ranges]
    lines += [about.additional_constraints] if about.additional_constraints else []
    lines.append("fixed when the node starts" if about.read_only else "can change while the node runs")
    answers.print("\n".join(f"  {line}" for line in lines))


def get_state(node: NodeName) -> None:
    """Print the state of a lifecycle node."""
    with session() as now:
        full = now.node_named(node)
        print(now.call(GetState, f"{full}/get_state", GetState.Request()).current_state.label)


def set_state(
    node: NodeName,
    transition: Annotated[str, typer.Argument(help="configure, activate, deactivate, cleanup or shutdown.")],
) -> None:
    """Change the state of a lifecycle node."""
    with session() as now:
        full = now.node_named(node)
        state = now.call(GetState, f"{full}/get_state", GetState.Request()).current_state.label
        request = ChangeState.Request()
        request.transition.label = transition
        if not now.call(ChangeState, f"{full}/change_state", request).success:
            raise ViaError(f"{full} refused '{transition}' while it is {state}")
        answers.print(f"{full}: {transition} succeeded")


def _names(now: Session, node: str) -> list[str]:
    answer: Any = now.call(ListParameters, f"{absolute(node)}/list_parameters", ListParameters.Request())
    return list(answer.result.names)


def _describe(now: Session, node: str, name: str) -> ParameterDescriptor:
    """Descriptor of a parameter. Raises ViaError, which lists the parameters, if the node has none of this name."""
    known = _names(now, node)
    if name not in known:
        raise ViaError(f"{node} has no parameter {name}; it has: {', '.join(sorted(known))}")
    request = DescribeParameters.Request(names=[name])
    return now.call(DescribeParameters, f"{node}/describe_parameters", request).descriptors[0]


def _yaml(value: Any) -> str:
    return yaml.safe_dump(plain(value), default_flow_style=True, width=1000).removesuffix("...\n")
