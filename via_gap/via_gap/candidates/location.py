"""Candidate causes: every effect of the catalogue at every location where the device can have it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from via_core.devices import Device
from via_sim.catalogue import EFFECTS
from via_sim.effect_kinds import EffectParameter
from via_sim.effects import Effect, place_name, spots
from via_sim.effects import places as places_of

from via_gap.logs.log import JointLog

# Seen in the measurements themselves, see sensor_errors.py: no simulation of motion shows them.
MEASUREMENT_ONLY = ("encoder_quantisation",)
PLAINER = {  # effects that contain another: its name, and the parameters whose mean is where it starts
    "asymmetric_coulomb": ("coulomb_friction", (0, 1)),
    "stribeck_friction": ("coulomb_friction", (1,)),
    "presliding_friction": ("coulomb_friction", (0,)),
    "asymmetric_viscous": ("viscous_friction", (0, 1)),
}


@dataclass(frozen=True)
class Location:
    """An effect at a site; `motor` is the number of motor, transmission or sensor, 0 the link's, both or none.

    optional  names of the optional parameters that it has here: an effect with more of them is the same cause
    """

    name: str
    site: str
    motor: int
    optional: tuple[str, ...] = field(default=(), compare=False)

    @staticmethod
    def of(effect: Effect) -> Location:
        """Where an effect is, with the optional parameters that it has."""
        optional = tuple(p.name for p in effect.kind.optional if p.name in effect.parameters)
        return Location(effect.name, effect.site, effect.motor, optional)

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """The parameters of the effect here, in their order."""
        kind = EFFECTS[self.name]
        return (*kind.parameters, *(p for p in kind.optional if p.name in self.optional))

    def effect(self, values: Mapping[str, float]) -> Effect:
        return Effect(self.name, self.site, dict(values), self.motor)

    @property
    def spots(self) -> tuple[tuple[str, int], ...]:
        """(site, number) of every single place: of both motors these two."""
        return spots(self.site, self.motor)

    @property
    def axis(self) -> int:
        """The axis whose motion and torques are typical of it, 0 the link, 1, 2 motors; of both motors the first's."""
        return self.spots[0][1] if self.site in ("motor", "transmission", "sensor", "timing") else 0

    def overlaps(self, other: Location) -> bool:
        """Whether it is the same effect at some place of the other: the two together would be one effect twice."""
        return self.name == other.name and not set(self.spots).isdisjoint(other.spots)

    def __str__(self) -> str:
        return f"{self.name} at {place_name(self.site, self.motor)}"


def locations(device: Device, log: JointLog) -> tuple[Location, ...]:
    """All locations of all effects that this device can have and that a simulation of this log can show."""
    seen = (0, *(1 + i for i, each in enumerate(log.motors_seen) if each))
    neighbour = log.commands is not None and "neighbour" in log.commands
    found = []
    for kind in EFFECTS.values():
        if kind.name in MEASUREMENT_ONLY or (kind.name == "joint_coupling" and not neighbour):
            continue
        for site, motor in places_of(kind, device):
            if site == "sensor" and kind.of_drive:
                continue  # torque sensors: seen in the readings
            if site in ("sensor", "timing") and motor not in seen:
                continue
            found.append(Location(kind.name, site, motor))
    return tuple(found)


def missing_effects(device: Device, log: JointLog) -> tuple[str, ...]:
    """Why effects of the catalogue can be no answer on this log: a sentence for each reason that there is."""
    offered = {location.name for location in locations(device, log)} | set(MEASUREMENT_ONLY)
    possible = [kind for kind in EFFECTS.values() if device.drive == "position" or not kind.of_goal]
    absent = [kind for kind in possible if kind.name not in offered]
    nowhere = [kind.name for kind in absent if not places_of(kind, device)]
    said = []
    if any(kind.name == "joint_coupling" and kind.name not in nowhere for kind in absent):
        said.append("the angle of no neighbour was recorded: joint_coupling cannot be judged")
    if nowhere:
        said.append(f"'{device.name}' has no place for {', '.join(nowhere)}")
    return tuple(said)
