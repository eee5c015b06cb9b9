"""Torque equations of a joint in weak form, as parts that state both a signal and how sensor noise enters it.

Signs as in docs/notation.md. With a modulating function psi over a window (`via_core.weak_form`), each equation is

    r = sum_j x_j f_j - y,        f_j = sum of factor * <values, psi^(i)>

    motor   B <th, psi''> - D <th, psi'> + F <sgn thd, psi> + d <tau, psi'> - <tau_e(phi), psi> = <tau, psi>
    link    M <q, psi''> - Dq <q, psi'> + Fq <sgn qd, psi> + sum <tau_e, psi> + damper + <g(q), psi> = <tau, psi>
    torque sensor      sum <tau_e, psi> + damper = <tau_link, psi>
    servo              <th, psi''> = w^2 <u - th, psi> + 2 w <th, psi'>, linear in the change of w
    position drive     kp <goal - q + z, psi> + limit <side, psi> + kd <q, psi'> = <tau, psi>,  z' = (ki / kp)(goal - q)
    velocity sensor    <v, psi> + <angle, psi'> = 0

A motor needs a measured torque, and so does the link of a rigid joint with torque drive. The right side of any other
link is zero: no external torque acts.
A damper d(u) acts on the velocity v of an angle x by d v = (d x)' - d' x, so that no velocity is needed.

Unknowns are relative to the device file. A spring law that depends on its deflection alone is a polynomial that fits
the filed torque to 1 % over the deflections visited, with one term more; its unknowns are the stiffnesses at as many
deflections: the same basis, in numbers that mean something. Any other spring law has one unknown, its gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from via_core.device_parts import PositionDrive, ServoMotor, TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Mask
from via_core.spring_equations import MACCEPA, TWO_LEVER
from via_core.springs import SpringLaw

from via_estimators.joint_record import Record

PSI, SLOPE, BEND, HELD = range(4)  # weights: <f, psi>, <f, psi'>, <f, psi''>; <f, psi> of values held over intervals
REACH = 0.025  # [s] to each side, over which the direction of a motion is measured
MOST_TERMS = 6  # of a spring law's polynomial
FITS = 0.01  # misfit of the polynomial over the largest torque
NARROWEST = 0.1  # [stops] least range of deflections over which stiffness is described


class Part(NamedTuple):
    """factor * <values, psi^(i)>; slopes[c] (N,) is the derivative of `values` by a sample of channel c."""

    weights: int
    factor: float
    values: Array
    slopes: Mapping[str, Array]


@dataclass(frozen=True)
class Unknown:
    """A quantity of the device.

    value      by the device file, in `unit`
    size       > 0, the unit of relative standard deviations: |value|, or a typical size where that is 0
    tolerance  relative standard deviation that the device file states
    part       of the joint: 'motor 1', 'spring 1', 'link', 'damper', 'drive', 'servo 1'
    deflection [rad] of a stiffness
    """

    name: str
    part: str
    value: float
    size: float
    unit: str
    tolerance: float
    deflection: float | None = None


@dataclass(frozen=True)
class Equation:
    """One torque equation: parts by the name of their unknown, and the known side y."""

    name: str
    unknown: dict[str, tuple[Part, ...]]
    known: tuple[Part, ...]


@dataclass
class Equations:
    """The equations that some signals allow, and their unknowns."""

    unknowns: list[Unknown] = field(default_factory=list)
    equations: list[Equation] = field(default_factory=list)

    def name(self, unknown: Unknown) -> str:
        """Its name; the unknown is added at first use."""
        if all(each.name != unknown.name for each in self.unknowns):
            self.unknowns.append(unknown)
        return unknown.name


def equations_of(device: Device, record: Record) -> Equations:
    """The equations that the channels of a record allow. Raises ParameterError without the link angle."""
    if "q" not in record.channels:
        raise ParameterError("the link angle is not measured: no equation of the joint can be evaluated")
    made, signals = Equations(), _Signals(device, record)
    if signals.angles_known:
        springs = [signals.spring(made, i) for i in range(device.n_transmissions)]
        for i, motor in enumerate(device.motors):
            if isinstance(motor, TorqueMotor) and f"tau_{i + 1}" in record.channels:
                made.equations.append(_motor(made, signals, i, motor, springs))
            if isinstance(motor, ServoMotor) and f"servo_{i + 1}" in record.commands:
                made.equations.append(_servo(made, signals, i, motor))
        # the torque of a rigid joint's drive acts on its link: without it the equation has no right side
        if device.arrangement != "rigid" or device.drive == "position" or "tau_1" in record.channels:
            made.equations.append(_link(made, signals, springs))
        if "tau_link" in record.channels:
            made.equations.append(_torque_sensor(made, signals, springs))
        if device.drive == "position" and "tau_1" in record.channels and "goal" in record.commands:
            made.equations.append(Equation("drive", _drive(made, signals), signals.held("tau_1")))
    for angle in [name for name in record.channels if name == "q" or name.startswith("theta_")]:
        speed = "q_velocity" if angle == "q" else angle.replace("theta", "theta_velocity")
        if speed in record.channels:
            sides = (signals.plain(PSI, 1.0, speed), signals.plain(SLOPE, 1.0, angle))
            made.equations.append(Equation(f"velocity of {angle}", {}, sides))
    return made


@dataclass(frozen=True)
class _Signals:
    """Parts made from the samples of a record."""

    device: Device
    record: Record

    @property
    def angles_known(self) -> bool:
        """Whether the angles of all motors are measured."""
        return all(f"theta_{i + 1}" in self.record.channels for i in range(self.device.n_motors))

    @property
    def theta(self) -> Array:
        """(N, m) [rad]."""
        empty = np.empty((len(self.record.time), 0))
        return np.column_stack([empty, *(self.record.channels[f"theta_{i + 1}"] for i in range(self.device.n_motors))])

    def plain(self, weights: int, factor: float, name: str) -> Part:
        """factor * <channel, psi^(i)>."""
        return Part(weights, factor, self.record.channels[name], {name: np.ones(len(self.record.time))})

    def held(self, name: str) -> tuple[Part, ...]:
        """A drive's torque, which acted over the interval that ends at its stamp."""
        return (self.plain(HELD, 1.0, name),)

    def sign(self, name: str) -> Part:
        """<sign of the velocity, psi>; near rest, where the change is within the noise, less than 1."""
        values, time = self.record.channels[name], self.record.time
        change = np.interp(time + REACH, time, values) - np.interp(time - REACH, time, values)
        step = max(4.0 * self.record.noise.get(name, 0.0), 1e-9)
        return Part(PSI, 1.0, np.clip(change / step, -1.0, 1.0), {})

    def damped(self, factor: float, share: Array, names: Mapping[str, float]) -> tuple[Part, ...]:
        """factor * <share x', psi>, x the sum of channels with these factors: <(share x)' - share' x, psi>."""
        change, parts = np.gradient(share, self.record.time), []
        for name, sign in names.items():
            centred = self.record.channels[name] - np.median(self.record.channels[name])
            parts.append(Part(SLOPE, -factor * sign, share * centred, {name: share}))
            parts.append(Part(PSI, -factor * sign, change * centred, {name: change}))
        return tuple(parts)

    def damper(self) -> Array:
        """d (N,) [N m s/rad] by the device file at the damper commands; without commands at u = 0."""
        return self.device.damping_of(self.record.commands.get("damping", np.zeros(len(self.record.time))))

    def spring(self, made: Equations, i: int) -> dict[str, tuple[Part, ...]]:
        """<tau_e,i, psi> by unknowns, which are added to `made`."""
        spring, tolerance, channels = self.device.springs[i], self.device.tolerances.spring, self.record.channels
        phi, angle = channels["q"] - channels[f"theta_{i + 1}"], f"theta_{i + 1}"
        if spring.kind in (MACCEPA, TWO_LEVER) or self.device.drive != "torque":
            gain = made.name(Unknown(f"gain of spring {i + 1}", f"spring {i + 1}", 1.0, 1.0, "-", tolerance))
            torque = self.device.torque_each(channels["q"], self.theta)[:, i]
            sigma = self.device.stiffness_each(channels["q"], self.theta)[:, i]
            slopes = {"q": sigma, angle: -sigma}
            if self.device.arrangement == "serial":
                preset, step = self.theta.copy(), 1e-6
                preset[:, 1] += step
                slopes["theta_2"] = (self.device.torque_each(channels["q"], preset)[:, i] - torque) / step
            return {gain: (Part(PSI, 1.0, torque, slopes),)}
        found: dict[str, tuple[Part, ...]] = {}
        scale, (powers, nodes) = spring.max_deflection, _basis(spring, phi)
        stiff = np.array([[(x / scale) ** (p - 1) for p in powers if p > 0] for x in nodes])
        shares = np.linalg.inv(stiff)  # coefficients (terms, nodes) of the polynomial that is 1 at one node
        z, sizes = phi / scale, spring.stiffness(nodes)
        size = max(float(np.sqrt(np.mean(sizes**2))), 1e-9)
        for j, node in enumerate(nodes):
            terms = [(p, c) for p, c in zip([p for p in powers if p > 0], shares[:, j])]
            values, slope = sum(c * scale * z**p / p for p, c in terms), sum(c * z ** (p - 1) for p, c in terms)
            unknown = Unknown(
                f"stiffness of spring {i + 1} at {node:.3g} rad", f"spring {i + 1}", float(sizes[j]), size, "N m/rad",
                tolerance, float(node),
            )  # fmt: skip
            found[made.name(unknown)] = (Part(PSI, 1.0, np.asarray(values), {"q": np.asarray(slope), angle: -slope}),)
        if 0 in powers:
            offset = Unknown(
                f"torque of spring {i + 1} at rest",
                f"spring {i + 1}",
                float(spring.torque(0.0)),
                size * scale,
                "N m",
                1.0,
            )
            found[made.name(offset)] = (Part(PSI, 1.0, np.ones(len(phi)), {}),)
        return found


