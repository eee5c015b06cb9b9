"""Typical sizes in a log, from which fits derive initial values and step sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.signals import Array
from via_sim.joint.layout import EXTERNAL, GOAL, POWER
from via_sim.joint.parameters import P

from via_gap.residual.inverse_dynamics import MissingTorque
from via_gap.residual.nuisance import BOUND
from via_gap.residual.segments import Segments

SCREENED = 80.0  # periods per turn, of any log
HIGHEST_ORDER = 1000.0  # periods per turn in the catalogue
AT_ONCE = 64  # orders
APART = 0.6  # least distance of two orders
KEPT_ORDERS = 2
FASTEST = 0.995  # quantile of the speed that counts as the largest: above it is encoder noise


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes over logs of one device.

    torque      (3,) [N m] typical torque on link, motor 1, motor 2; the drive of a rigid joint is motor 1
    missing     (3,) [N m] largest missing torque of link, motor 1, motor 2; infinite where it cannot be evaluated
    speed       (3,) [rad/s] root mean square
    peak        (2,) [N m] or [rad] largest command of each motor; for a position drive its largest torque
    slew        [rad/s] largest speed of a motor; for a position drive of the link
    angle       [rad] standard deviation of the link angle
    range       (6,) [rad] its least value, its 2, 10, 90 and 98 percent quantiles, and its largest value
    travel      (3,) [rad] between the smallest and the largest angle of each axis; of unseen motors that of the link
    deflection  [rad] standard deviation of the deflection
    stretch     [rad] its root mean square, which is larger under pretension
    duration    [s]
    busy        intervals [s] in which an effect that begins and ends explains most
    gravity     [N m] largest gravity torque of the device file at the end of its tolerance; infinite without one
    friction    (3,) [N m] dry friction of the device file at link, motor 1, motor 2
    orders      per axis: the strongest orders [periods per turn] of its missing torque
    """

    torque: Array
    missing: Array
    speed: Array
    peak: Array
    slew: float
    angle: float
    range: Array
    travel: Array
    deflection: float
    stretch: float
    duration: float
    busy: tuple[tuple[float, float], ...]
    gravity: float
    friction: Array
    orders: tuple[tuple[float, ...], ...]


def scales_of(segments: Sequence[Segments], missing: Sequence[MissingTorque | None]) -> Scales:
    """Sizes over some logs with the missing torque of each; `busy` is not known yet."""
    device = segments[0].log.device
    start = np.concatenate([each.start for each in segments])
    commands = np.concatenate([each.commands for each in segments])
    speed = np.sqrt(np.mean(np.nan_to_num(start[:, 3:6]) ** 2, axis=0))
    q = start[:, 0]
    angle = float(np.std(q))
    seen = np.isfinite(start[:, :3]).all(axis=0)
    travel = np.where(seen, np.ptp(np.nan_to_num(start[:, :3]), axis=0), np.ptp(q))
    peak = np.max(np.abs(commands[:, :2]), axis=0)
    acceleration = float(np.std(np.gradient(start[:, 3], 1.0 / segments[0].rate)))
    link, motors = device.link, device.n_motors
    gravity = link.gravity_torque * (1.0 + BOUND * device.tolerances.gravity)
    torque = np.zeros(3)
    torque[0] = (
        link.inertia * acceleration + link.viscous_friction * speed[0] + abs(link.gravity_torque) * min(angle, 1)
    )
    deflection = stretch = 0.1
    if motors:
        if device.drive == "torque":
            torque[1 : 1 + motors] = np.std(commands[:, :motors], axis=0)
        theta = np.where(np.isfinite(start[:, 1]), start[:, 1], commands[:, 0] if device.drive == "servo" else q)
        deflection = max(float(np.std(q - theta)), 0.02 * angle)
        stretch = max(float(np.sqrt(np.mean((q - theta) ** 2))), deflection)
    else:
        pull, drive = _drive_torque(device, commands, start)
        speed[1], torque[1], peak[0] = speed[0], np.std(drive), np.max(np.abs(pull))
        torque[0] = max(torque[0], torque[1])  # of a light axis with much dry friction, inertia and gravity say little
    speed = np.where(speed > 0.0, speed, max(float(speed.max()), 1e-3))
    torque = np.maximum(torque, 1e-3 * max(float(torque.max()), 1e-3))
    slew = 1.0
    if device.drive == "servo":  # largest speed after the largest step of the command: bandwidth times step over e
        reach = max(float(np.ptp(each.commands[:, 0])) + _first_step(each) for each in segments)
        slew = max(getattr(motor, "bandwidth", 1.0) for motor in device.motors) * reach / np.e
    elif device.drive == "position":
        slew = float(np.quantile(np.abs(start[:, 3]), FASTEST))
    orders = [_orders(segments, missing, axis) for axis in range(3)]
    if not motors:
        orders[1] = orders[0]
    return Scales(
        torque, _largest(missing), speed, peak, max(float(slew), 1e-3), max(angle, 1e-3),
        np.quantile(q, [0.0, 0.02, 0.1, 0.9, 0.98, 1.0]), travel, max(deflection, 1e-3), max(stretch, 1e-3),
        max(each.log.duration for each in segments), (), gravity if gravity > 0.0 else np.inf,
        segments[0].nominal[P.kinetic_friction : P.kinetic_friction + 3], tuple(orders),
    )  # fmt: skip


