"""One setting of Fast DDS that our nodes cannot do without; whoever has an own profile file keeps it.

A reliable reader that joins a topic with more than 5000 messages behind it takes none of the next ones until the
writer's history has turned over: at 1 kHz and a history of 1000, a recorder that starts late loses its first second.
The limit of 5000 is the reader's default `max_samples`; without one (0) every message arrives. Measured with Fast DDS
2.14, within a process and across, over shared memory and UDP; test_ros_middleware shows it.
"""

from __future__ import annotations

import os
from importlib.resources import files

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"


def prepare() -> None:
    """Point Fast DDS at our profile; before the first context of the process is initialised."""
    os.environ.setdefault(PROFILE, str(files("via_ros").joinpath("fastdds.xml")))