def _basis(spring: SpringLaw, phi: Array) -> tuple[list[int], Array]:
    """Powers of the deflection in the torque, and one deflection [rad] per power > 0, at which stiffness is unknown.

    Odd powers fit an odd spring law over 0 to the largest |phi|; all powers fit any other one over the range of phi.
    """
    stop = spring.max_deflection
    share = np.linspace(-stop, stop, 129)
    odd = bool(np.abs(spring.torque(share) + spring.torque(-share)).max() <= 1e-6 * np.abs(spring.torque(share)).max())
    low, high = np.quantile(np.abs(phi) if odd else phi, (0.01, 0.99))
    middle, half = 0.5 * (low + high), 0.5 * max(high - low, NARROWEST * stop)
    middle = max(middle, half) if odd else middle
    at = np.linspace(0.0 if odd else middle - half, middle + half, 129)
    torque, order = spring.torque(at), 1
    while order < MOST_TERMS:
        terms = (at[:, None] / stop) ** (2 * np.arange(order) + 1 if odd else np.arange(order + 1))
        if np.abs(torque - terms @ np.linalg.lstsq(terms, torque)[0]).max() <= FITS * np.abs(torque).max():
            break
        order += 1
    count = min(order + 1, MOST_TERMS)
    points = np.cos(np.pi * (np.arange(count)[::-1] + 0.5) / count)
    powers = [2 * k + 1 for k in range(count)] if odd else list(range(count + 1))
    return powers, np.asarray(middle + half * points)


