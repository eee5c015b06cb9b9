"""Reservation of ROS domain numbers on this machine: one TCP port per domain."""

from __future__ import annotations

import socket
from types import TracebackType

from via_core.errors import ViaError

DOMAINS = range(1, 100)  # above 101 DDS ports may be ephemeral ports; 0 is the default of robots
FIRST_PORT = 17400  # reservation port of domain 0


class Domain:
    """A reserved domain: use it in a `with` statement, or call `release` after its nodes.

    Raises ViaError when all are reserved.
    """

    def __init__(self) -> None:
        for number in DOMAINS:
            holder = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                holder.bind(("127.0.0.1", FIRST_PORT + number))
            except OSError:
                holder.close()
                continue
            self.number, self._holder = number, holder
            return
        raise ViaError(f"all {len(DOMAINS)} ROS domains are reserved by other processes of this machine")

    def release(self) -> None:
        """Release the domain."""
        self._holder.close()

    def __enter__(self) -> Domain:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
