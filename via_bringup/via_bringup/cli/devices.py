"""`via devices`: the shipped device files, their estimators, and the confidence in their parameters."""

from __future__ import annotations

from typing import Annotated

import typer
from via_core.devices import Device, device_names, load_device
from via_core.errors import ParameterError
from via_estimators.methods import estimator_for, method_for

from via_bringup.cli.console import answers, print_table


def devices(
    device: Annotated[str, typer.Argument(help="Device name or path to its YAML; default: list all.")] = "",
) -> None:
    """List the shipped devices, or describe one with the source of its parameters."""
    if device:
        _describe(load_device(device))
        return
    texts = ("arrangement", "drive", "estimator", "confidence")
    listed = ((name, load_device(name)) for name in device_names())
    rows = ((name, each.arrangement, each.drive, _estimator(each), each.confidence) for name, each in listed)
    print_table("Devices", ("name", *texts), rows, texts=texts)
    answers.print("`via devices NAME` shows the source of a device's parameters")


def _describe(device: Device) -> None:
    answers.print(f"{device.name}: {device.title}")
    answers.print(f"{device.arrangement} joint, {device.drive} drive; estimator: {_estimator(device)}")
    answers.print(f"parameters: {device.confidence}; {'; '.join(device.source)}")
    if device.remark:
        answers.print(device.remark.strip())
    answers.print(f"link {device.link_joint}, motors {', '.join(device.motor_joints) or 'none'}")
    answers.print(f"commands on {device.command_topic}")


def _estimator(device: Device) -> str:
    """Name of the device's default estimator, or a dash if there is none."""
    try:
        estimator_for(device)
    except ParameterError:
        return "-"
    return method_for(device)