def _motor(
    made: Equations, signals: _Signals, i: int, motor: TorqueMotor, springs: list[dict[str, tuple[Part, ...]]]
) -> Equation:
    """B <th, psi''> - D <th, psi'> + F <sgn thd, psi> + d <tau, psi'> - <tau_e, psi> = <tau, psi>."""
    part, angle, torque, tolerances = f"motor {i + 1}", f"theta_{i + 1}", f"tau_{i + 1}", signals.device.tolerances
    dry = max(motor.coulomb_friction, _typical_torque(signals.device))
    names = [
        made.name(Unknown(f"{what} of {part}", part, value, size, unit, tolerance))
        for what, value, size, unit, tolerance in (
            ("inertia", motor.inertia, motor.inertia, "kg m^2", tolerances.motor_inertia),
            ("viscous friction", motor.viscous_friction, max(motor.viscous_friction, 1e-6), "N m s/rad",
             tolerances.motor_friction),
            ("dry friction", motor.coulomb_friction, dry, "N m", 1.0),
            ("torque delay", 0.0, 0.003, "s", 1.0),
        )
    ]  # fmt: skip
    parts = (
        signals.plain(BEND, 1.0, angle), signals.plain(SLOPE, -1.0, angle), signals.sign(angle),
        signals.plain(SLOPE, 1.0, torque),
    )  # fmt: skip
    unknown: dict[str, tuple[Part, ...]] = {name: (each,) for name, each in zip(names, parts, strict=True)}
    if i < len(springs):
        for name, each in (*springs[i].items(), *(_transmission_damper(made, signals).items() if i == 0 else ())):
            unknown[name] = tuple(p._replace(factor=-p.factor) for p in each)
    return Equation(part, unknown, signals.held(torque))