def _largest(missing: Sequence[MissingTorque | None]) -> Array:
    """(3,) [N m] largest missing torque of each axis in any log; infinite for an axis that one log lacks."""
    largest = np.zeros(3)
    for each in missing:
        of_log = np.full(3, np.inf)
        if each is not None and len(each.torque):
            of_log[list(each.axes)] = np.abs(each.torque).max(axis=0)
        largest = np.maximum(largest, of_log)
    return largest


def _drive_torque(device: Device, commands: Array, start: Array) -> tuple[Array, Array]:
    """Torque (T,) [N m] of the drive of a rigid joint without its damping, and with it."""
    if device.servo is None:
        return commands[:, EXTERNAL], commands[:, EXTERNAL]
    error, on, speed = commands[:, GOAL] - start[:, 0], commands[:, POWER], start[:, 3]
    return on * device.servo.torque(error, 0.0 * speed), on * device.servo.torque(error, speed)


def _first_step(segments: Segments) -> float:
    """[rad] from the initial angle of motor 1 to its first command."""
    step = abs(float(segments.commands[0, 0] - segments.rest[1]))
    return step if np.isfinite(step) else 0.0


def _orders(segments: Sequence[Segments], missing: Sequence[MissingTorque | None], axis: int) -> tuple[float, ...]:
    """The orders whose sine and cosine over the angle of the axis explain most of its missing torque."""
    pairs = [(s, m) for s, m in zip(segments, missing, strict=True) if m is not None and axis in m.axes]
    if not pairs:
        return (1.0,)
    angle = np.concatenate([s.start[m.centre, axis] for s, m in pairs])
    values = np.concatenate([m.torque[:, m.axes.index(axis)] for _, m in pairs])
    kept: list[float] = []
    for _ in range(KEPT_ORDERS):
        kept.append(strongest_order(angle, values - values.mean(), kept, highest_order(angle)))
    return tuple(kept)


def highest_order(angle: Array) -> float:
    """The most periods per turn that windows with these angles (W,) [rad] in their middle show, in order of time.

    Windows overlap by half. Beyond two steps per period, a window contains a whole period, which averages out.
    """
    step = float(np.mean(np.abs(np.diff(angle)))) if len(angle) > 1 else 0.0
    return min(max(np.pi / max(step, 1e-9), SCREENED), HIGHEST_ORDER)


def strongest_order(angle: Array, values: Array, taken: Sequence[float], highest: float) -> float:
    """The order up to `highest`, not yet taken, that explains most of values (W,) by its waves over the angle (W,)."""
    # not whole numbers, which a fit would keep
    orders = 1e-6 + np.concatenate([np.arange(1.0, 12.0, 0.25), np.arange(12.0, highest, 1.0)])
    power = power_of(orders, angle, values)
    power[[any(abs(order - other) < APART for other in taken) for order in orders]] = 0.0
    return float(orders[int(np.argmax(power))])


def power_of(orders: Array, angle: Array, values: Array) -> Array:
    """(K,) squares of values (W,) that sine and cosine of each order over the angle (W,) explain, the mean aside."""
    power = np.empty(len(orders))
    for first in range(0, len(orders), AT_ONCE):
        waves = np.exp(1j * orders[first : first + AT_ONCE, None] * angle)
        waves -= waves.mean(axis=1, keepdims=True)
        squares = np.maximum(np.sum(np.abs(waves) ** 2, axis=1), 1.0)
        power[first : first + AT_ONCE] = np.abs(waves @ values) ** 2 / squares
    return power
