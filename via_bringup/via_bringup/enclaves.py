"""Names of the SROS2 enclaves: the identity under which a process joins a secured graph, one per executable."""

from __future__ import annotations

COMMANDS = "cli"  # the enclave of `via topic`, `via watch` and the other commands that join the graph


def enclave_arguments(executable: str) -> list[str]:
    """ROS arguments that select the enclave of an executable of VIA; without security they have no effect."""
    return ["--enclave", f"/via/{executable}"]
