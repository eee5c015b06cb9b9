"""Serialised JointState and VsaCommand messages from columns of numbers, and their order in a bag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from via_core.bags.definitions import typestore_of
from via_core.bags.layout import filled
from via_core.signals import Array
from via_core.wire import EQUILIBRIUM_PRESET, FIELDS, JOINT_STATE, MOTOR_TORQUE, SECOND, VSA_COMMAND


class Stream(NamedTuple):
    """One topic: stamps (N,) [ns] and N serialised messages."""

    topic: str
    type_name: str
    stamp: NDArray[np.int64]
    messages: list[bytes]


def in_order(streams: Sequence[Stream]) -> Iterator[tuple[str, bytes, int]]:
    """Topic, message and stamp of all messages, sorted by stamp; equal stamps in the order of the streams."""
    stamps = np.concatenate([stream.stamp for stream in streams])
    which = np.repeat(np.arange(len(streams)), [len(stream.stamp) for stream in streams])
    index = np.concatenate([np.arange(len(stream.stamp)) for stream in streams])
    for k in np.lexsort((which, stamps)):
        stream = streams[which[k]]
        yield stream.topic, stream.messages[index[k]], int(stamps[k])


def joint_messages(
    frame: str, names: Sequence[str], stamp: NDArray[np.int64], columns: Mapping[str, Array]
) -> list[bytes]:
    """JointStates of the joints `names` with stamps (N,) [ns]; columns position, velocity, effort (N, k), if any."""
    store = typestore_of(JOINT_STATE)
    arrays = [np.zeros(len(names) if field in columns else 0) for field in FIELDS]
    template = store.types[JOINT_STATE](_header(store, frame), list(names), *arrays)
    return filled(store, JOINT_STATE, template, len(stamp), {**_stamps(stamp), **columns})


def command_messages(
    frame: str, stamp: NDArray[np.int64], columns: Mapping[str, Array], unknown: Mapping[str, float] | None = None
) -> list[bytes]:
    """VsaCommands with stamps (N,) [ns]: motor torques with a column `motor` (N, m), else references.

    columns  equilibrium, preset, damping (N,), any of them
    unknown  values of references without a column; default: NaN for angles, 0 for damping
    """
    store, motor = typestore_of(VSA_COMMAND), columns.get("motor")
    template = store.types[VSA_COMMAND](
        header=_header(store, frame),
        sequence=0,
        mode=EQUILIBRIUM_PRESET if motor is None else MOTOR_TORQUE,
        motor=np.zeros(0 if motor is None else motor.shape[1]),
        **{"equilibrium": np.nan, "preset": np.nan, "damping": 0.0, **(unknown or {})},
    )
    known = {**_stamps(stamp), "sequence": np.arange(len(stamp)), **columns}
    return filled(store, VSA_COMMAND, template, len(stamp), known)


def _header(store: Any, frame: str) -> Any:
    return store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](0, 0), frame)


def _stamps(stamp: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    seconds, nanoseconds = np.divmod(stamp, SECOND)
    return {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds}
