"""Effects planted in a case: the truths that are to be found, and the small unmodelled effect beside them (dirt)."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.random import Generator

from via_validation.sealed.bench import AgainError, Bench, Drawn, search
from via_validation.sealed.catalogue import Numbers
from via_validation.sealed.model import STEP
from via_validation.sealed.physics import Physics
from via_validation.sealed.unmodelled import UNMODELLED

NEAR = 0.12  # how close the search comes to the wanted gap, as a logarithm
DIRT = (0.05, 0.2)  # gap of the dirt over that of the effects


@dataclass(frozen=True)
class Truth:
    """One effect of a case as the key states it. Motor 0 at site motor: both motors alike."""

    effect: str
    site: str
    motor: int
    parameters: Numbers
    ratio: float  # gap over noise, of it alone
    beyond: float  # the same, after the joint's parameters were fitted inside their tolerance


@dataclass(frozen=True)
class Dirt:
    """A small effect outside the catalogue, beside those that are to be found."""

    effect: str
    site: str
    motor: int
    parameters: Numbers
    share: float  # of the effects' gap, as it was drawn


def plant(
    bench: Bench, each: Drawn, size: float, wrong: tuple[dict[str, float], float], reach: tuple[float, float]
) -> tuple[Physics, Truth]:
    """Physics of one effect, and its entry in the key. Raises AgainError where its gap is outside `reach`.

    wrong  relative errors of the nominal parameters, and their tolerance
    reach  range of the gap over noise
    """
    alone, numbers = each.of_size(bench.scene, size)
    run = bench.run(alone, STEP)
    if run is None or max(map(abs, numbers.values())) > each.entry.most:
        raise AgainError
    there = bench.ratio(alone, run)
    if not reach[0] <= there <= reach[1]:
        raise AgainError
    beyond = bench.beyond(alone, run, *wrong)
    if beyond < reach[0]:
        raise AgainError
    return alone, Truth(each.entry.name, *each.place, _rounded(numbers), round(there, 3), round(beyond, 3))


def with_dirt(rng: Generator, bench: Bench, physics: Physics, ratio: float) -> tuple[Physics, Dirt]:
    """A small unmodelled effect beside the others; its gap is a share DIRT of theirs.

    A gap below the noise cannot be measured. The size is therefore searched for at which the gap equals theirs, and
    scaled down from there, since these gaps grow about in proportion to the size. Encoder skips do not: left out.
    """
    names = [name for name, entry in UNMODELLED.items() if entry.places(bench.device) and name != "skipping_encoder"]
    entry = UNMODELLED[str(rng.choice(names))]
    places = entry.places(bench.device)
    each = Drawn(entry, places[int(rng.integers(len(places)))], entry.shape(rng, bench.scene))
    size, found = search(bench, each, ratio, 3.0 * NEAR)
    if not 1.05 < found < inf:
        raise AgainError
    share = float(rng.uniform(*DIRT))
    small = size * share * float(np.sqrt((ratio**2 - 1.0) / (found**2 - 1.0)))
    alone, numbers = each.of_size(bench.scene, small)
    try:
        return physics.joined(alone), Dirt(entry.name, *each.place, _rounded(numbers), round(share, 3))
    except ValueError:
        raise AgainError from None


def _rounded(numbers: Numbers) -> Numbers:
    return {name: float(f"{value:.9g}") for name, value in numbers.items()}
