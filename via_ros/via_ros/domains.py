"""Reservation of ROS domain numbers on this machine: one TCP port per domain."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from via_core.errors import ViaError

DOMAINS = range(1, 100)  # above 101 DDS ports may be ephemeral ports; 0 is the default of robots
FIRST_PORT = 17400  # reservation port of domain 0


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Number of a domain that is reserved inside the `with` statement. Raises ViaError when all are."""
    for number in DOMAINS:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as holder:
            try:
                holder.bind(("127.0.0.1", FIRST_PORT + number))
            except OSError:
                continue
            yield number
            return
    raise ViaError(f"all {len(DOMAINS)} ROS domains are reserved by other processes of this machine")
