"""Names of effects, locations, signals and logs in plain English."""

from __future__ import annotations

import re
from collections.abc import Sequence

from via_sim.catalogue import EFFECTS

from via_gap.candidates.location import MEASUREMENT_ONLY
from via_gap.report.figures import Member
from via_gap.report.report import Cause, EffectLocation, Where

PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}
EFFECT_WORDS = {
    "torque_saturation": "torque or speed limit",  # of a servo it limits the speed
    "asymmetric_coulomb": "asymmetric Coulomb friction",
    "asymmetric_viscous": "asymmetric viscous friction",
}
AT = {
    "command": "in the command path of motor {}",
    "motor": "at motor {}",
    "transmission": "in transmission {}",
    "sensor": "in the sensor of motor {}",
    "timing": "in the timing of motor {}'s channel",
}
UNNUMBERED = {
    "command": "in the command path",
    "motor": "at both motors alike",
    "transmission": "in both transmissions alike",
    "sensor": "in the link's encoder",
    "timing": "in the timing of the link's channel",
    "link": "at the link",
    "environment": "from the environment",
}
BOTH = {"motor": "both motors", "transmission": "both transmissions"}
LEVELS = {
    "full": "every angle and torque of the joint was measured, so every equation of the model can be evaluated",
    "no torque": "motor angles were measured, torques were not; commanded torques are used instead",
    "link only": "no motor angle was measured; only the simulated link angle can be compared",
    "encoder and command": "the link angle and the commanded angle were recorded; the drive's torque follows from both",
    "commands only": "only commands and the link angle were recorded; only the simulated link angle can be compared",
}
SIGNALS = {
    "q": "link angle q", "theta_1": "motor angle θ1", "theta_2": "motor angle θ2", "tau": "drive torque τ",
    "tau_link": "torque on the link", "tau_1": "torque of motor 1", "tau_2": "torque of motor 2",
}  # fmt: skip
QUANTITIES = {"angle": "link angle", "reversal": "time since a reversal"}  # others are called what they are
HALVES = {  # of the motion between which a repair is transferred; others are called small and large
    "time": ("the first half of the recordings", "the second half"),
    "angle": ("the lower half of the angles", "the upper half"),
    "amplitude": ("small motion", "large motion"),
    "speed": ("slow motion", "fast motion"),
}
SEVERAL = 3  # logs that are named one by one


def effect_words(name: str) -> str:
    """coulomb_friction -> Coulomb friction."""
    return EFFECT_WORDS.get(name) or " ".join(PROPER.get(word, word) for word in name.split("_"))


def plain(text: str) -> str:
    """A sentence in which the catalogue's names of effects are words."""
    named = re.sub(r"\b[a-z]+(?:_[a-z]+)+\b", lambda m: effect_words(m[0]) if m[0] in EFFECTS else m[0], text)
    return re.sub(rf"\b(?:{'|'.join(PROPER)})\b", lambda m: PROPER[m[0]], named)


def site_words(site: str, motor: int) -> str:
    """(motor, 1) -> at motor 1; motor 0 of a motor or transmission is both of them."""
    return AT[site].format(motor) if motor and site in AT else UNNUMBERED.get(site, site)


def place_words(place: EffectLocation | Cause | Member) -> str:
    """backlash in transmission 1."""
    return f"{effect_words(place.effect)} {site_words(place.site, place.motor)}"


def where_words(where: Where) -> str:
    """transmission 1, both motors, link..."""
    return f"{where.site} {where.motor}" if where.motor else BOTH.get(where.site, where.site)


def listed(words: Sequence[str], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def log_words(names: Sequence[str]) -> str:
    """Logs by name, or how many there are."""
    return listed(names) if len(names) <= SEVERAL else f"{len(names)} logs ({names[0]}, ...)"


def spot_of(place: EffectLocation | Cause | Member) -> tuple[str, str, int]:
    """What identifies a location: effect, site, motor."""
    return place.effect, place.site, place.motor


def of_measurements(place: EffectLocation | Cause) -> bool:
    """Whether an effect is found in a sensor's measurements and not in the motion."""
    drives = place.effect in EFFECTS and EFFECTS[place.effect].of_drive
    return place.site == "sensor" and (place.effect in MEASUREMENT_ONLY or drives)
