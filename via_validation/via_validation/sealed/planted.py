"""Effects of a case: the truths to be found, and a small unmodelled effect in addition (dirt)."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.random import Generator

from via_validation.sealed.catalogue import Numbers
from via_validation.sealed.experiment import DrawnEffect, Experiment, RejectedError, search
from via_validation.sealed.model import STEP
from via_validation.sealed.physics import Physics
from via_validation.sealed.unmodelled import UNMODELLED

NEAR = 0.12  # tolerance of the search for the wanted gap, as a logarithm
DIRT = (0.05, 0.2)  # range of the dirt's gap over the effects' gap


@dataclass(frozen=True)
class Truth:
    """One effect of a case as stated in the key. Motor 0 at site motor: the same effect on both motors."""

    effect: str
    site: str
    motor: int
    parameters: Numbers
    ratio: float  # gap over noise of this effect alone
    beyond: float  # gap over noise after a fit of the joint's parameters within their tolerance


@dataclass(frozen=True)
class Dirt:
    """A small effect outside the catalogue in addition to the effects to be found."""

    effect: str
    site: str
    motor: int
    parameters: Numbers
    share: float  # drawn fraction of the effects' gap


def plant(
    experiment: Experiment,
    each: DrawnEffect,
    size: float,
    errors: tuple[dict[str, float], float],
    accepted: tuple[float, float],
) -> tuple[Physics, Truth]:
    """Physics of one effect, and its entry in the key. Raises RejectedError if its gap is outside `accepted`.

    errors    relative errors of the nominal parameters, and their tolerance
    accepted  range of the gap over noise
    """
    alone, numbers = each.of_size(experiment.scene, size)
    run = experiment.run(alone, STEP)
    if run is None or max(map(abs, numbers.values())) > each.entry.most:
        raise RejectedError
    ratio = experiment.ratio(alone, run)
    if not accepted[0] <= ratio <= accepted[1]:
        raise RejectedError
    beyond = experiment.ratio_after_fit(alone, run, *errors)
    if beyond < accepted[0]:
        raise RejectedError
    return alone, Truth(each.entry.name, *each.location, _rounded(numbers), round(ratio, 3), round(beyond, 3))


def with_dirt(rng: Generator, experiment: Experiment, physics: Physics, ratio: float) -> tuple[Physics, Dirt]:
    """`physics` with a small unmodelled effect added, whose gap is a fraction DIRT of the gap `ratio` of the others.

    A gap below the noise cannot be measured. The search therefore finds the size at which the gap equals `ratio`, and
    scales it down, since these gaps grow about in proportion to the size. Encoder slips do not and are left out.
    """
    names = [
        name for name, entry in UNMODELLED.items() if entry.locations(experiment.device) and name != "skipping_encoder"
    ]
    entry = UNMODELLED[str(rng.choice(names))]
    locations = entry.locations(experiment.device)
    each = DrawnEffect(entry, locations[int(rng.integers(len(locations)))], entry.shape(rng, experiment.scene))
    size, found = search(experiment, each, ratio, 3.0 * NEAR)
    if not 1.05 < found < inf:
        raise RejectedError
    share = float(rng.uniform(*DIRT))
    small = size * share * float(np.sqrt((ratio**2 - 1.0) / (found**2 - 1.0)))
    alone, numbers = each.of_size(experiment.scene, small)
    try:
        return physics.joined(alone), Dirt(entry.name, *each.location, _rounded(numbers), round(share, 3))
    except ValueError:
        raise RejectedError from None


def _rounded(numbers: Numbers) -> Numbers:
    return {name: float(f"{value:.9g}") for name, value in numbers.items()}