def _link(made: Equations, signals: _Signals, springs: list[dict[str, tuple[Part, ...]]]) -> Equation:
    """The equation of the link; its right side is the drive's torque of a rigid joint, else zero."""
    device, channels = signals.device, signals.record.channels
    link, tolerances = device.link, device.tolerances
    inertia = Unknown("inertia of the link", "link", link.inertia, link.inertia, "kg m^2", tolerances.link_inertia)
    viscous = Unknown(
        "viscous friction of the link", "link", link.viscous_friction, max(link.viscous_friction, 1e-3), "N m s/rad",
        tolerances.link_friction,
    )  # fmt: skip
    unknown: dict[str, tuple[Part, ...]] = {
        made.name(inertia): (signals.plain(BEND, 1.0, "q"),),
        made.name(viscous): (signals.plain(SLOPE, -1.0, "q"),),
        _link_friction(made, device): (signals.sign("q"),),
    }
    if link.gravity_torque != 0.0:
        size, angle = abs(link.gravity_torque), channels["q"] - link.gravity_angle
        gravity = Unknown("gravity torque", "link", link.gravity_torque, size, "N m", tolerances.gravity)
        unknown[made.name(gravity)] = (Part(PSI, 1.0, np.sin(angle), {"q": np.cos(angle)}),)
    for spring in springs:
        unknown |= spring
    unknown |= _transmission_damper(made, signals)
    if device.damper is not None and device.damper.site == "link":
        unknown[_damper(made, device)] = signals.damped(1.0, signals.damper(), {"q": 1.0})
    known: tuple[Part, ...] = ()
    if not device.n_motors and "tau_1" in channels:
        known = signals.held("tau_1")
    elif device.drive == "position" and "goal" in signals.record.commands:
        for name, parts in _drive(made, signals).items():
            unknown[name] = tuple(p._replace(factor=-p.factor) for p in parts)
    return Equation("link", unknown, known)


def _torque_sensor(made: Equations, signals: _Signals, springs: list[dict[str, tuple[Part, ...]]]) -> Equation:
    """The torque between link and motors; of a rigid joint the torque that its damper and dry friction dissipate."""
    unknown: dict[str, tuple[Part, ...]] = {}
    for each in springs:
        unknown |= each
    unknown |= _transmission_damper(made, signals)
    device = signals.device
    if device.arrangement == "rigid" and device.damper is not None and device.damper.site == "link":
        unknown[_damper(made, device)] = signals.damped(1.0, signals.damper(), {"q": 1.0})
        unknown[_link_friction(made, device)] = (signals.sign("q"),)
    return Equation("torque sensor", unknown, (signals.plain(PSI, 1.0, "tau_link"),))


def _servo(made: Equations, signals: _Signals, i: int, servo: ServoMotor) -> Equation:
    """Linear in the bandwidth's change: <th, psi''> - w^2 <u - th, psi> - 2 w <th, psi'> at the filed w is known."""
    w, angle = servo.bandwidth, f"theta_{i + 1}"
    values, one = signals.record.channels[angle], np.ones(len(signals.record.time))
    error = signals.record.commands[f"servo_{i + 1}"] - values
    name = made.name(
        Unknown(f"bandwidth of servo {i + 1}", f"servo {i + 1}", w, w, "rad/s", signals.device.tolerances.bandwidth)
    )
    slope = (Part(PSI, -2.0 * w, error, {angle: -one}), signals.plain(SLOPE, -2.0, angle))
    # r = (r(w) - w dr/dw) + w dr/dw, so that the unknown is the bandwidth itself
    known = (signals.plain(BEND, -1.0, angle), Part(PSI, -w * w, error, {angle: -one}))
    return Equation(f"servo {i + 1}", {name: slope}, known)


