"""Which answers are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NUMBERED = ("motor", "transmission")  # sites whose number counts from 1; at a motor 0 means both alike
READINGS = ("sensor", "timing")  # sites whose number 0 is the link
ANSWERS = ("effect", "several_effects", "main_effect")  # verdicts that name a cause
FORMER = {"two_effects": "several_effects"}  # verdict of older reports -> its name today
ONE_BODY = ("rigid", "controlled_motor", "position_drive")  # families whose drive acts on the link itself
PAIRED = ("polynomial_pair", "exponential_pair")  # families with two motors, each with an encoder and a spring
MOST_TIED = 3  # a set of more causes than this separates nothing


@dataclass(frozen=True)
class Place:
    """An effect at a site; motor 0 at site motor: both motors alike; in an answer also: no number given."""

    effect: str
    site: str
    motor: int

    def __str__(self) -> str:
        both = " of both motors" if self.site == "motor" and self.motor == 0 else ""
        return f"{self.effect} at {self.site}{f' {self.motor}' if self.motor else both}"


def explanations(truth: Place, family: str) -> tuple[tuple[Place, ...], ...]:
    """Every answer that is right for `truth`: alternatives, each the causes that must be named together.

    An answer is right if it describes the same physics, under whichever name:

    - The truth itself.
    - An effect on both motors alike (motor 0) is also the same effect at motor 1 and at motor 2, both named.
    - A payload m at l adds m l^2 to the inertia and m g l to the gravity torque: link_inertia and gravity_error, both
      named. Neither of them alone is a payload.
    - With two motors, an offset in the reading of motor i is a shift of the rest angle of spring i: nothing else in the
      joint depends on the motor's angle. encoder_offset at sensor i and preset_error at transmission i are one cause.
    - Where the drive acts on the link itself, an offset of its encoder is a turn of the direction of gravity:
      encoder_offset at sensor 0 and gravity_error are one cause.

    Causes that a log cannot separate but that are different physics (Coulomb and Stribeck friction without slow motion)
    do not count as one another: a report should tie them, and `in_set` counts that.
    """
    found: list[tuple[Place, ...]] = [(truth,)]
    if (truth.site, truth.motor) == ("motor", 0):
        found.append((Place(truth.effect, "motor", 1), Place(truth.effect, "motor", 2)))
    if truth.effect == "payload":
        found.append((Place("link_inertia", "link", 0), Place("gravity_error", "link", 0)))
    if family in PAIRED and truth.motor:
        if (truth.effect, truth.site) == ("encoder_offset", "sensor"):
            found.append((Place("preset_error", "transmission", truth.motor),))
        if truth.effect == "preset_error":
            found.append((Place("encoder_offset", "sensor", truth.motor),))
    if family in ONE_BODY and truth.effect == "encoder_offset":
        found.append((Place("gravity_error", "link", 0),))
    return tuple(found)


def same_site(where: tuple[str, int], truth: Place, family: str) -> bool:
    """Whether `where` (site, number) is the place of the truth.

    A number counts where the site has one and the answer gives one. Where the drive acts on the link itself, motor 1
    and link are one body with one equation.
    """
    site, number = where
    if family in ONE_BODY and {site, truth.site} == {"motor", "link"}:
        return True
    if site != truth.site:
        return False
    if site in NUMBERED and 0 in (number, truth.motor):
        return True  # no number given, or both motors alike
    return number == truth.motor or site not in (*NUMBERED, *READINGS)


def names(cause: Place, truth: Place, family: str, others: Sequence[Place] = ()) -> bool:
    """Whether `cause` names the truth: its effect at any place, or another explanation whose causes are all named.

    others  the causes that the answer names beside it
    """
    if cause.effect == truth.effect:
        return True
    there = (cause, *others)
    return any(
        any(_is(cause, part) for part in parts) and all(any(_is(each, part) for each in there) for part in parts)
        for parts in explanations(truth, family)[1:]
    )


def places(causes: Sequence[Place], truth: Place, family: str) -> bool:
    """Whether the first cause names the truth at its place; of both motors alike, whether both are covered."""
    first = causes[0]
    if first.effect == truth.effect:
        if (truth.site, truth.motor) == ("motor", 0):
            covered = {each.motor for each in causes if each.effect == truth.effect and each.site == "motor"}
            return 0 in covered or {1, 2} <= covered
        alone = family in ONE_BODY or not _at_both(first, truth)
        return alone and same_site((first.site, first.motor), truth, family)
    return names(first, truth, family, causes[1:])


def covered(truths: Sequence[Place], causes: Sequence[Place], family: str) -> bool:
    """Whether the named causes explain every truth, and no cause is there that explains none."""
    every = all(any(names(cause, truth, family, causes) for cause in causes) for truth in truths)
    return every and all(any(names(cause, truth, family, causes) for truth in truths) for cause in causes)


def _at_both(first: Place, truth: Place) -> bool:
    """Whether the answer blames both motors for the effect of one."""
    return first.site == "motor" and first.motor == 0 and truth.motor > 0 and truth.site == "motor"


def _is(cause: Place, part: Place) -> bool:
    return (cause.effect, cause.site) == (part.effect, part.site) and cause.motor in (part.motor, 0)
