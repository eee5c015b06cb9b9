"""Diagnostics of nodes on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue


def status_of(name: str, device: str, conditions: Mapping[str, bool], values: Mapping[str, Any]) -> DiagnosticStatus:
    """A status that warns of every condition (text: whether it applies), with values by name.

    device  name of the device or arm that the status is about
    """
    warnings = [text for text, applies in conditions.items() if applies]
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if warnings else DiagnosticStatus.OK,
        name=name,
        message=", ".join(warnings) or "running",
        hardware_id=device,
        values=pairs(values),
    )


def pairs(values: Mapping[str, Any]) -> list[KeyValue]:
    """The values of a status by name, as texts."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def report(node: Any, publisher: Any, statuses: Sequence[DiagnosticStatus]) -> None:
    """Publish statuses of `node`, stamped with its time."""
    array = DiagnosticArray(status=list(statuses))
    array.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(array)
