"""Combinations that signals and motion do not determine, in words, each with the remedy."""

from __future__ import annotations

import numpy as np
from via_core.devices import Device
from via_estimators.joint_record import Record
from via_estimators.observability import Information

STILL = 0.05  # [rad] range of a motor angle below which it hardly moves
POOR = 0.3  # relative standard deviation from which a quantity is named as poorly determined


def remedies(device: Device, record: Record, information: Information) -> tuple[str, ...]:
    """One sentence per gap, the most general first."""
    sentences = [*_missing(device, record)]
    covered: set[str] = set()
    mixed: set[str] = set()
    for direction in information.weak():
        sentence, names = _of_direction(device, record, information, direction)
        sentences += [sentence] if sentence else []
        mixed |= set() if sentence else names
        covered |= names
    if mixed:
        listed = [each.name for each in information.unknowns if each.name in mixed]
        sentences.append(
            f"only combinations of these are determined: {_list(listed)}; vary speed, amplitude and preset"
        )
    poor = [
        each.name
        for each in information.unknowns
        if each.name not in covered and information.standard_deviation(each.name) > POOR * each.size
    ]
    if poor:
        sentences.append(f"{_list(poor)}: determined only roughly; use a longer or a larger motion")
    if any(misfit > 3.0 for misfit in information.misfit.values()):
        worst = max(information.misfit, key=lambda name: information.misfit[name])
        sentences.append(
            f"the equation of {_the(worst)} leaves {information.misfit[worst]:.1f} times the residual that sensor "
            f"noise explains: standard deviations include this factor, but an unmodelled effect may also shift the "
            f"values; `via gap diagnose` finds its cause"
        )
    return tuple(dict.fromkeys(sentences))


def _missing(device: Device, record: Record) -> list[str]:
    """Equations that cannot be evaluated."""
    found, channels = [], record.channels
    absent = [f"theta_{i + 1}" for i in range(device.n_motors) if f"theta_{i + 1}" not in channels]
    if absent:
        found.append(
            f"{_list(absent)} not measured: no deflection is known, and nothing of the joint is determined; measure "
            f"the motor angles"
        )
        return found
    if device.drive == "torque" and device.n_motors:
        missing = [f"motor {i + 1}" for i in range(device.n_motors) if f"tau_{i + 1}" not in channels]
        if missing:
            found.append(
                f"torque of {_list(missing)} not measured: inertia, friction and torque delay are not determined; "
                f"record motor torques, or currents times the torque constant"
            )
    if device.drive == "servo":
        for i in range(device.n_motors):
            if f"servo_{i + 1}" not in record.commands:
                found.append(
                    f"commands of servo {i + 1} not recorded: its bandwidth is not determined; record the command topic"
                )
    if device.drive == "position" and "goal" not in record.commands:
        found.append("the goal of the drive is not recorded: its gains are not determined; record the command topic")
    if device.damper is not None and "damping" not in record.commands:
        found.append("the command of the damper is not recorded and counts as 0; record the command topic")
    return found


def _of_direction(
    device: Device, record: Record, information: Information, direction: dict[str, float]
) -> tuple[str, set[str]]:
    """The sentence for a weak direction, '' if it has no cause of its own, and the unknowns that it explains."""
    names = set(direction)
    part = {each.name: each.part for each in information.unknowns}
    parts = {part[name] for name in names}
    torque = any(name.startswith("tau") for name in record.channels)
    if not torque and "inertia of the link" in names:
        return _scale(device, information), set(part)
    if names == {"viscous friction of the link", "velocity gain"}:
        return (
            "viscous friction of the link and velocity gain of the drive act alike while the drive is on: switch the "
            "drive off for a part of the motion",
            names,
        )
    if names == {"viscous friction of the link", "scale of the damper"}:
        return (
            "viscous friction of the link and the damper act alike at a constant command: vary the damper's command",
            names,
        )
    if len(parts) == 1:
        return _within(record, information, names, parts.pop()), names
    if parts <= {"spring 1", "spring 2", "link"} and "gravity torque" in names:
        return f"{_list(sorted(names))} act alike over the angles visited: hold the link at several angles", names
    return "", names


def _scale(device: Device, information: Information) -> str:
    """All torques of the link's equation have a common factor."""
    parts = [each.part for each in information.unknowns]
    involved = ["inertia", "friction"]
    involved += ["gravity torque"] if any(each.name == "gravity torque" for each in information.unknowns) else []
    involved += ["stiffness"] if any(part.startswith("spring") for part in parts) else []
    involved += ["damper"] if "damper" in parts else []
    involved += ["gains of the drive"] if "drive" in parts else []
    share = 100.0 * device.tolerances.link_inertia
    sensor = "motor torques or the joint torque" if device.drive == "torque" and device.n_motors else "the joint torque"
    if not device.n_motors:
        sensor = "the torque of the drive"
    return (
        f"link {', '.join(involved[:-1])} and {involved[-1]} scale together without a torque measurement: measure "
        f"{sensor}, or state the link inertia; with that of the device file they have its tolerance of {share:g} %"
    )


def _within(record: Record, information: Information, names: set[str], part: str) -> str:
    """A weak direction within one part of the joint."""
    kind, _, number = part.partition(" ")
    if kind in ("motor", "servo"):
        moved = float(np.ptp(record.channels[f"theta_{number}"]))
        if moved < STILL:
            what = "equilibrium" if number == "1" and record.channels.keys() >= {"theta_2"} else "preset"
            return f"motor {number} hardly moves ({moved:.2g} rad) and shows no {_list(sorted(names))}: vary the {what}"
        if names == {f"torque delay of motor {number}"}:
            return f"the torque of motor {number} changes too little to show its delay: move faster"
        return f"{_list(sorted(names))}: only a combination is determined; move motor {number} at several speeds"
    if kind == "spring":
        phi = record.channels["q"] - record.channels[f"theta_{number}"]
        low, high = np.quantile(phi, (0.01, 0.99))
        return (
            f"stiffness of spring {number} is not resolved over its deflections of {low:.2g} to {high:.2g} rad: move "
            f"over a wider range, with several presets"
        )
    if part == "link" and np.ptp(record.channels["q"]) < STILL:
        moved = float(np.ptp(record.channels["q"]))
        return f"the link hardly moves ({moved:.2g} rad) and shows no {_list(sorted(names))}: move it"
    return f"{_list(sorted(names))}: not determined by this motion; vary speed and amplitude"


def _list(names: list[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _the(equation: str) -> str:
    return f"the {equation}" if equation in ("link", "torque sensor", "drive") else equation
