"""Torque from the angle of a neighbour joint."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one, tenth

KIND = EffectKind(
    name="joint_coupling",
    text="torque from the angle of a neighbour joint (channel `neighbour`): on the link, or between link and motor",
    term="stiffness neighbour",
    confused_with="external_torque: other motion of the neighbour",
    sites=("transmission", "link"),
    parameters=(
        EffectParameter(
            "stiffness", "N m/rad", -1e6, 1e6, 0.0, "torque per angle of the neighbour", True, slot="coupling"
        ),
    ),
    slots=(
        Slot("coupling", "N m/rad", "torque per angle of the neighbour: on the link; between link and motors", 3),
    ),
    starts=one(stiffness=tenth),
    channel="neighbour",
)  # fmt: skip
