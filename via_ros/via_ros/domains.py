"""ROS domains that nobody else on this machine is in: whoever holds a domain's port has the domain."""

from __future__ import annotations

import socket
from types import TracebackType

from via_core.errors import ViaError

DOMAINS = range(1, 100)  # above 101 the ports of DDS may be those of other connections; 0 is where robots are
FIRST_PORT = 17400  # of the domain number 0, for the reservation only


class Domain:
    """A reserved domain; use it in a `with` statement, or call `release` when its nodes are gone.

    Raises ViaError when all are taken.
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
        """Give the domain back."""
        self._holder.close()

    def __enter__(self) -> Domain:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
