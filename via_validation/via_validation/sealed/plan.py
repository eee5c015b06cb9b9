"""Kind, signal set and effect of the case of a seed. Seeds form blocks of the same mixture, each in a random order.

A block contains each named effect once with all signals and every second one with fewer, controlled motors, position
drives, effects on both motors, joints without a gap, unmodelled effects outside the catalogue, and pairs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from via_validation.sealed.catalogue import CATALOGUE, Entry
from via_validation.sealed.joints import CONTROLLED, FAMILIES, PAIRS, POSITIONED
from via_validation.sealed.recording import LEVELS
from via_validation.sealed.selections import OF_BOTH, OF_CONTROL, OF_POSITION
from via_validation.sealed.unmodelled import UNMODELLED

KINDS = ("single", "no_gap", "unknown", "pair")
FULL, LIMITED, LAST = LEVELS[0], LEVELS[1:], LEVELS[-1]
BOTH_ALIKE, CONTROLS = 4, 5  # per block
NO_GAP, UNKNOWN, PAIR = (6, 6), (5, 3), (5, 3)  # per block, with all signals and with fewer
BLOCK = (
    len(CATALOGUE)
    + len(CATALOGUE) // 2
    + BOTH_ALIKE
    + CONTROLS
    + 1
    + len(OF_POSITION)
    + 3
    + sum((*NO_GAP, *UNKNOWN, *PAIR))
)


@dataclass(frozen=True)
class Plan:
    """Specification of a case; an empty effect or family is drawn at random."""

    kind: str
    level: str
    effect: str = ""
    family: str = ""
    both: bool = False  # the effect acts on both motors

    def families(self) -> list[str]:
        """Families whose logs contain the signals that the signal set leaves out."""
        if self.both:
            return list(PAIRS)
        without = {"full": (), "encoder_and_command": ("rigid",)}.get(self.level, ("rigid", "variable_damping"))
        return [each for each in FAMILIES if each not in without]

    def entries(self, rng: Generator, family: str) -> list[Entry]:
        """The effects of the case; effects of a pair are drawn."""
        if self.kind == "no_gap":
            return []
        if self.kind == "unknown":
            return [UNMODELLED[self.effect]]
        if self.kind == "pair":
            return [CATALOGUE[str(name)] for name in rng.choice(list(CATALOGUE), size=2, replace=False)]
        return [{POSITIONED: OF_POSITION, CONTROLLED: OF_CONTROL}.get(family, CATALOGUE)[self.effect]]


def plan(seed: int) -> Plan:
    """The plan of the case of a seed."""
    block, place = divmod(seed, BLOCK)
    return block_of(block)[int(np.random.default_rng([block, BLOCK]).permutation(BLOCK)[place])]


def block_of(block: int) -> list[Plan]:
    """The BLOCK plans of a block, in order of their kinds."""
    names, unmodelled = list(CATALOGUE), list(UNMODELLED)
    plans = [Plan("single", FULL, name) for name in names]
    # Every second name, from another one in each block, so that an odd number of names also takes turns.
    halves = [names[(block + 2 * k) % len(names)] for k in range(len(names) // 2)]
    plans += [Plan("single", LIMITED[(block + k) % len(LIMITED)], name) for k, name in enumerate(halves)]
    plans += [
        Plan("single", FULL, OF_BOTH[(block * BOTH_ALIKE + k) % len(OF_BOTH)], both=True) for k in range(BOTH_ALIKE)
    ]
    others = [name for name in OF_CONTROL if name != "torque_ripple"]
    slow = ["torque_ripple"] * (CONTROLS - 2) + [others[(block * 2 + k) % len(others)] for k in range(2)]
    plans += [*(Plan("single", FULL, name, CONTROLLED) for name in slow), Plan("no_gap", FULL, "", CONTROLLED)]
    plans += [Plan("single", LAST, name, POSITIONED) for name in OF_POSITION]
    plans += [Plan("no_gap", LAST, "", POSITIONED)] * 2 + [Plan("unknown", LAST, "textured_friction", POSITIONED)]
    for kind, (all_signals, fewer) in {"no_gap": NO_GAP, "unknown": UNKNOWN, "pair": PAIR}.items():
        levels = [FULL] * all_signals + [LIMITED[(block + k) % len(LIMITED)] for k in range(fewer)]
        made = [Plan(kind, level) for level in levels]
        if kind == "unknown":
            first = block * len(made)
            made = [replace(each, effect=unmodelled[(first + k) % len(unmodelled)]) for k, each in enumerate(made)]
        plans += made
    return plans
