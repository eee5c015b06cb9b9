"""Signals of one joint from the messages of a bag, found by the joint names of the device file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from via_core.bags.reader import Bag, Columns
from via_core.bags.turns import continuous
from via_core.devices import Device
from via_core.errors import BagError
from via_core.signals import Array, Indices, Mask, Signals
from via_core.stamps import ordered
from via_core.wire import (
    EQUILIBRIUM_PRESET,
    FIELDS,
    JOINT_STATE,
    LINK,
    MOTOR_TORQUE,
    UNITS,
    VSA_COMMAND,
    seconds,
)

SHOWN = 8  # columns that a hint lists


@dataclass(frozen=True)
class StampReport:
    """Counts of the messages of one topic during conversion to Signals.

    origin     [ns] stamp at time 0 of the Signals
    messages   messages in the bag
    others     messages that do not name the joint
    repeated   messages dropped because another one has the same stamp
    backward   messages dropped because their stamp is out of order (`via_core.stamps`)
    kept       samples in the Signals
    passed     how often an angle passed the end of its turn, by channel; these angles were made continuous
    unread     columns of a table without commands that no channel uses: one of them may hold the commands
    """

    topic: str
    origin: int
    messages: int
    others: int
    repeated: int
    backward: int
    kept: int
    passed: Mapping[str, int] = field(default_factory=dict)
    unread: tuple[str, ...] = ()

    @property
    def hint(self) -> str:
        """What may hold the commands of a recording that seems to have none, as the rest of a sentence."""
        if self.others:
            return (
                f"; {self.others} of {self.messages} messages do not name the link: publish its drive in the same ones"
            )
        if not self.unread:
            return ""
        more = f" and {len(self.unread) - SHOWN} more" if len(self.unread) > SHOWN else ""
        return f"; columns not read: {', '.join(self.unread[:SHOWN])}{more}: `via bag map` shows what they may hold"


class JointRecording(NamedTuple):
    """Recording of one joint. NaN means not measured; in commands, not used in this mode."""

    measured: Signals
    commands: Signals | None  # None without commands
    reports: tuple[StampReport, ...]  # that of the link's angle first

    def made_continuous(self, turns: Mapping[tuple[str, int], float] | None = None) -> JointRecording:
        """This recording with angles that do not start again after each turn; `turns` as in `continuous`."""
        measured, commands, passed = continuous(self.measured, self.commands, turns)
        return JointRecording(measured, commands, (replace(self.reports[0], passed=passed), *self.reports[1:]))


def joint_signals(bag: Bag, device: Device, joint_topic: str = "/joint_states") -> JointRecording:
    """Measurements and commands of the joint `device` in `bag`.

    measured  q [rad], theta (N, m) [rad], tau (N, m) [N m], q_velocity, theta_velocity (N, m) [rad/s], tau_link [N m],
              channels with at least one measured value; tau (N, 1) of a rigid joint is the torque of its drive
    commands  equilibrium, preset [rad], damping [-], or motor (N, m) [rad] or [N m], zero-order hold; the torque
              command of the drive of a rigid joint is external_torque [N m]; the goal of a position drive is
              equilibrium, NaN while it is switched off

    Time 0 of both is the first measurement, so commands can have negative times. Joints are looked up by name in every
    message. Raises BagError when the topic or the joint is not in the bag.
    """
    states = bag[joint_topic]
    if states.type_name != JOINT_STATE:
        raise BagError(f"{joint_topic} is {states.type_name}, not {JOINT_STATE}")
    channels, present = joint_channels(states, device)
    if not present.any():
        names = sorted({name for names in states["name"] for name in names}) if len(states) else []
        raise BagError(
            f"no joint '{device.link_joint}' of device '{device.name}' on {joint_topic}; "
            f"there are: {', '.join(names) or 'none'}{_remedy(names)}"
        )
    there = device.command_topic in bag and len(bag.topic(device.command_topic)) > 0
    return recorded(states, channels, present, bag[device.command_topic] if there else None, device)


def _remedy(names: list[str]) -> str:
    """What to write into the device file for a bag of other names."""
    return f"; write e.g. `wire: {{link: {names[0]}, motors: [{names[0]}]}}` into the device file" if names else ""


def recorded(
    states: Columns, channels: dict[str, Array], present: Mask, commands: Columns | None, device: Device
) -> JointRecording:
    """The recording from the messages `states` where the joint is `present`, with values `channels`, and `commands`."""
    origin = int(states.stamp[np.argmax(present)])
    keep, report = _increasing(states, present, origin)
    measured = {name: values[keep] for name, values in channels.items() if np.isfinite(values[keep]).any()}
    signals = Signals(seconds(states.stamp[keep], origin), measured, UNITS)
    if commands is None:
        return JointRecording(signals, None, (report,)).made_continuous()
    commanded, command_report = _commands(commands, device, origin)
    return JointRecording(signals, commanded, (report, command_report)).made_continuous()


def joint_channels(states: Columns, device: Device) -> tuple[dict[str, Array], Mask]:
    """Values by channel for every message, NaN where missing, and a mask of the messages that name the link."""
    count, drives = len(states), device.n_drives
    channels = {name: np.full(count, np.nan) for name in LINK}
    channels |= {name: np.full((count, drives), np.nan) for name in device.drive_channels}
    present = np.zeros(count, dtype=np.bool_)
    for names, rows in _by_names(states["name"]):
        if device.link_joint not in names:
            continue
        present[rows] = True
        arrays = {member: states[member][rows] for member in FIELDS}
        for channel, member in LINK.items():
            if channel == "tau_link" and device.link_joint in device.drive_joints:
                continue  # one name for link and drive, as drivers of rigid joints publish: the effort is the drive's
            channels[channel][rows] = _picked(arrays[member], names.index(device.link_joint))
        for i, joint in enumerate(device.drive_joints):
            if joint in names:
                for channel, member in device.drive_channels.items():
                    channels[channel][rows, i] = _picked(arrays[member], names.index(joint))
    return channels, present


def _by_names(names: NDArray[Any]) -> list[tuple[tuple[str, ...], Indices]]:
    """The rows of each distinct tuple of joint names."""
    rows: dict[tuple[str, ...], list[int]] = {}
    for k, each in enumerate(names.tolist()):
        rows.setdefault(each, []).append(k)
    return [(each, np.array(where)) for each, where in rows.items()]


def _picked(values: NDArray[Any], index: int) -> Array:
    """Value `index` of every message; NaN where the array is shorter, which means not measured."""
    if values.ndim == 2:
        return values[:, index] if index < values.shape[1] else np.full(len(values), np.nan)
    return np.array([each[index] if index < len(each) else np.nan for each in values])


def _commands(columns: Columns, device: Device, origin: int) -> tuple[Signals, StampReport]:
    if columns.type_name != VSA_COMMAND:
        raise BagError(f"{columns.topic} is {columns.type_name}, not {VSA_COMMAND}")
    keep, report = _increasing(columns, np.ones(len(columns), dtype=np.bool_), origin)
    mode = columns["mode"][keep]
    by_reference = mode == EQUILIBRIUM_PRESET
    values: dict[str, Array] = {"damping": columns["damping"][keep]}
    units = {"equilibrium": "rad", "preset": "rad", "damping": "-", "motor": "rad"}
    if by_reference.any():
        for name in ("equilibrium", "preset"):
            values[name] = np.where(by_reference, columns[name][keep], np.nan)
    if not by_reference.all() and device.n_motors:
        if np.unique(mode[~by_reference]).size > 1:
            raise BagError(f"{columns.topic} mixes motor positions and motor torques")
        units["motor"] = "N m" if MOTOR_TORQUE in mode else "rad"
        motor = np.stack([_picked(columns["motor"][keep], i) for i in range(device.n_motors)], axis=1)
        values["motor"] = np.where(by_reference[:, None], np.nan, motor)
    by_torque = mode == MOTOR_TORQUE
    if by_torque.any() and not device.n_motors:  # a command without torque means zero torque
        values["external_torque"] = np.where(by_torque, _picked(columns["motor"][keep], 0), 0.0)
        units["external_torque"] = "N m"
    time = seconds(columns.stamp[keep], origin)
    return Signals(time, values, units, held=frozenset(values)), report


def _increasing(columns: Columns, wanted: Mask, origin: int) -> tuple[Indices, StampReport]:
    """The `wanted` rows in the order of their stamps, and their report."""
    rows = np.flatnonzero(wanted)
    order = ordered(columns.stamp[rows])
    kept = rows[order.kept]
    others = len(columns) - len(rows)
    return kept, StampReport(columns.topic, origin, len(columns), others, order.repeated, order.backward, len(kept))
