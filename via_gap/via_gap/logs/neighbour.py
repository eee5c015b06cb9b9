"""Angle of the neighbour joint in a bag, an input of the joint through coupling."""

from __future__ import annotations

import numpy as np
from via_core.bags.joints import joint_signals
from via_core.bags.reader import Bag
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.signals import Signals

LINK = "_shaft_joint"  # suffix of link names, which motor names do not have


def with_neighbour(commands: Signals, bag: Bag, device: Device, joint_topic: str) -> Signals:
    """The commands with the angle [rad] of the neighbour as channel `neighbour`; unchanged if there is none.

    The neighbour is the only other link in the joint states; with several others it is not known.
    """
    names = {name for names in bag[joint_topic]["name"].tolist() for name in names}
    own = {device.link_joint, *device.drive_joints}
    others = [name for name in names - own if name.endswith(LINK)]
    if len(others) != 1:
        return commands
    wire = device.wire.model_copy(update={"link": others[0]})
    try:
        other, _, _ = joint_signals(bag, device.model_copy(update={"wire": wire}), joint_topic)
    except ViaError:
        return commands
    seen = np.isfinite(other["q"]) if "q" in other else np.zeros(0, dtype=np.bool_)
    if seen.sum() < 2:
        return commands
    angle = np.interp(commands.time, other.time[seen], other["q"][seen])
    return commands.joined(Signals(commands.time, {"neighbour": angle}, {"neighbour": "rad"}, frozenset({"neighbour"})))
