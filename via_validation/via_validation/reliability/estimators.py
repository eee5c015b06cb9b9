"""Faults of the samples that reach an estimator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from via_ros.conversions import nanoseconds, set_stamp

from via_validation.reliability.fault import Fault
from via_validation.reliability.stream import (
    DURATION,
    END,
    Damage,
    changed,
    doubled,
    estimator_fault,
    field_scaled,
    field_set,
    frozen,
    interrupted,
    lost,
    only_at_onset,
    reordered,
    replaced,
    shifted,
    unread,
)

LINK, FIRST_MOTOR, MOTORS = slice(0, 1), slice(1, 2), slice(1, None)
MILLION = 1_000_000
EARLIEST, LATEST = -(2**31) * 10**9, (2**31 - 1) * 10**9  # [ns] of stamps
DEGREES = 180.0 / np.pi
NEVER_WRONG = "no wrong estimate with status OK"
AGAIN = f"{NEVER_WRONG}; OK again at the end"
TESTED = {
    "nothing: sound samples", "half of the samples lost for 1 s", "one position of 1000 rad", "one torque of 1000 N m",
    "a million joint names", "stamps zero for 1 s", "the clock jumps 50 ms backward", "sign of the torques flipped",
    "positions frozen", "link angle in degrees for 1 s",
}  # fmt: skip


def _stamped(time: int) -> Callable[[JointState], None]:
    return lambda message: set_stamp(message.header.stamp, time)


def _shorter(message: JointState) -> None:
    message.position = message.position[:1]


def _without_effort(message: JointState) -> None:
    message.effort = []


def _exchanged(message: JointState) -> None:
    message.effort = [message.effort[0], message.effort[2], message.effort[1]]


def _reversed_names(message: JointState) -> None:
    for field in ("name", "position", "effort"):
        setattr(message, field, list(getattr(message, field))[::-1])


def _doubled_names(message: JointState) -> None:
    for field in ("name", "position", "effort"):
        setattr(message, field, 2 * list(getattr(message, field)))


def _named(*names: str) -> Damage:
    def rename(message: JointState) -> JointState:
        message.name = list(names)
        return message

    return replaced(rename)


def _invalid_nanoseconds(message: JointState) -> None:
    message.header.stamp.nanosec += 2_000_000_000


def _rounded(message: JointState) -> None:
    """Stamps of a clock of 20 ms."""
    set_stamp(message.header.stamp, nanoseconds(message.header.stamp) // 20_000_000 * 20_000_000)


def _truncated(message: JointState) -> bytes:
    return bytes(serialize_message(message)[:60])


def _passing(injected: str, damage: Damage) -> Fault:
    return estimator_fault(injected, AGAIN, damage, True, injected in TESTED)


def _lasting(injected: str, damage: Damage) -> Fault:
    return estimator_fault(injected, NEVER_WRONG, damage, False, injected in TESTED)


def faults() -> list[Fault]:
    """The faults of this group."""
    return [
        _passing("nothing: sound samples", lambda sound: sound),
        _passing("a tenth of the samples lost", lost(0.1, DURATION)),
        _passing("half of the samples lost for 1 s", lost(0.5)),
        _passing("no samples for 1 s", interrupted(1.0)),
        _passing("every sample twice for 1 s", doubled()),
        _passing("pairs of samples in reverse order for 1 s", reordered(2)),
        _passing("blocks of 25 samples in reverse order for 1 s", reordered(25)),
        _passing("one position of 1000 rad", only_at_onset(field_set("position", 1e3))),
        _passing("one position of 1e308 rad", only_at_onset(field_set("position", 1e308))),
        _passing("one torque of 1000 N m", only_at_onset(field_set("effort", 1e3, FIRST_MOTOR))),
        _passing("one torque of 1e308 N m", only_at_onset(field_set("effort", 1e308, MOTORS))),
        _passing("positions NaN for 1 s", changed(field_set("position", np.nan))),
        _passing("one motor's position infinite for 1 s", changed(field_set("position", np.inf, FIRST_MOTOR))),
        _passing("torques NaN for 1 s", changed(field_set("effort", np.nan, MOTORS))),
        _passing("one position for three joints, for 1 s", changed(_shorter)),
        _passing("no torques for 1 s", changed(_without_effort)),
        _passing("joints in reverse order for 1 s", changed(_reversed_names)),
        _passing("all joints twice in a message, for 1 s", changed(_doubled_names)),
        _passing("wrong joint names for 1 s", _named("a", "b", "c")),
        _passing("no joint names for 1 s", _named()),
        _passing("names that control a terminal, for 1 s", _named("\x1b[2J", "\n", "\x07")),
        _passing("a million joint names", unread(lambda _: JointState(name=[f"j{k}" for k in range(MILLION)]))),
        _passing("an empty serialised message", unread(lambda _: b"")),
        _passing("junk bytes in place of samples, for 1 s", replaced(lambda _: b"\x00\x01\x00\x00junk of no kind")),
        _passing("truncated messages for 1 s", replaced(_truncated)),
        _passing("stamps zero for 1 s", changed(_stamped(0))),
        _passing("one stamp zero", only_at_onset(_stamped(0))),
        _passing("one stamp in the far future", only_at_onset(_stamped(LATEST))),
        _passing("one stamp before 1901", only_at_onset(_stamped(EARLIEST))),
        _passing("stamps with 3 s of nanoseconds, for 1 s", changed(_invalid_nanoseconds)),
        _passing("stamps in steps of 20 ms for 1 s", changed(_rounded)),
        _passing("the clock jumps one hour forward", shifted(3600.0)),
        _passing("the clock jumps one hour backward, before 1970", shifted(-3600.0)),
        _passing("the clock jumps 50 ms backward", shifted(-0.05)),
        _passing("the clock jumps 50 ms forward and, after 1 s, back", shifted(0.05, END)),
        _passing("link angle in degrees for 1 s", changed(field_scaled("position", DEGREES, LINK))),
        _passing("positions frozen for 1 s", frozen(END)),
        _lasting("sign of the torques flipped", changed(field_scaled("effort", -1.0, MOTORS), DURATION)),
        _lasting("sign of one torque flipped", changed(field_scaled("effort", -1.0, FIRST_MOTOR), DURATION)),
        _lasting("torques zero", changed(field_set("effort", 0.0, MOTORS), DURATION)),
        _lasting("torques of the motors exchanged", changed(_exchanged, DURATION)),
        _lasting("torques in N mm", changed(field_scaled("effort", 1e3, MOTORS), DURATION)),
        _lasting("one torque frozen", frozen(DURATION, "effort", FIRST_MOTOR)),
        _lasting("positions frozen", frozen()),
        _lasting("link angle frozen", frozen(DURATION, "position", LINK)),
        _lasting("one motor's position frozen", frozen(DURATION, "position", FIRST_MOTOR)),
        _lasting("link angle in degrees", changed(field_scaled("position", DEGREES, LINK), DURATION)),
        _lasting("link angle with the wrong sign", changed(field_scaled("position", -1.0, LINK), DURATION)),
    ]  # fmt: skip
