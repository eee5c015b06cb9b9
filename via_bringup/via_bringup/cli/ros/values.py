"""ROS messages to and from plain values, and those to and from YAML, as `ros2` writes them on its command line.

{equilibrium: 0.2, header: {stamp: now}}      members left out keep their defaults; 'now' is the present time
"""

from __future__ import annotations

import time
from typing import Any

import yaml
from builtin_interfaces.msg import Time
from rosidl_parser.definition import (
    FLOATING_POINT_TYPES,
    SIGNED_INTEGER_TYPES,
    AbstractGenericString,
    AbstractNestedType,
    Array,
    BoundedSequence,
    NamespacedType,
)
from via_core.errors import ParameterError
from via_core.wire import SECOND
from via_ros.interfaces import message_class

LONGEST = 128  # elements of a list that are shown


def filled(message: Any, text: str) -> Any:
    """The message with the values of a YAML mapping. Raises ParameterError, which names the member."""
    try:
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ParameterError(f"the values are not YAML: {' '.join(str(error).split())}") from None
    return _fill(message, {} if values is None else values, "")


def shown(message: Any, longest: int | None = LONGEST) -> str:
    """The message as YAML; lists end after `longest` elements."""
    text = yaml.safe_dump(plain(message, longest), sort_keys=False, default_flow_style=None, width=1000)
    return text.removesuffix("...\n")  # which ends a plain scalar


def plain(value: Any, longest: int | None = None) -> Any:
    """A message, or a member of one, as dictionaries, lists and scalars."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name), longest) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, str | bool | int | float):
        return value
    listed = [plain(each, longest) for each in (value.tolist() if hasattr(value, "tolist") else value)]
    return [*listed[:longest], "..."] if longest is not None and len(listed) > longest else listed


def member(message: Any, path: str) -> Any:
    """The member of a message at a path such as 'header.stamp' or 'position.0'. Raises ParameterError."""
    for name in path.split("."):
        try:
            message = message[int(name)] if name.isdigit() else getattr(message, name)
        except (AttributeError, IndexError, TypeError):
            members = message.get_fields_and_field_types() if hasattr(message, "get_fields_and_field_types") else ()
            raise ParameterError(f"no member '{name}'; there are: {', '.join(members) or 'none'}") from None
    return message


def _fill(message: Any, values: Any, where: str) -> Any:
    members = message.get_fields_and_field_types()
    if isinstance(message, Time) and values == "now":
        message.sec, message.nanosec = divmod(time.time_ns(), SECOND)
        return message
    if not isinstance(values, dict):
        raise ParameterError(f"{where or 'the values'}: must be a mapping such as {{{next(iter(members))}: ...}}")
    kinds = dict(zip(members, message.SLOT_TYPES, strict=False))
    for name, given in values.items():
        if name not in kinds:
            raise ParameterError(f"{where}no member '{name}'; there are: {', '.join(members)}")
        setattr(message, name, _value(kinds[name], given, f"{where}{name}"))
    return message


def _value(kind: Any, given: Any, where: str) -> Any:
    """The given value as rclpy expects it for a member of this type."""
    if isinstance(kind, NamespacedType):
        return _fill(message_class("/".join(kind.namespaced_name()))(), given, f"{where}: ")
    if isinstance(kind, AbstractNestedType):
        if not isinstance(given, list):
            raise ParameterError(f"{where}: must be a list, got {given!r}")
        if isinstance(kind, Array) and len(given) != kind.size:
            raise ParameterError(f"{where}: must have {kind.size} elements, got {len(given)}")
        if isinstance(kind, BoundedSequence) and len(given) > kind.maximum_size:
            raise ParameterError(f"{where}: may have {kind.maximum_size} elements, got {len(given)}")
        return [_value(kind.value_type, each, f"{where}.{at}") for at, each in enumerate(given)]
    if isinstance(kind, AbstractGenericString):
        if isinstance(given, dict | list) or given is None:
            raise ParameterError(f"{where}: must be text, got {given!r}")
        return str(given)
    return _number(kind.typename, given, where)


def _number(kind: str, given: Any, where: str) -> Any:
    if kind == "boolean":
        if not isinstance(given, bool):
            raise ParameterError(f"{where}: must be true or false, got {given!r}")
        return given
    floating = kind in FLOATING_POINT_TYPES
    try:
        number: Any = float(given) if floating else int(given)
        if isinstance(given, bool) or (not floating and isinstance(given, float) and number != given):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise ParameterError(f"{where}: must be {'a number' if floating else 'an integer'}, got {given!r}") from None
    if floating:
        return number
    bits = int(kind.removeprefix("u").removeprefix("int") or 8) if kind.startswith(("int", "uint")) else 8
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if kind in SIGNED_INTEGER_TYPES else (0, 2**bits - 1)
    if not low <= number <= high:
        raise ParameterError(f"{where}: must lie in [{low}, {high}], got {number}")
    return bytes([number]) if kind == "octet" else number
