"""Dahl's bristle: friction that is elastic at first."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Form, Slot
from via_sim.catalogue.starts import sliding

SLIP = Form(
    "torque / stiffness", "rad", ("torque", "stiffness"), lambda t, k: t / k, lambda t, k: (1.0 / k, -t / k**2)
)  # fmt: skip
KIND = EffectKind(
    name="presliding_friction",
    text="Dahl's bristle: friction that builds up with the travel since the last reversal, elastic at first",
    term="-F, dF/dx = stiffness (1 - F s/torque)",
    confused_with="backlash, spring_law: micro-reversals, width of the loop over its amplitude",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter("torque", "N m", 0.0, 1e6, 0.0, "friction when sliding", slot="bristle_torque"),
        EffectParameter(
            "stiffness", "N m/rad", 1e-2, 1e6, 1e2, "stiffness of the bristle at rest", slot="bristle_stiffness"
        ),
    ),
    slots=(
        Slot("bristle_torque", "N m", "friction of Dahl's bristle when sliding", 3),
        Slot("bristle_stiffness", "N m/rad", "stiffness of Dahl's bristle at rest", 3, 1.0),
    ),
    starts=sliding(lambda here: [share * here.angle for share in (0.01, 0.05, 0.2)]),
    forms=(SLIP,),
    contains=("coulomb_friction", (0,)),
    dry=True,
)
