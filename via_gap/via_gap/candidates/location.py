"""Candidate causes: every effect of the catalogue at every location where the device can have it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from via_core.devices import Device
from via_sim.effects import Effect, place_name, spots
from via_sim.effects import places as places_of
from via_sim.effects.catalogue import EFFECTS
from via_sim.effects.kinds import EffectParameter

from via_gap.logs.log import JointLog

# Found in the measurements, see sensor_errors.py, because they do not change the motion.
MEASUREMENT_ONLY = ("encoder_quantisation",)
PLAINER = {  # effects that contain a simpler one: its name, and the parameters whose mean is its initial value
    "asymmetric_coulomb": ("coulomb_friction", (0, 1)),
    "stribeck_friction": ("coulomb_friction", (1,)),
    "presliding_friction": ("coulomb_friction", (0,)),
    "asymmetric_viscous": ("viscous_friction", (0, 1)),
}


@dataclass(frozen=True)
class Location:
    """An effect at a site; `motor` is the number of motor, transmission or sensor; 0: link, both motors, or none.

    optional  names of its optional parameters here, which do not distinguish causes
    """

    name: str
    site: str
    motor: int
    optional: tuple[str, ...] = field(default=(), compare=False)

    @staticmethod
    def of(effect: Effect) -> Location:
        """The location of an effect, with its optional parameters."""
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
        """(site, number) of every single site: two for both motors."""
        return spots(self.site, self.motor)

    @property
    def axis(self) -> int:
        """The axis whose typical motion and torque apply: 0 link, 1, 2 motors; for both motors the first."""
        return self.spots[0][1] if self.site in ("motor", "transmission", "sensor", "timing") else 0

    def overlaps(self, other: Location) -> bool:
        """Whether a model cannot contain both: the same effect at a common site, or one that contains the other."""
        return self.plainest == other.plainest and not set(self.spots).isdisjoint(other.spots)

    @property
    def plainest(self) -> str:
        """Name of the simplest effect that this one contains: a Stribeck friction contains a Coulomb friction."""
        return PLAINER.get(self.name, (self.name,))[0]

    def __str__(self) -> str:
        return f"{self.name} at {place_name(self.site, self.motor)}"


def locations(device: Device, log: JointLog) -> tuple[Location, ...]:
    """All locations of all effects that this device can have and that change the simulation of this log."""
    seen = (0, *(1 + i for i, each in enumerate(log.motors_seen) if each))
    neighbour = log.commands is not None and "neighbour" in log.commands
    # Of a rigid joint with a torque drive, sensors/stamps.py separates a late angle from a late command.
    alone = len(seen) == 1 and (device.n_motors > 0 or device.drive == "position")
    found = []
    for kind in EFFECTS.values():
        if kind.name in MEASUREMENT_ONLY or (kind.name == "joint_coupling" and not neighbour):
            continue
        for site, motor in places_of(kind, device):
            if site == "sensor" and kind.of_drive:
                continue  # torque sensors: found in the measurements
            if site in ("sensor", "timing") and motor not in seen:
                continue
            if site == "timing" and alone:
                continue  # late beside which other angle? A late command gives the same record
            found.append(Location(kind.name, site, motor))
    return tuple(found)


def missing_effects(device: Device, log: JointLog) -> tuple[str, ...]:
    """Why effects of the catalogue cannot be found in this log, one sentence per reason."""
    offered = {location.name for location in locations(device, log)} | set(MEASUREMENT_ONLY)
    possible = [kind for kind in EFFECTS.values() if device.drive == "position" or not kind.of_goal]
    absent = [kind for kind in possible if kind.name not in offered]
    nowhere = [kind.name for kind in absent if not places_of(kind, device)]
    reasons = []
    if any(kind.name == "joint_coupling" and kind.name not in nowhere for kind in absent):
        reasons.append("the angle of the neighbour joint was not recorded: joint_coupling cannot be evaluated")
    if nowhere:
        reasons.append(f"'{device.name}' cannot have {', '.join(nowhere)}")
    return tuple(reasons)
