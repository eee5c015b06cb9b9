"""Environment of the middleware: discovery on this host only, UDP, unlimited readers, frequent heartbeats, few events.

Discovery: ROS 2 looks for nodes in the whole subnet by default, so that another machine could command a robot. Here it
is limited to this host: sockets listen on the loopback interface only, and no multicast is sent.
ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET opens it. A profile file that the user has set has priority.

UDP: the shared memory transport of Fast DDS waits up to a second for a reader whose process was killed, and publishing
waits with it; a killed process also leaves its segments in /dev/shm. UDP is not slower for small messages. For
LOCALHOST, rmw_fastrtps adds a UDP transport on all interfaces and shared memory to those of the profile, for any
environment. The profile fastdds_localhost.xml therefore states the limit itself (loopback addresses, peers on this
host), and the range SYSTEM_DEFAULT makes rmw_fastrtps add nothing. Child processes inherit both.

Readers: a reliable reader that joins a topic after more than 5000 messages receives nothing until the writer's history
has been replaced: at 1 kHz and a history of 1000, a late recorder loses its first second. 5000 is the reader's default
`max_samples`; with 0 (no limit) every message arrives. Measured with Fast DDS 2.14, within and between processes, over
shared memory and UDP; see test_ros_middleware.

Heartbeats: a reader requests lost messages when the writer's next heartbeat comes, by default every 3 s. After a pause
of its process, such as a second of swapping, the history of a writer at 1 kHz has been replaced by then. Every 100 ms
here.

Events: a writer ignores requests for a message that it has just sent (`nackSupressionDuration`). By default this ends
at once, by an event in another thread after every message: a third of the processor time of a node that publishes
32 000 messages a second, half of it in locks that the two threads share. Here one event ends it after 20 ms for all
messages of that time. A lost message is requested at the next heartbeat, or at the one after it.
"""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE, LOCAL, PROFILE_DECIDES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "SYSTEM_DEFAULT"
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"


def prepare() -> None:
    """Set what the user has not set; call before the first context of the process is initialised."""
    discovery = os.environ.setdefault(RANGE, LOCAL)
    if not get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        return
    os.environ.setdefault(TRANSPORTS, "UDPv4")
    # Resolved, since a process and its children may import the package from a source folder and from its installation.
    opened, local = (
        str(Path(str(files("via_ros"))).resolve() / name) for name in ("fastdds.xml", "fastdds_localhost.xml")
    )
    given = os.environ.get(PROFILE)
    if given not in (None, opened, local):
        return
    if discovery == LOCAL or (discovery == PROFILE_DECIDES and given == local):
        os.environ.update({PROFILE: local, RANGE: PROFILE_DECIDES})
    else:
        os.environ[PROFILE] = opened
