"""Error of the spring law."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import each

KIND = EffectKind(
    name="spring_law",
    text="error of the spring law: its scale, and hardening (or softening) with the squared deflection",
    term="scale (1 + hardening phi^2) tau_e(phi)",
    confused_with="hysteresis: loading against unloading",
    sites=("transmission",),
    parameters=(
        EffectParameter("scale", "-", 0.1, 10.0, 1.0, "torque relative to the spring law", True, slot="spring_scale"),
        EffectParameter(
            "hardening", "1/rad^2", -1e3, 1e3, 0.0, "relative increase per squared deflection", True,
            slot="spring_hardening",
        ),
    ),
    slots=(
        Slot("spring_scale", "-", "torque relative to the spring law", 2, 1.0),
        Slot("spring_hardening", "1/rad^2", "relative increase of torque per squared deflection", 2),
    ),
    starts=each(scale=lambda _here: 1.1, hardening=lambda here: 0.1 / here.stretch**2),
)  # fmt: skip
