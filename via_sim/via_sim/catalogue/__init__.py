"""The catalogue of effects: one file per effect defines all that is particular to it, see `kinds.EffectKind`.

A new effect is one file in the folder of its site, and its name in the list of that folder.
"""

from __future__ import annotations

from via_sim.catalogue import drive, friction, link, sensor, transmission
from via_sim.catalogue.kinds import EffectKind

# A package of its own may add a kind without slots and terms of its own: EFFECTS[kind.name] = kind. Simulator, effects
# files and diagnosis then use it.
EFFECTS: dict[str, EffectKind] = {
    kind.name: kind for group in (friction, transmission, drive, sensor, link) for kind in group.KINDS
}
