"""Typed ROS parameters from a frozen dataclass, declared with description, unit and range.

    @dataclass(frozen=True)
    class Parameters:
        rate: float = parameter(1.0, "playing speed", "-", (0.0, 1e3))  # via_core.parameters
        mode: str = parameter("free", "time mode", choices=("free", "lockstep"))

    parameters = declare(node, Parameters)

A float parameter accepts an integer (`rate:=2`). Parameters are read-only, except those declared `live` in a node that
takes changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, replace
from math import inf
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterValueException
from via_core.errors import ParameterError, ViaError

T = TypeVar("T")
WHOLE = 2**63 - 1  # bounds of a ROS integer parameter


def declare(node: Any, kind: type[T], prefix: str = "", changed: Callable[[T], Callable[[], None]] | None = None) -> T:
    """Declare one parameter per field of the dataclass `kind` and return an instance with their values.

    prefix   prepended to the names with a dot, for nodes with several sets
    changed  called with new parameters when a live one is set while the node runs; returns what puts them into effect
             once ROS has accepted all parameters of the request; a ViaError refuses them

    Every field needs a default of the parameter's type: float, int, bool, str, or a tuple of one of these.
    Raises ParameterError with the name of the parameter, its value and the allowed range.
    """
    prefix = prefix and f"{prefix}."
    values: dict[str, Any] = {}
    for item in fields(kind):  # type: ignore[arg-type]
        name = f"{prefix}{item.name}"
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        fixed = changed is None or not item.metadata.get("live")
        given = _declared(node, name, default, item.metadata, fixed)
        values[item.name] = _checked(name, given, default, item.metadata)
    try:
        declared = kind(**values)
    except ParameterError as error:
        raise ParameterError(f"parameter {prefix}{str(error).partition('.')[2] or error}") from None
    if changed is not None:
        _take_changes(node, declared, prefix, changed)
    return declared


def _take_changes(node: Any, declared: Any, prefix: str, changed: Callable[[Any], Callable[[], None]]) -> None:
    """Call `changed` whenever live parameters of the instance `declared` are set.

    Another callback, of ROS or of the user's node, may refuse the request afterwards: nothing changes before all have
    agreed.
    """
    live = {f"{prefix}{item.name}": item for item in fields(declared) if item.metadata.get("live")}
    present, agreed = [declared], list[tuple[Any, Callable[[], None]]]()

    def consider(given: list[Any]) -> SetParametersResult:
        agreed.clear()
        mine = {each.name: each.value for each in given if each.name in live}
        try:
            values = {
                live[name].name: _checked(name, value, getattr(present[0], live[name].name), live[name].metadata)
                for name, value in mine.items()
            }
            if values:
                new = replace(present[0], **values)
                agreed.append((new, changed(new)))
        except ViaError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def conclude(_: list[Any]) -> None:
        for new, put_into_effect in agreed:
            present[0] = new
            put_into_effect()
        agreed.clear()

    node.add_on_set_parameters_callback(consider)
    node.add_post_set_parameters_callback(conclude)


def _declared(node: Any, name: str, default: Any, about: Mapping[str, Any], fixed: bool) -> Any:
    descriptor = ParameterDescriptor(
        description=about.get("description", "") + (f" [{about['unit']}]" if about.get("unit") else ""),
        read_only=fixed,
        dynamic_typing=True,  # static typing would refuse `rate:=2` for a float
        additional_constraints=f"one of: {', '.join(about['choices'])}" if "choices" in about else "",
    )
    low, high = about.get("range", (-inf, inf))
    if isinstance(default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif isinstance(default, int) and not isinstance(default, bool):
        descriptor.integer_range = [IntegerRange(from_value=int(max(low, -WHOLE)), to_value=int(min(high, WHOLE)))]
    # An empty ROS array has no type: declare strings.
    start = (list(default) or [""]) if isinstance(default, tuple) else default
    try:
        return node.declare_parameter(name, start, descriptor).value
    except InvalidParameterValueException:
        raise ParameterError(f"parameter {name} must lie in {_range_text(about)}") from None  # rclpy omits the range


def _checked(name: str, value: Any, default: Any, about: Mapping[str, Any]) -> Any:
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple) and type(value).__name__ != "array":
            raise ParameterError(f"parameter {name} must be a list, got {value!r}")
        entries = tuple(value)
        return () if entries == ("",) else entries
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not type(default):
        raise ParameterError(f"parameter {name} must be of type {type(default).__name__}, got {value!r}")
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = about.get("range", (-inf, inf))
        if not low <= value <= high:
            raise ParameterError(f"parameter {name} must lie in {_range_text(about)}, got {value!r}")
    if "choices" in about and value not in about["choices"]:
        raise ParameterError(f"parameter {name} must be one of {', '.join(about['choices'])}, got {value!r}")
    return value


def _range_text(about: Mapping[str, Any]) -> str:
    low, high = about.get("range", (-inf, inf))
    unit = about.get("unit", "")
    return f"[{low:g}, {high:g}]{f' {unit}' if unit and unit != '-' else ''}"
