"""Named QoS profiles, and their conversion from and to bags."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from via_core.bags.writer import OfferedQos

# The other policies are rclpy's defaults: keep last, reliable, volatile.
CONTROL = QoSProfile(depth=10)  # commands and responses: a reader may be ten messages behind without loss
LOOP = QoSProfile(depth=200)  # of a loop, in a controller or robot: 0.2 s at 1 kHz, twice what a simulator catches up
SAMPLES = QoSProfile(depth=1000)  # samples and estimates: a reader may be one second behind at 1 kHz
MAX_DEPTH = 100_000  # [-] messages


def samples_of(devices: int) -> QoSProfile:
    """SAMPLES for a topic with messages of so many devices: one second of each."""
    return matching([], depth=min(SAMPLES.depth * devices, MAX_DEPTH))


_RELIABILITY = {"reliable": ReliabilityPolicy.RELIABLE, "best_effort": ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"volatile": DurabilityPolicy.VOLATILE, "transient_local": DurabilityPolicy.TRANSIENT_LOCAL}


def matching(offers: list[QoSProfile], depth: int = SAMPLES.depth) -> QoSProfile:
    """The strictest profile compatible with all `offers`; the policies of SAMPLES without offers."""
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    transient = bool(offers) and all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
    )


def as_offered(profile: QoSProfile) -> OfferedQos:
    """The profile as stored in a bag; unknown history, as from discovery, is stored with depth 0."""
    known = profile.history in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL)
    return OfferedQos(
        reliability="reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best_effort",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        history="keep_all" if profile.history == HistoryPolicy.KEEP_ALL else "keep_last" if known else "unknown",
        depth=profile.depth if known else 0,
    )


def from_bag(text: str) -> QoSProfile:
    """The profile to offer for `offered_qos_profiles` of a bag; unknown policies become those of SAMPLES.

    The depth is at least that of SAMPLES, since a player can be faster than the robot, and at most MAX_DEPTH, since
    some recorders write "unlimited" as the largest integer.
    """
    first = OfferedQos.from_rosbag2(text)[0]
    return QoSProfile(
        depth=min(max(first.depth, SAMPLES.depth), MAX_DEPTH),
        reliability=_RELIABILITY.get(first.reliability, SAMPLES.reliability),
        durability=_DURABILITY.get(first.durability, SAMPLES.durability),
    )
