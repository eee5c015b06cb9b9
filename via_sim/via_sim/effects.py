"""Effects: one piece of unmodelled physics each, as data with a site, bounds and units, that writes itself into a row.

    Effect("coulomb_friction", site="link", parameters={"torque": 0.02})
    Effect("torque_gain", site="motor", motor=2, parameters={"gain": 0.95})

A list of them composes: dry frictions and viscous errors add up, a second one of any other kind at the same place is
refused. `EFFECTS` is the registry: what there is, where it may sit, what its parameters mean and how far they go.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType

from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array

from via_sim.parameters import DYNAMIC, LINK, MOTOR_1, P


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect: allowed range [low, high], and the neutral value at which the effect is absent."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    text: str


@dataclass(frozen=True)
class EffectKind:
    """What an effect is. `write` puts parameter values at an axis (0 link, 1, 2 motors) into a row in place."""

    name: str
    sites: tuple[str, ...]
    text: str
    parameters: tuple[EffectParameter, ...]
    write: Callable[[Array, int, Mapping[str, float]], None]
    needs_torque_drive: bool  # at a motor: means nothing where a servo imposes the angle
    adds: bool = False  # several at one place add up


def _write_coulomb(row: Array, axis: int, value: Mapping[str, float]) -> None:
    row[P.breakaway_friction + axis] += value["torque"]
    row[P.kinetic_friction + axis] += value["torque"]


def _write_stribeck(row: Array, axis: int, value: Mapping[str, float]) -> None:
    if value["breakaway"] < value["kinetic"]:
        raise ParameterError(f"breakaway {value['breakaway']} N m must be >= kinetic {value['kinetic']} N m")
    row[P.breakaway_friction + axis] += value["breakaway"]
    row[P.kinetic_friction + axis] += value["kinetic"]
    row[P.stribeck_velocity + axis] = value["velocity"]


def _write_viscous(row: Array, axis: int, value: Mapping[str, float]) -> None:
    total = row[P.viscous_friction + axis] + value["coefficient"]
    if total < 0.0:
        raise ParameterError(
            f"coefficient {value['coefficient']} leaves {total:.6g} N m s/rad of viscous friction, must stay >= 0"
        )
    row[P.viscous_friction + axis] = total


def _write_backlash(row: Array, axis: int, value: Mapping[str, float]) -> None:
    row[P.backlash + axis - MOTOR_1] = value["gap"]


def _write_delay(row: Array, _axis: int, value: Mapping[str, float]) -> None:
    row[P.delay] = value["delay"]


def _write_gain(row: Array, axis: int, value: Mapping[str, float]) -> None:
    row[P.torque_gain + axis] = value["gain"]


MAX_DELAY = 0.1  # [s]

EFFECTS: Mapping[str, EffectKind] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            EffectKind(
                "coulomb_friction",
                ("motor", "link"),
                "dry friction of constant size; the axis sticks while the torque on it stays below",
                (EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "breakaway and kinetic friction"),),
                _write_coulomb,
                True,
                adds=True,
            ),
            EffectKind(
                "stribeck_friction",
                ("motor", "link"),
                "dry friction that falls from breakaway to kinetic as exp(-(v/velocity)^2)",
                (
                    EffectParameter("breakaway", "N m", 0.0, 1e3, 0.0, "friction at standstill"),
                    EffectParameter("kinetic", "N m", 0.0, 1e3, 0.0, "friction at speed, at most breakaway"),
                    EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed that leaves 1/e of the difference"),
                ),
                _write_stribeck,
                True,
            ),
            EffectKind(
                "viscous_friction",
                ("motor", "link"),
                "error of the viscous friction: what the device file forgot (or has too much)",
                (EffectParameter("coefficient", "N m s/rad", -1e2, 1e2, 0.0, "added to the device's coefficient"),),
                _write_viscous,
                True,
                adds=True,
            ),
            EffectKind(
                "backlash",
                ("transmission",),
                "a torque-free gap between motor and spring; `motor` is the number of the transmission",
                (EffectParameter("gap", "rad", 0.0, 0.5, 0.0, "whole width of the gap"),),
                _write_backlash,
                False,
            ),
            EffectKind(
                "actuator_delay",
                ("command",),
                "dead time between a command and what it does, in any fraction of a tick; all commands of the joint",
                (EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time"),),
                _write_delay,
                False,
            ),
            EffectKind(
                "torque_gain",
                ("motor",),
                "the motor gives gain times the torque commanded, unknown to the torque measurement",
                (EffectParameter("gain", "-", 0.0, 10.0, 1.0, "torque per torque commanded"),),
                _write_gain,
                True,
            ),
        )
    }
)


@dataclass(frozen=True)
class Effect:
    """One effect at one place.

    name        key of EFFECTS
    site        where: one of the kind's sites
    parameters  name -> value, all of the kind's parameters, inside their bounds
    motor       1 or 2: which motor or transmission (sites 'motor' and 'transmission' only, else 0)
    joint       name of the device it belongs to; empty means whichever it is given to

    Raises ParameterError with key, value and allowed range.
    """

    name: str
    site: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    motor: int = 0
    joint: str = ""

    def __post_init__(self) -> None:
        kind = EFFECTS.get(self.name)
        if kind is None:
            raise ParameterError(f"effect: must be one of {', '.join(EFFECTS)}, got '{self.name}'")
        if self.site not in kind.sites:
            raise ParameterError(f"{self.name}.site: must be one of {', '.join(kind.sites)}, got '{self.site}'")
        allowed = (1, 2) if self.site in ("motor", "transmission") else (0,)
        if type(self.motor) is not int or self.motor not in allowed:
            wanted = "1 or 2" if allowed != (0,) else f"left out at site '{self.site}'"
            raise ParameterError(f"{self.name}.motor: must be {wanted}, got {self.motor!r}")
        names = [parameter.name for parameter in kind.parameters]
        for key in self.parameters:
            if key not in names:
                raise ParameterError(f"{self.name}.{key}: is no known key; there are {', '.join(names)}")
        for parameter in kind.parameters:
            key = f"{self.name}.{parameter.name}"
            reach = f"{parameter.low:g} to {parameter.high:g} {parameter.unit}"
            if parameter.name not in self.parameters:
                raise ParameterError(f"{key}: is missing, {reach}")
            value = self.parameters[parameter.name]
            whole = type(value) is int  # finite, however many digits it has
            if not whole and not (isinstance(value, float) and isfinite(value)):
                raise ParameterError(f"{key}: must be a finite number, {reach}, got {value!r}")
            if not parameter.low <= value <= parameter.high:
                raise ParameterError(f"{key}: must be {reach}, got {value!r}")
        values = {name: float(self.parameters[name]) for name in names}
        object.__setattr__(self, "parameters", MappingProxyType(values))

    @property
    def kind(self) -> EffectKind:
        return EFFECTS[self.name]

    @property
    def axis(self) -> int:
        """0 the link (and all that is not at a motor), 1 and 2 the motors or transmissions."""
        return LINK if self.motor == 0 else MOTOR_1 + self.motor - 1


def write_effects(row: Array, device: Device, effects: Sequence[Effect]) -> None:
    """All effects into the row of a nominal device, in place. Raises ParameterError where one does not fit."""
    seen: set[tuple[str, str, int]] = set()
    for effect in effects:
        where = f"{effect.name} at {effect.site}{f' {effect.motor}' if effect.motor else ''}"
        if effect.joint not in ("", device.name):
            raise ParameterError(f"{where}: joint is '{effect.joint}', but this is '{device.name}'")
        place = (effect.name, effect.site, effect.motor)
        if place in seen and not effect.kind.adds:
            raise ParameterError(f"{where}: is there twice")
        seen.add(place)
        if effect.site == "transmission" and effect.motor > device.n_transmissions:
            raise ParameterError(f"{where}: '{device.name}' has {device.n_transmissions} transmissions")
        if effect.site == "motor" and effect.motor > device.n_motors:
            raise ParameterError(f"{where}: '{device.name}' has {device.n_motors} motors")
        if effect.site == "motor" and effect.kind.needs_torque_drive and row[P.axis_kind + effect.axis] != DYNAMIC:
            raise ParameterError(f"{where}: a servo imposes the angle, so this has no meaning on '{device.name}'")
        try:
            effect.kind.write(row, effect.axis, effect.parameters)
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None
