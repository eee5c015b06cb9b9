"""Sample rows of a recording; of a bag formed as in a live node, so that replayed estimates equal the live ones.

Rules for bags, the same as in the node:
  - every message that names the device's link is one sample, in stamp order, bad stamps and NaN included;
  - its time is the difference to the first one in whole nanoseconds, then divided once;
  - a command applies to samples whose stamp is not before its own. Stamps decide, not arrival, since messages of two
    topics may arrive in any order (the node counts a command that arrives after such a sample as late);
  - invalid commands (not finite, not of mode EQUILIBRIUM_PRESET) are ignored.

Rows of a table become samples in its order, without those whose stamp does not increase. A command applies from its
row on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from via_core.bags.joints import JointRecording, joint_channels
from via_core.bags.reader import Bag
from via_core.bags.recording_checks import rate_remark
from via_core.devices import Device
from via_core.errors import BagError
from via_core.signals import Array
from via_core.wire import EQUILIBRIUM_PRESET, JOINT_STATE, REFERENCES, SECOND, VSA_COMMAND, seconds

from via_estimators.contract import Estimates, Estimator, rows_of


class SampleRows(NamedTuple):
    """Samples in the form that an estimator processes."""

    stamp: NDArray[np.int64]  # (N,) [ns]
    rows: Array  # (N, 1 + k), time [s] since the first stamp, then the requested columns
    damping_command: Array  # (N,) [-] zero-order hold, NaN before the first command


class BagEstimates(NamedTuple):
    """Estimates of a bag and the samples they belong to."""

    samples: SampleRows
    estimates: Estimates


def sample_rows(bag: Bag, device: Device, inputs: tuple[str, ...], joint_topic: str = "/joint_states") -> SampleRows:
    """The samples of `device` in `bag`, columns `inputs` such as ('q', 'theta_1', 'equilibrium').

    Raises BagError when the topic is not in the bag, is of another type, or never contains the device's link.
    """
    states = bag[joint_topic]
    if states.type_name != JOINT_STATE:
        raise BagError(f"{joint_topic} is {states.type_name}, not {JOINT_STATE}")
    channels, present = joint_channels(states, device)
    order = np.flatnonzero(present)
    if not len(order):
        raise BagError(f"no joint '{device.link_joint}' of device '{device.name}' on {joint_topic}")
    order = order[np.argsort(states.stamp[order], kind="stable")]
    stamp = states.stamp[order]
    held = _held(bag, device, stamp)
    rows = np.full((len(order), 1 + len(inputs)), np.nan)
    rows[:, 0] = seconds(stamp, int(stamp[0]))
    for at, column in enumerate(inputs, start=1):
        name, _, number = column.rpartition("_")
        if column in held:
            rows[:, at] = held[column]
        elif column in channels:
            rows[:, at] = channels[column][order]
        elif name in channels and 1 <= int(number) <= channels[name].shape[1]:
            rows[:, at] = channels[name][order, int(number) - 1]
        else:
            raise BagError(f"device '{device.name}' with {device.n_motors} motors has no column '{column}'")
    return SampleRows(stamp, rows, held["damping"])


def _held(bag: Bag, device: Device, stamp: NDArray[np.int64]) -> dict[str, Array]:
    """Commands (N,) by zero-order hold at the stamps, NaN before the first."""
    held = {name: np.full(len(stamp), np.nan) for name in REFERENCES}
    if device.command_topic not in bag or not len(bag.topic(device.command_topic)):
        return held
    commands = bag[device.command_topic]
    if commands.type_name != VSA_COMMAND:
        raise BagError(f"{device.command_topic} is {commands.type_name}, not {VSA_COMMAND}")
    good = commands["mode"] == EQUILIBRIUM_PRESET
    for name in REFERENCES:
        good &= np.isfinite(commands[name])
    chosen = np.flatnonzero(good)
    chosen = chosen[np.argsort(commands.stamp[chosen], kind="stable")]
    at = np.searchsorted(commands.stamp[chosen], stamp, side="right") - 1
    for name in REFERENCES:
        held[name][at >= 0] = commands[name][chosen][at[at >= 0]]
    return held


def table_rows(recording: JointRecording, inputs: tuple[str, ...]) -> SampleRows:
    """The samples of a joint in a table (`via_core.recordings.channels`), columns `inputs`; NaN for missing signals."""
    measured, commands = recording.measured, recording.commands
    rows = rows_of(measured, inputs)
    held = {name: np.full(len(measured), np.nan) for name in REFERENCES}
    if commands is not None:
        row = np.searchsorted(commands.time, measured.time, side="right") - 1
        for name in held.keys() & commands.channels.keys():
            held[name][row >= 0] = commands[name][row[row >= 0]]
    for column, name in enumerate(inputs, start=1):
        if name in held:
            rows[:, column] = held[name]
    stamp = np.rint((measured.time - measured.time[:1]) * SECOND).astype(np.int64)
    return SampleRows(stamp, rows, held["damping"])


def at_rate(device: Device, rate: float) -> Device:
    """The device with samples at `rate` [Hz], if its file says another one: the windows of estimators count samples."""
    if not rate_remark(rate, device):
        return device
    return device.model_copy(update={"sensors": device.sensors.model_copy(update={"rate": rate})})


def estimate_bag(bag: Bag, device: Device, estimator: Estimator, joint_topic: str = "/joint_states") -> BagEstimates:
    """Estimates of a bag, computed sample by sample as in the node."""
    samples = sample_rows(bag, device, estimator.inputs, joint_topic)
    return BagEstimates(samples, estimator.run_rows(samples.rows)[1])
