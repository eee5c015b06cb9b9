"""Limits of what one untrusted file may cost: bytes, depth, counts, time and memory, for every loader.

They are far above what a robot writes, and far below what takes a machine down. A file beyond them is refused in one
line that names the limit.
"""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Limits:
    """Limits of one file."""

    text: int = 16 << 20  # characters of a text file
    yaml: int = 1 << 20  # characters of a YAML text
    depth: int = 64  # of nesting
    values: int = 100_000  # of a YAML text, those that aliases repeat included
    chunk: int = 256 << 20  # [bytes] of one chunk of a bag, uncompressed
    schemas: int = 512  # of a bag
    channels: int = 4096  # of a bag
    schema: int = 256 << 10  # [bytes] of the text of a schema
    members: int = 10_000  # of a message type, with those of nested types and of arrays of messages and texts
    matching: float = 1.0  # [s] for one file name and the pattern of a mapping
    samples: int = 5_000_000  # of one simulated log
    joints: int = 1024  # names in a JointState
    message: int = 1 << 18  # [bytes] of a JointState

    @property
    def bag(self) -> int:
        """[bytes] of a bag, uncompressed: half of this machine's memory."""
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


LIMITS = Limits()


def require_regular(path: str | Path) -> None:
    """Raise OSError unless `path` is a file with content of its own: reading from a pipe can wait without end."""
    kind = os.stat(path).st_mode
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):  # opening a folder fails by itself
        raise OSError("not a regular file")
