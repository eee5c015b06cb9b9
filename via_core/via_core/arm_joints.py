"""Joints of an arm as devices, so that estimators of single joints serve arms of flexible joints.

    device = load_device("reference_4dof:elbow")     # motor and spring of that joint in the arm's file

Names in messages are those of ADR 7: the device has the name of the joint. The link is that of the arm at zero angles
without gravity: no torque-based stiffness estimator uses it. Arm files describe no sensors.
"""

from __future__ import annotations

import numpy as np

from via_core.device_parts import Link, Sensors
from via_core.devices import Device
from via_core.errors import DeviceError
from via_core.vsa_arms import VsaArmFile, arm_file, load_vsa_arm

RATE = 1000.0  # [Hz] of an arm's samples
TORQUE_NOISE = 0.02  # [N m] standard deviation of a motor's torque, where the file states none


def arm_joint(arm: str, joint: str) -> Device:
    """The joint of this name of an arm (name or path of its YAML). Raises DeviceError."""
    file: VsaArmFile = arm_file(arm)
    names = [each.name for each in file.joints]
    if joint not in names:
        raise DeviceError(f"arm '{arm}' has no joint '{joint}'; there are: {', '.join(names)}")
    at, body = names.index(joint), load_vsa_arm(arm)
    own = file.joints[at]
    if own.preset:
        raise DeviceError(f"joint '{joint}' of arm '{arm}': its preset is not 0, which no flexible device has")
    inertia = float(body.inertia(np.zeros(body.n))[at, at])
    return Device(
        name=joint,
        title=f"Joint {joint} of {file.title}",
        source=file.source,
        confidence=file.confidence,
        arrangement="flexible",
        link=Link(inertia=inertia, viscous_friction=own.link_friction),
        motors=(own.motor,),
        springs=(own.spring,),
        sensors=Sensors(rate=RATE, torque_noise=TORQUE_NOISE),
    )
