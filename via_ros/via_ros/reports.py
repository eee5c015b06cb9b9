"""Diagnostics of nodes on /diagnostics, in the form that the standard tools of ROS expect.

Tools recognise a status by its name. It is therefore constant, `<node>: <device>` or `<node>: <device> <part>`, with
the namespace of the node; what changes, such as a mode, is in its message and values. A status warns of an event for
RECENT, and of a condition as long as it lasts; the values count all events.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from math import inf
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

RECENT = 10.0  # [s] after an event for which a status warns of it


def status_name(node: Any, subject: str) -> str:
    """The name of the status of `node` about a device, a part of it, or a topic."""
    return f"{node.get_fully_qualified_name().lstrip('/')}: {subject}"


class StatusReport:
    """One status of `node` about a device or arm, or about a part of it."""

    def __init__(self, node: Any, device: str, part: str = "") -> None:
        self.name = status_name(node, f"{device} {part}" if part else device)
        self.device = device
        self._counts: dict[str, int] = {}
        self._latest: dict[str, float] = {}  # [s] steady clock at the last event

    def status(
        self, conditions: Mapping[str, bool], events: Mapping[str, int], values: Mapping[str, Any], good: str
    ) -> DiagnosticStatus:
        """The present status.

        conditions  texts, and whether each applies
        events      texts, and the number of such events since the node began
        good        message without a warning
        """
        now = time.monotonic()
        latest = {text: now for text, count in events.items() if count > self._counts.get(text, 0)}
        # A text may hold the reason of the last event: only the present texts are remembered.
        self._latest = {text: latest.get(text, self._latest.get(text, -inf)) for text in events}
        self._counts = dict(events)
        warnings = [text for text, applies in conditions.items() if applies]
        warnings += [text for text, last in self._latest.items() if now - last < RECENT]
        return DiagnosticStatus(
            level=DiagnosticStatus.WARN if warnings else DiagnosticStatus.OK,
            name=self.name,
            message=", ".join(warnings) or good,
            hardware_id=self.device,
            values=pairs(values),
        )


def pairs(values: Mapping[str, Any]) -> list[KeyValue]:
    """The values of a status by name, as texts."""
    return [
        KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
        for key, value in values.items()
    ]


def report(node: Any, publisher: Any, statuses: Sequence[DiagnosticStatus]) -> None:
    """Publish statuses of `node`, stamped with its time."""
    array = DiagnosticArray(status=list(statuses))
    array.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(array)
