"""Environment of the middleware: discovery on this host only, UDP, unlimited readers, and frequent heartbeats.

Discovery: ROS 2 looks for nodes in the whole subnet by default, so that another machine could command a robot. Here it
is limited to this host, and sockets listen on the loopback interface only. ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET opens
it. A value or a profile file that the user has set has priority.

UDP: the shared memory transport of Fast DDS waits up to a second for a reader whose process was killed, and publishing
waits with it. UDP is not slower for small messages.

Readers: a reliable reader that joins a topic after more than 5000 messages receives nothing until the writer's history
has been replaced: at 1 kHz and a history of 1000, a late recorder loses its first second. 5000 is the reader's default
`max_samples`; with 0 (no limit) every message arrives. Measured with Fast DDS 2.14, within and between processes, over
shared memory and UDP; see test_ros_middleware.

Heartbeats: a reader asks for lost messages when the writer's next heartbeat comes, by default every 3 s. After a pause
of its process, such as a second of swapping, the history of a writer at 1 kHz has been replaced by then. Every 100 ms
here.
"""

from __future__ import annotations

import os
from importlib.resources import files

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE, LOCAL = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"


def prepare() -> None:
    """Set what is not set yet; call before the first context of the process is initialised."""
    discovery = os.environ.setdefault(RANGE, LOCAL)
    os.environ.setdefault(TRANSPORTS, "UDPv4")
    profile = "fastdds_localhost.xml" if discovery == LOCAL else "fastdds.xml"
    os.environ.setdefault(PROFILE, str(files("via_ros").joinpath(profile)))
