"""Which estimators there are, and which of them suit a device."""

from __future__ import annotations

from via_core.devices import Device
from via_core.errors import ParameterError

from via_estimators.contract import Estimator
from via_estimators.link_impedance import LinkImpedance
from via_estimators.modulated_torque import ModulatedTorque

# In the order in which they are tried: the first that suits a device is what it gets by default.
METHODS: dict[str, type[Estimator]] = {
    "modulated_torque": ModulatedTorque,
    "link_impedance": LinkImpedance,
}


def methods_for(device: Device) -> tuple[str, ...]:
    """Names of the methods that suit a device, the best one first; empty where there is none."""
    return tuple(name for name, method in METHODS.items() if _suits(method, device))


def method_for(device: Device, method: str = "auto") -> str:
    """The name of the method, 'auto' resolved; raises ParameterError for a stranger, or where none suits the device."""
    if method == "auto":
        for name in METHODS:
            if _suits(METHODS[name], device):
                return name
        raise ParameterError(f"no estimator suits '{device.name}': {device.arrangement}, {device.drive} drive")
    if method not in METHODS:
        raise ParameterError(f"no method '{method}'; there are: auto, {', '.join(METHODS)}")
    return method


def estimator_for(device: Device, method: str = "auto") -> Estimator:
    """The estimator of that name with the device's scales and priors; raises ParameterError where it does not apply."""
    return METHODS[method_for(device, method)].from_device(device)


def _suits(method: type[Estimator], device: Device) -> bool:
    try:
        method.from_device(device)
    except ParameterError:
        return False
    return True