def _drive(made: Equations, signals: _Signals) -> dict[str, tuple[Part, ...]]:
    """Torque of a position drive by its gains and its limit."""
    servo, tolerances, channels = signals.device.servo, signals.device.tolerances, signals.record.channels
    assert servo is not None
    goal = signals.record.commands["goal"]
    on, error = np.isfinite(goal), np.where(np.isfinite(goal), goal - channels["q"], 0.0)
    integral, began = _integral(servo, error, on, signals.record.time)
    pull, whole = servo.kp * (error + integral), servo.limited == "sum"
    if whole:
        pull = pull - servo.kd * channels.get("q_velocity", np.gradient(channels["q"], signals.record.time))
    limited = on & (np.abs(pull) > (servo.torque_limit or np.inf))
    free = (on & ~limited).astype(np.float64)
    damped = free if whole else on.astype(np.float64)
    kp = made.name(Unknown("position gain", "drive", servo.kp, servo.kp, "N m/rad", tolerances.kp))
    kd = made.name(Unknown("velocity gain", "drive", servo.kd, max(servo.kd, 1e-6), "N m s/rad", tolerances.kd))
    found = {
        kp: (Part(PSI, 1.0, free * (error + integral), {"q": -free}),),
        kd: signals.damped(-1.0, damped, {"q": 1.0}),
    }
    if servo.ki > 0.0 and began.any():
        most = min(servo.integral_limit or np.inf, servo.torque_limit or np.inf, servo.kp)
        start = Unknown("torque of the integral at the start", "drive", 0.0, most, "N m", 1.0)
        found[made.name(start)] = (Part(PSI, 1.0, free * began, {}),)
    if servo.torque_limit is not None and limited.any():
        limit = Unknown(
            "torque limit of the drive", "drive", servo.torque_limit, servo.torque_limit, "N m", tolerances.torque_limit
        )
        found[made.name(limit)] = (Part(PSI, 1.0, np.where(limited, np.sign(pull), 0.0), {}),)
    return found


def _integral(servo: PositionDrive, error: Array, on: Mask, time: Array) -> tuple[Array, Mask]:
    """(N,) [rad] integral of the error since the drive was switched on, times ki / kp; whether it began before."""
    total = np.concatenate(([0.0], np.cumsum(0.5 * (error[1:] + error[:-1]) * np.diff(time))))
    off = np.maximum.accumulate(np.where(on, -1, np.arange(len(on))))
    return servo.ki / servo.kp * (total - total[np.maximum(off, 0)]), on & (off < 0)


def _link_friction(made: Equations, device: Device) -> str:
    """Unknown dry friction of the link."""
    filed, typical = device.link.coulomb_friction, 0.05 * abs(device.link.gravity_torque) or _typical_torque(device)
    return made.name(Unknown("dry friction of the link", "link", filed, max(filed, typical), "N m", 1.0))


def _damper(made: Equations, device: Device) -> str:
    """Unknown factor of the damper's map."""
    return made.name(Unknown("scale of the damper", "damper", 1.0, 1.0, "-", device.tolerances.damper))


def _transmission_damper(made: Equations, signals: _Signals) -> dict[str, tuple[Part, ...]]:
    """Torque of a damper beside spring 1, if there is one."""
    device = signals.device
    if device.damper is None or device.damper.site != "transmission":
        return {}
    return {_damper(made, device): signals.damped(1.0, signals.damper(), {"q": 1.0, "theta_1": -1.0})}


def largest_torque(device: Device) -> float:
    """[N m] of the springs at their stops or of a position drive, at most the torque limit of the motors; else 0."""
    drive = (device.servo.torque_limit or 0.0) if device.servo is not None else 0.0
    limits = [motor.torque_limit or np.inf for motor in device.motors if isinstance(motor, TorqueMotor)]
    torques = [abs(float(spring.torque(spring.max_deflection))) for spring in device.springs]
    return min([max([*torques, drive]), *limits])


def _typical_torque(device: Device) -> float:
    """[N m] order of size of an unknown dry friction: a twentieth of that of springs, or of a damper at 1 rad/s."""
    damper = float(device.damping_of(1.0)) if device.damper is not None else 0.0
    return max(0.05 * largest_torque(device), 0.05 * damper, 1e-3)
