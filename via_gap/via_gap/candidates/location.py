"""Candidate causes: every effect of the catalogue at every location where the device can have it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from via_core.devices import Device
from via_sim.catalogue import EFFECTS
from via_sim.catalogue.kinds import EffectKind, EffectParameter
from via_sim.effects import Effect, place_name, spots
from via_sim.effects import places as places_of

from via_gap.logs.log import JointLog

# Found in the measurements, see sensor_errors.py, because they do not change the motion.
MEASUREMENT_ONLY = tuple(kind.name for kind in EFFECTS.values() if kind.measured)


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
    def kind(self) -> EffectKind:
        return EFFECTS[self.name]

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """The parameters of the effect here, in their order."""
        return (*self.kind.parameters, *(p for p in self.kind.optional if p.name in self.optional))

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
        return self.kind.contains[0] if self.kind.contains else self.name

    def __str__(self) -> str:
        return f"{self.name} at {place_name(self.site, self.motor)}"


def locations(device: Device, log: JointLog) -> tuple[Location, ...]:
    """All locations of all effects that this device can have and that change the simulation of this log."""
    seen = (0, *(1 + i for i, each in enumerate(log.motors_seen) if each))
    # Of a rigid joint with a torque drive, sensors/stamps.py separates a late angle from a late command.
    alone = len(seen) == 1 and (device.n_motors > 0 or device.drive == "position")
    found = []
    for kind in EFFECTS.values():
        if kind.measured or not _has_channel(kind, log):
            continue
        for site, motor in places_of(kind, device):
            if site == "sensor" and kind.of_drive:
                continue  # torque sensors: found in the measurements
            if site in ("sensor", "timing") and motor not in seen:
                continue
            if site == "timing" and alone:
                continue  # a late command gives the same record: sensors/stamps.py adds the late angle
            found.append(Location(kind.name, site, motor))
    return tuple(found)


def _has_channel(kind: EffectKind, log: JointLog) -> bool:
    """Whether a log has the command channel that an effect needs."""
    return not kind.channel or (log.commands is not None and kind.channel in log.commands)


def missing_effects(device: Device, log: JointLog) -> tuple[str, ...]:
    """Why effects of the catalogue cannot be found in this log, one sentence per reason."""
    offered = {location.name for location in locations(device, log)} | set(MEASUREMENT_ONLY)
    possible = [kind for kind in EFFECTS.values() if device.drive == "position" or not kind.of_goal]
    absent = [kind for kind in possible if kind.name not in offered]
    nowhere = [kind.name for kind in absent if not places_of(kind, device)]
    reasons = []
    reasons += [
        f"the channel `{kind.channel}` was not recorded: {kind.name} cannot be evaluated"
        for kind in absent
        if not _has_channel(kind, log) and kind.name not in nowhere
    ]
    if nowhere:
        reasons.append(f"'{device.name}' cannot have {', '.join(nowhere)}")
    return tuple(reasons)
