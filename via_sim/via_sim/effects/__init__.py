"""Effects: unmodelled physics as data with site, bounds and units, written into a parameter row.

    Effect("coulomb_friction", site="link", parameters={"torque": 0.02})
    Effect("torque_gain", site="motor", motor=2, parameters={"gain": 0.95})
    Effect("torque_gain", site="motor", motor=0, parameters={"gain": 0.95})     # both motors alike

In a list of effects, dry frictions and viscous errors at one location add up; any other effect may occur there once.
`EFFECTS` is the registry with sites, meaning and bounds of all parameters. A list may also contain factors on numbers
of the device file, which were fitted together with the effects:

    Effect("device_numbers", site="device", parameters={"link inertia": 1.03})
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType

from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.spring_equations import MACCEPA, TWO_LEVER

from via_sim.catalogue import EFFECTS
from via_sim.catalogue.kinds import EffectKind
from via_sim.effects.device_numbers import DEVICE_NUMBERS, write_numbers
from via_sim.joint.parameters import LINK, MOTOR_1, MOTOR_2, P, RowSpot

PAIRED = ("motor", "transmission")  # sites at which motor 0 means both
_NUMBERED = {"motor": (1, 2, 0), "transmission": (1, 2, 0), "sensor": (0, 1, 2), "timing": (0, 1, 2)}


@dataclass(frozen=True)
class Effect:
    """One effect at one location.

    name        key of EFFECTS, or 'device_numbers'
    site        one of the kind's sites
    parameters  name -> value within bounds: all of the kind's parameters and any of its optional ones
    motor       motor or transmission 1 or 2, 0 for both; at a sensor 0 is the link; else 0
    joint       name of the device; empty: any device

    Raises ParameterError with key, value and allowed range.
    """

    name: str
    site: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    motor: int = 0
    joint: str = ""

    def __post_init__(self) -> None:
        kind = _kind(self.name)
        if kind is None:
            known = ", ".join((*EFFECTS, DEVICE_NUMBERS.name))
            raise ParameterError(f"effect: must be one of {known}, got '{self.name}'")
        if self.site not in kind.sites:
            raise ParameterError(f"{self.name}.site: must be one of {', '.join(kind.sites)}, got '{self.site}'")
        allowed = _NUMBERED.get(self.site, (0,))
        if type(self.motor) is not int or self.motor not in allowed:
            wanted = f"left out at site '{self.site}'"
            if allowed != (0,):
                wanted = "1, 2 or 0 (both)" if self.site in PAIRED else "0 (the link's), 1 or 2"
            raise ParameterError(f"{self.name}.motor: must be {wanted}, got {self.motor!r}")
        names = [parameter.name for parameter in kind.all_parameters]
        must = {parameter.name for parameter in kind.parameters}
        for key in self.parameters:
            if key not in names:
                raise ParameterError(f"{self.name}.{key}: unknown key; choose from {', '.join(names)}")
        for parameter in kind.all_parameters:
            key = f"{self.name}.{parameter.name}"
            reach = f"{parameter.low:g} to {parameter.high:g} {parameter.unit}"
            if parameter.name not in self.parameters:
                if parameter.name not in must:
                    continue
                raise ParameterError(f"{key}: is missing, {reach}")
            value = self.parameters[parameter.name]
            whole = type(value) is int  # an int is finite
            if not whole and not (isinstance(value, float) and isfinite(value)):
                raise ParameterError(f"{key}: must be a finite number, {reach}, got {value!r}")
            if not parameter.low <= value <= parameter.high:
                raise ParameterError(f"{key}: must be {reach}, got {value!r}")
        values = {name: float(self.parameters[name]) for name in names if name in self.parameters}
        object.__setattr__(self, "parameters", MappingProxyType(values))

    @property
    def kind(self) -> EffectKind:
        kind = _kind(self.name)
        assert kind is not None  # checked when the effect was made
        return kind

    def write(self, row: Array) -> None:
        """Write the effect into a row (N_PARAMETERS,) of a joint that it fits, in place."""
        if self.kind is DEVICE_NUMBERS:
            write_numbers(row, self.parameters)
        else:
            write_values(row, self.kind, self.site, self.motor, self.parameters)


def _kind(name: str) -> EffectKind | None:
    return DEVICE_NUMBERS if name == DEVICE_NUMBERS.name else EFFECTS.get(name)


def place_name(site: str, motor: int) -> str:
    """A location in words: 'link', 'motor 1', 'both motors'."""
    if site in PAIRED and motor == 0:
        return f"both {site}s"
    return f"{site} {motor}" if motor else site


def spots(site: str, motor: int) -> tuple[tuple[str, int], ...]:
    """(site, motor) of each single motor or transmission of a location: two of them for both motors."""
    return tuple((site, each) for each in ((1, 2) if site in PAIRED and motor == 0 else (motor,)))


def places(kind: EffectKind | str, device: Device) -> tuple[tuple[str, int], ...]:
    """(site, motor) of all locations of an effect on a device; both motors (0) come last."""
    effect = EFFECTS[kind] if isinstance(kind, str) else kind
    return tuple(
        (site, motor)
        for site in effect.sites
        for motor in _NUMBERED.get(site, (0,))
        if not _misplaced(effect, site, motor, device)
    )


def _misplaced(kind: EffectKind, site: str, motor: int, device: Device) -> str:
    """Reason why an effect does not fit a location of a device; empty where it fits."""
    if site in PAIRED and motor == 0:
        there = device.n_motors if site == "motor" else device.n_transmissions
        if there < 2:
            return f"'{device.name}' does not have two {site}s; set `motor` to the number of one"
        return _misplaced(kind, site, 1, device) or _misplaced(kind, site, 2, device)
    if site == "transmission":
        if motor > device.n_transmissions:
            return f"'{device.name}' has {device.n_transmissions} transmissions"
        has_preset = device.springs[motor - 1].kind in (MACCEPA, TWO_LEVER)
        if kind.of_preset and device.arrangement == "serial" and not has_preset:
            return f"the spring of '{device.name}' does not depend on a preset"
    driven = device.n_motors == 0 and kind.of_drive and site == "motor"  # the drive of a rigid joint is its motor 1
    if motor > (1 if driven else device.n_motors) and site in ("motor", "sensor", "timing"):
        return f"'{device.name}' has {device.n_motors} motors"
    if kind.of_torque and device.drive == "position":
        return f"'{device.name}' has a position drive, which is not commanded a torque"
    if kind.of_goal and device.drive != "position":
        return f"'{device.name}' has no position drive, and only those follow a goal"
    if site == "motor" and kind.needs_torque_drive and device.drive == "servo":
        return f"'{device.name}' has servos, which impose the angle"
    if site == "sensor" and kind.of_drive:
        if motor == 0 and device.sensors.link_torque_noise is None:
            return f"'{device.name}' has no torque sensor at the link"
        if motor > 0 and device.drive == "servo":
            return f"'{device.name}' does not measure the torque of its servos"
    return ""


def in_order(effects: Sequence[Effect]) -> list[Effect]:
    """Effects in the order in which they are written: factors on device numbers come first."""
    return sorted(effects, key=lambda effect: effect.name != DEVICE_NUMBERS.name)


def write_effects(row: Array, device: Device, effects: Sequence[Effect]) -> None:
    """Write all effects into the row of a nominal device, in place. Raises ParameterError for one that does not fit."""
    seen: set[tuple[str, str, int]] = set()
    for effect in in_order(effects):
        where = f"{effect.name} at {place_name(effect.site, effect.motor)}"
        if effect.joint not in ("", device.name):
            raise ParameterError(f"{where}: joint is '{effect.joint}', but the device is '{device.name}'")
        taken = {(effect.name, *each) for each in spots(effect.site, effect.motor)}
        if taken & seen and not effect.kind.adds:
            raise ParameterError(f"{where}: occurs twice")
        seen |= taken
        trouble = _misplaced(effect.kind, effect.site, effect.motor, device)
        if trouble:
            raise ParameterError(f"{where}: {trouble}")
        try:
            effect.write(row)
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None


def write_values(row: Array, kind: EffectKind, site: str, motor: int, values: Mapping[str, float]) -> None:
    """Write parameter values of one effect into a row in place; for fits: neither bounds nor location are checked."""
    axes: tuple[int, ...] = (MOTOR_1 + motor - 1,)
    if site == "motor" and row[P.link_drive] != 0.0:
        axes = (LINK,)
    elif motor == 0:
        axes = (MOTOR_1, MOTOR_2) if site in PAIRED else (LINK,)
    for axis in axes:
        kind.write_at(RowSpot(row, axis, site), values)
