"""Which estimators there are, and which one suits a device."""

from __future__ import annotations

from via_core.devices import Device
from via_core.errors import ParameterError

from via_estimators.contract import Estimator
from via_estimators.link_impedance import LinkImpedance
from via_estimators.modulated_torque import ModulatedTorque

METHODS: dict[str, type[ModulatedTorque] | type[LinkImpedance]] = {
    "modulated_torque": ModulatedTorque,
    "link_impedance": LinkImpedance,
}
BY_DRIVE = {"torque": "modulated_torque", "servo": "link_impedance"}


def method_for(device: Device, method: str = "auto") -> str:
    """The name of the method, 'auto' resolved by how the device is driven; raises ParameterError for a stranger."""
    name = BY_DRIVE[device.drive] if method == "auto" else method
    if name not in METHODS:
        raise ParameterError(f"no method '{method}'; there are: auto, {', '.join(METHODS)}")
    return name


def estimator_for(device: Device, method: str = "auto") -> Estimator:
    """The estimator of that name with the device's scales and priors; raises ParameterError where it does not apply."""
    return METHODS[method_for(device, method)].from_device(device)
