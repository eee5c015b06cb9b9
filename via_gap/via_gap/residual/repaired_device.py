"""A device with the parameters that a diagnosis fitted; with the named effects it is the repaired model."""

from __future__ import annotations

from typing import Any

from via_core.devices import Device
from via_core.signals import Array

from via_gap.residual.nuisance import Nuisance

_SCALED = {
    "linear": ("stiffness",),
    "cubic": ("coefficient",),
    "odd_polynomial": ("odd_coefficients",),
    "exponential": ("k",),
}
_FIELDS = {"inertia": "inertia", "viscous friction": "viscous_friction", "dry friction": "coulomb_friction"}


def repaired_device(device: Device, nuisances: tuple[Nuisance, ...], offsets: Array) -> Device:
    """The device with every nuisance moved by its offset [sd]; its parameter row equals that of the fit."""
    content: dict[str, Any] = device.model_dump(mode="python")
    for nuisance, offset in zip(nuisances, offsets, strict=True):
        factor = 1.0 + nuisance.tolerance * float(offset)
        part, _, what = nuisance.name.partition(" ")
        if nuisance.name == "gravity torque":
            content["link"]["gravity_torque"] *= factor
        elif nuisance.name == "damper":
            for key in ("minimum", "maximum", "stage"):
                if key in content["damper"]:
                    content["damper"][key] *= factor
        elif part == "servo":
            content["servo"][what.replace(" ", "_")] *= factor
        elif part == "spring":
            spring = content["springs"][int(what[0]) - 1]
            for key in _SCALED.get(spring["law"], ("k",)):
                spring[key] = (
                    tuple(each * factor for each in spring[key])
                    if isinstance(spring[key], tuple)
                    else spring[key] * factor
                )
        else:
            target = content["link"] if part == "link" else content["motors"][int(what[0]) - 1]
            key = what if part == "link" else what[2:]
            target[_FIELDS.get(key, key)] *= factor
    return Device.model_validate(content)
