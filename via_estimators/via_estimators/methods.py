"""Registry of the estimators, and their selection for a device."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from via_core.devices import Device
from via_core.errors import ParameterError

from via_estimators.checked import Checked
from via_estimators.contract import Estimator
from via_estimators.damping_directional import DampingDirectional
from via_estimators.damping_mixture import DampingMixture
from via_estimators.damping_rls import DampingRLS
from via_estimators.filtered_signal_based import FilteredSignalBased
from via_estimators.link_impedance import LinkImpedance
from via_estimators.modulated_stiffness import ModulatedStiffness
from via_estimators.modulated_torque import ModulatedTorque
from via_estimators.peers import PEERS
from via_estimators.residual import Residual
from via_estimators.signal_based import SignalBased
from via_estimators.torque_errors import with_torque_errors

# In order of preference: the first one that suits a device is its default.
METHODS: dict[str, type[Estimator]] = {
    "modulated_torque": ModulatedTorque,
    "modulated_stiffness": ModulatedStiffness,
    "filtered_signal_based": FilteredSignalBased,
    "signal_based": SignalBased,
    **PEERS,
    "residual": Residual,
    "link_impedance": LinkImpedance,
    "damping_mixture": DampingMixture,
    "damping_directional": DampingDirectional,
    "damping_rls": DampingRLS,
}


def methods_for(device: Device) -> tuple[str, ...]:
    """Names of the methods that suit a device, in order of preference."""
    return tuple(name for name, method in METHODS.items() if _suits(method, device))


def method_for(device: Device, method: str = "auto") -> str:
    """The name of the method, 'auto' resolved; raises ParameterError for an unknown name, or if none suits."""
    if method == "auto":
        for name in METHODS:
            if _suits(METHODS[name], device):
                return name
        raise ParameterError(f"no estimator suits '{device.name}': {device.arrangement}, {device.drive} drive")
    if method not in METHODS:
        raise ParameterError(f"no method '{method}'; there are: auto, {', '.join(METHODS)}")
    return method


def estimator_for(device: Device, method: str = "auto") -> Checked:
    """The estimator of that name with the device's scales and priors, and with the check of its samples (`checked`).

    The tolerances of the torques' scale and timing are in its standard deviations (`torque_errors`).
    Raises ParameterError if the method does not apply.
    """
    inner = METHODS[method_for(device, method)].from_device(device)
    return Checked(with_torque_errors(inner, device), device)


class Pair(NamedTuple):
    """One method on one device."""

    device: Device
    method: str


def pairs_of(devices: Sequence[Device], methods: Sequence[str]) -> tuple[Pair, ...]:
    """Every device with each of the methods that suits it; 'auto' is its default, 'all' are all that suit it.

    Raises ParameterError without devices or methods, for devices that share a name or a joint, an unknown method, a
    method that suits no device, and a device that no method suits.
    """
    _expect_distinct(devices)
    if not methods:
        raise ParameterError(f"no method; there are: auto, all, {', '.join(METHODS)}")
    pairs = [Pair(device, name) for device in devices for name in _chosen(device, methods)]
    for name in methods:
        if name in METHODS and all(pair.method != name for pair in pairs):
            METHODS[name].from_device(devices[0])  # raises with the reason
    for device in devices:
        if all(pair.device is not device for pair in pairs):
            raise ParameterError(f"none of the methods {', '.join(methods)} suits '{device.name}'")
    return tuple(pairs)


def _chosen(device: Device, methods: Sequence[str]) -> list[str]:
    """Names of the methods for a device, in the order of the list, without duplicates."""
    found: list[str] = []
    for name in methods:
        if name == "all":
            found += methods_for(device) or [method_for(device)]
        elif name == "auto" or not _suits(METHODS[method_for(device, name)], device):
            found += [method_for(device)] if name == "auto" else []
        else:
            found.append(name)
    return list(dict.fromkeys(found))


def _expect_distinct(devices: Sequence[Device]) -> None:
    if not devices:
        raise ParameterError("no device")
    owner: dict[str, str] = {}
    names: set[str] = set()
    for device in devices:
        if device.name in names:
            raise ParameterError(f"device '{device.name}' is given twice; another=... gives it another name")
        names.add(device.name)
        for joint in (device.link_joint, *device.motor_joints):
            if joint in owner:
                raise ParameterError(f"devices '{owner[joint]}' and '{device.name}' both have the joint '{joint}'")
            owner[joint] = device.name


def _suits(method: type[Estimator], device: Device) -> bool:
    try:
        method.from_device(device)
    except ParameterError:
        return False
    return True
