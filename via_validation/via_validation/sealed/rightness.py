"""Definition of a right answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NUMBERED = ("motor", "transmission")  # sites numbered from 1; motor 0 means both motors
MEASUREMENTS = ("sensor", "timing")  # sites where number 0 is the link
ANSWERS = ("effect", "several_effects", "main_effect")  # verdicts that name a cause
FORMER = {"two_effects": "several_effects"}  # verdict in older reports -> its present name
ONE_BODY = ("rigid", "controlled_motor", "position_drive")  # families whose drive acts on the link itself
PAIRED = ("polynomial_pair", "exponential_pair")  # families with two motors, each with an encoder and a spring
MOST_TIED = 3  # an equivalence set of more causes does not count as an answer


@dataclass(frozen=True)
class Cause:
    """An effect at a site. Motor 0 at site motor: both motors, or in an answer that no number is given."""

    effect: str
    site: str
    motor: int

    def __str__(self) -> str:
        both = " of both motors" if self.site == "motor" and self.motor == 0 else ""
        return f"{self.effect} at {self.site}{f' {self.motor}' if self.motor else both}"


def explanations(truth: Cause, family: str) -> tuple[tuple[Cause, ...], ...]:
    """All right answers for `truth`: alternatives, each a set of causes that must be named together.

    An answer is right if it describes the same physics, whatever its name:

    - The truth itself.
    - An effect on both motors (motor 0) equals the same effect at motor 1 and at motor 2, both named.
    - A payload m at l adds m l^2 to the inertia and m g l to the gravity torque: it equals link_inertia and
      gravity_error, both named. Neither of them alone is a payload.
    - With two motors, an encoder offset at motor i shifts the rest angle of spring i, since nothing else in the joint
      depends on the motor's angle: encoder_offset at sensor i and preset_error at transmission i are the same cause.
    - If the drive acts on the link itself, an offset of its encoder turns the direction of gravity: encoder_offset at
      sensor 0 and gravity_error are the same cause.

    Different physics that a log cannot separate (Coulomb and Stribeck friction without slow motion) are different
    causes: a report should put them into one equivalence set, and `in_set` counts that.
    """
    found: list[tuple[Cause, ...]] = [(truth,)]
    if (truth.site, truth.motor) == ("motor", 0):
        found.append((Cause(truth.effect, "motor", 1), Cause(truth.effect, "motor", 2)))
    if truth.effect == "payload":
        found.append((Cause("link_inertia", "link", 0), Cause("gravity_error", "link", 0)))
    if family in PAIRED and truth.motor:
        if (truth.effect, truth.site) == ("encoder_offset", "sensor"):
            found.append((Cause("preset_error", "transmission", truth.motor),))
        if truth.effect == "preset_error":
            found.append((Cause("encoder_offset", "sensor", truth.motor),))
    if family in ONE_BODY and truth.effect == "encoder_offset":
        found.append((Cause("gravity_error", "link", 0),))
    return tuple(found)


def same_site(where: tuple[str, int], truth: Cause, family: str) -> bool:
    """Whether `where` (site, number) is the location of the truth.

    The number counts if the site has one and the answer gives one. If the drive acts on the link itself, motor 1 and
    link are the same body.
    """
    site, number = where
    if family in ONE_BODY and {site, truth.site} == {"motor", "link"}:
        return True
    if site != truth.site:
        return False
    if site in NUMBERED and 0 in (number, truth.motor):
        return True  # no number given, or both motors
    return number == truth.motor or site not in (*NUMBERED, *MEASUREMENTS)


def names(cause: Cause, truth: Cause, family: str, others: Sequence[Cause] = ()) -> bool:
    """Whether `cause` names the truth: its effect at any location, or an explanation whose causes are all named.

    others  the other causes in the answer
    """
    if cause.effect == truth.effect:
        return True
    answer = (cause, *others)
    return any(
        any(_is(cause, part) for part in parts) and all(any(_is(each, part) for each in answer) for part in parts)
        for parts in explanations(truth, family)[1:]
    )


def locates(causes: Sequence[Cause], truth: Cause, family: str) -> bool:
    """Whether the first cause names the truth at its location; for an effect on both motors, whether both are named."""
    first = causes[0]
    if first.effect == truth.effect:
        if (truth.site, truth.motor) == ("motor", 0):
            motors = {each.motor for each in causes if each.effect == truth.effect and each.site == "motor"}
            return 0 in motors or {1, 2} <= motors
        alone = family in ONE_BODY or not _at_both(first, truth)
        return alone and same_site((first.site, first.motor), truth, family)
    return names(first, truth, family, causes[1:])


def covered(truths: Sequence[Cause], causes: Sequence[Cause], family: str) -> bool:
    """Whether the named causes explain every truth, and every cause explains one."""
    every = all(any(names(cause, truth, family, causes) for cause in causes) for truth in truths)
    return every and all(any(names(cause, truth, family, causes) for truth in truths) for cause in causes)


def _at_both(first: Cause, truth: Cause) -> bool:
    """Whether the answer names both motors for an effect on one."""
    return first.site == "motor" and first.motor == 0 and truth.motor > 0 and truth.site == "motor"


def _is(cause: Cause, part: Cause) -> bool:
    return (cause.effect, cause.site) == (part.effect, part.site) and cause.motor in (part.motor, 0)
