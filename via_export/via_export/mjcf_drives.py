"""Actuators of the drives of a joint in MuJoCo: torque drives, servos and position drives."""

from __future__ import annotations

from math import isfinite

from via_core.spring_equations import N_COEFFICIENTS, spring_torque
from via_core.springs import MaccepaSpring
from via_sim.joint.parameters import POSITION_DRIVE, P

from via_export.mjcf_timing import lag_filter, late
from via_export.target import Target
from via_export.xml import Attributes, Element, element

STIFF = 1e7  # torque of a servo over that of its springs, per radian
NOT_A_SERVO = 1e-9  # of a gain: it differs from the bias, or a positive third bias is taken for a damping ratio
STEEP = 20.0  # damping of a servo beyond its speed limit over that below it


def servo_inertia(target: Target, axis: int) -> float:
    """[kg m^2] with which the torque of the springs turns a servo by less than 1/STIFF rad."""
    torque = 0.0
    for i, spring in enumerate(target.device.springs):
        start = P.spring + i * N_COEFFICIENTS
        scale, c = float(target.row[P.spring_scale + i]), target.row[start : start + N_COEFFICIENTS].copy()
        torque += max(
            abs(scale * spring_torque(spring.kind, c, x * spring.max_deflection, 1.0)) for x in (0.25, 0.5, 1.0)
        )
    return STIFF * torque / target.of_axis(P.bandwidth, axis - 1) ** 2


def limited(what: str, ends: tuple[float, float]) -> Attributes:
    """Attributes of a range of control or force, stated as a limit: `autolimits` of a given model can be false."""
    return {f"{what}range": ends, f"{what}limited": True} if all(map(isfinite, ends)) else {}


def drive(target: Target, axis: int, name: str) -> Element:
    """The actuator of a drive: torque, servo or position."""
    row = target.row
    if target.is_servo(axis):
        return _servo(target, axis, name)
    gain, bias = target.of_axis(P.torque_gain, axis), target.of_axis(P.torque_bias, axis)
    limit = target.limit(axis)
    common: Attributes = {"name": f"{name}_drive", "joint": name, **late(target)}
    if row[P.link_drive] != POSITION_DRIVE:
        affine: Attributes = {"biastype": "affine", "biasprm": (bias, 0.0, 0.0)} if bias else {}
        return element(
            "general", **common, gainprm=gain, **affine, **limited("ctrl", (-limit, limit)), **lag_filter(target)
        )
    kp, kd = gain * float(row[P.drive_stiffness]), float(row[P.drive_damping])
    # kv of MuJoCo's position actuator counts for the force range; damping of the actuator does not
    kv = kd if row[P.drive_limits_sum] or not isfinite(limit) else 0.0
    common |= limited("force", (bias - gain * limit, bias + gain * limit))
    common |= {"input": "pos", "biastype": "affine", "biasprm": (bias, -kp, -kv)}
    if kd != kv:
        common["damping"] = (kd - kv, 0.0, 0.0)
    speed = float(row[P.drive_speed_limit])
    if isfinite(speed) or target.integral_gain > 0.0:
        return element("general", **common, **_pid(target, gain, speed))
    return element("general", **common, gainprm=kp, **lag_filter(target))


def _pid(target: Target, gain: float, speed: float) -> Attributes:
    """The element `pid` as a general actuator, because `pid` has no constant torque. 0 stands for: no limit.

    MuJoCo limits the integral of the error itself.
    """
    ki, most = target.integral_gain, target.integral_limit
    slews = isfinite(speed)
    return {
        "gaintype": "pid", "gainprm": gain * ki, "dyntype": "pid", "actdim": float(slews) + float(ki > 0.0),
        "dynprm": (most / ki if ki > 0.0 and isfinite(most) else 0.0, speed if slews else 0.0),
    }  # fmt: skip


def _servo(target: Target, axis: int, name: str) -> Element:
    """x'' = w^2 (u - x) - 2 w x' of a heavy body; on a slide the actuator's gear converts to the angle of the drum.

    A speed limit v: of the damping STEEP 2 w, that beyond 2 w is compensated by the actuator, whose force is limited to
    STEEP 2 w v. At that limit the body keeps its speed, and below it the compensation is exact.

    A servo follows the true angle: an encoder offset shifts its log alone.
    """
    w, device = target.of_axis(P.bandwidth, axis - 1), target.device
    w = w / (1.0 + 0.5 * w * float(target.row[P.lag]))
    inertia, gear = servo_inertia(target, axis), 1.0
    spring = device.springs[min(axis, device.n_transmissions) - 1]
    if device.arrangement == "serial" and axis == 2 and isinstance(spring, MaccepaSpring):
        gear = 1.0 / spring.drum_radius
    gain, damping = inertia * w * w / gear**2, 2.0 * inertia * w / gear**2
    speed, compensated = target.of_axis(P.saturation, axis), 0.0
    ends: Attributes = {}
    if isfinite(speed):
        compensated = (STEEP - 1.0) * damping
        ends = limited("force", (-STEEP * damping * speed, STEEP * damping * speed))
    return element(
        "general", name=f"{name}_drive", joint=name, gear=gear, gainprm=gain * (1.0 + NOT_A_SERVO), biastype="affine",
        biasprm=(gain * target.of_axis(P.encoder_offset, axis), -gain, compensated),
        damping=(damping + compensated, 0.0, 0.0), input="pos", **ends, **late(target),
    )  # fmt: skip
