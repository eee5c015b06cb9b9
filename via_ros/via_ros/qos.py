"""Qualities of service by name, so that no depth is pasted about; and their translation from and to bags."""

from __future__ import annotations

from typing import Any

import yaml
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from via_core.bags.writer import OfferedQos

# Commands and answers: nothing is lost while a reader is less than ten messages behind.
CONTROL = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
# Streams of samples and estimates: a reader may fall a second behind at 1 kHz.
SAMPLES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
MOST = 100_000  # messages
# Configuration that late joiners must still get.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def samples_of(devices: int) -> QoSProfile:
    """SAMPLES for a topic on which so many devices send messages of their own: a second of each."""
    return matching([], depth=min(SAMPLES.depth * devices, MOST))


_RELIABILITY = {"reliable": ReliabilityPolicy.RELIABLE, "best_effort": ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"volatile": DurabilityPolicy.VOLATILE, "transient_local": DurabilityPolicy.TRANSIENT_LOCAL}


def matching(offers: list[QoSProfile], depth: int = SAMPLES.depth) -> QoSProfile:
    """The strongest profile that hears every one of `offers`; that of SAMPLES when there are none."""
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = bool(offers) and all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def as_offered(profile: QoSProfile) -> OfferedQos:
    """What a bag keeps of a profile. Discovery does not tell history and depth: those of CONTROL stand in."""
    known = profile.history in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL)
    return OfferedQos(
        reliability="reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best_effort",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        history="keep_all" if profile.history == HistoryPolicy.KEEP_ALL else "keep_last" if known else "unknown",
        depth=profile.depth if known else 0,
    )


def from_bag(text: str) -> QoSProfile:
    """The profile to offer again for `offered_qos_profiles` of a bag; unknown words fall back to those of SAMPLES.

    The depth is never below that of SAMPLES: a player is faster than the robot was. Nor is it above MOST: some
    recorders write "unknown" or "unlimited" as the largest number they know.
    """
    try:
        entries: Any = yaml.safe_load(text) or []
    except (yaml.YAMLError, ValueError):
        entries = []
    first = entries[0] if isinstance(entries, list) and entries and isinstance(entries[0], dict) else {}
    depth = first.get("depth")
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=min(max(depth if isinstance(depth, int) else 0, SAMPLES.depth), MOST),
        reliability=_RELIABILITY.get(str(first.get("reliability")), SAMPLES.reliability),
        durability=_DURABILITY.get(str(first.get("durability")), SAMPLES.durability),
    )
