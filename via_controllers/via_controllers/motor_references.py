"""Where the motors of a joint of variable stiffness must stand, for a link at rest at q with stiffness sigma.

    sum_i tau_e,i(q - theta_i) + g(q) = 0,      sum_i sigma_i(q - theta_i) = sigma

With theta = (x + s, x - s) of an antagonistic joint, theta = (x, s) of a serial one, there is one x for every preset s
as long as the joint's stiffness is positive; s is then a root of the second equation: two searches, one unknown each.
Levers may balance at several x, or at none: where the search meets a jump between them, it looks elsewhere.
Both searches are compiled, so that a reference can be followed at 1 kHz.
Source of the search: T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear
function without using derivatives, Advances in Engineering Software 28 (1997).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, isnan, nan, sin, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.signals import Array
from via_core.springs import spring_stiffness, spring_torque

from via_controllers.contract import require

WITHIN = 1e-12  # [rad] of motor angles
BALANCED = 1e-12  # [N m] that rounding leaves of two springs against each other
NEAR = 1e-6  # of a stiffness, at least 1 N m/rad
CANDIDATES = 33  # presets that are tried where stiffness is not between those of the ends
STEPS = 200  # of a search; bisection alone needs 50

# What the kernels know of a joint: kinds (k,) and coefficients (k, 8) of its springs, by how many presets their motors
# stand off x (k,), whether the preset is a motor of its own, the stop [rad], gravity's torque [N m] and angle [rad].
Joint = tuple[Array, Array, Array, bool, float, float, float]


class UnreachableError(ViaError):
    """No motor angles give this stiffness at this angle; the message has what there is."""


@dataclass(frozen=True)
class MotorReferences:
    """References of one device. Raises ParameterError for a joint whose stiffness no motor varies."""

    device: Device
    presets: tuple[float, float]  # [rad] the range of s to use
    _joint: Joint = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        varies = self.device.arrangement in ("antagonistic", "serial")
        require(varies, f"device: '{self.device.name}' has no preset: it is {self.device.arrangement}")
        low, high = self.presets
        require(isfinite(low) and isfinite(high) and low < high, f"presets must be a range, got {self.presets}")
        object.__setattr__(self, "presets", (float(low), float(high)))
        object.__setattr__(self, "_joint", _joint_of(self.device))

    @classmethod
    def from_device(cls, device: Device, share: float = 0.95) -> MotorReferences:
        """Presets from 0 to a `share` of the springs' stop, beyond which a link that moves would meet it at once."""
        require(0.0 < share < 1.0, f"share must lie between 0 and 1, got {share}")
        stops = [law.max_deflection for law in device.spring_laws]
        return cls(device, (0.0, share * min(stops, default=1.0)))

    def at(self, q: float, stiffness: float) -> Array:
        """Motor angles (2,) [rad] for rest at `q` [rad] with `stiffness` [N m/rad]; raises UnreachableError."""
        require(isfinite(q) and isfinite(stiffness), f"q and stiffness must be finite, got {q} and {stiffness}")
        q, stiffness = float(q), float(stiffness)
        preset = _preset(self._joint, q, stiffness, *self.presets)
        if not isnan(preset):
            return self.device.motor_angles(_rest(self._joint, q, preset), preset)
        values = self._stiffnesses(q)
        there = f"{min(values):.4g} to {max(values):.4g} N m/rad are reached" if values else "it cannot rest there"
        raise UnreachableError(f"'{self.device.name}' at {q:.4g} rad has no stiffness {stiffness:.4g} N m/rad: {there}")

    def stiffness_range(self, q: float) -> tuple[float, float]:
        """Least and largest stiffness [N m/rad] at `q` [rad]; raises UnreachableError where no rest is."""
        values = self._stiffnesses(q)
        if not values:
            raise UnreachableError(f"'{self.device.name}' cannot rest at {q:.4g} rad")
        return min(values), max(values)

    def stiffness(self, q: float, preset: float) -> float:
        """Of the joint at rest at `q` [rad] with `preset` [rad] [N m/rad]; raises UnreachableError beyond a stop."""
        value = float(_stiffness(self._joint, float(q), float(preset)))
        if isnan(value):
            raise _no_rest(self.device, q, preset)
        return value

    def _stiffnesses(self, q: float) -> list[float]:
        """Those [N m/rad] with the presets to try, as far as the link can rest there."""
        low, high = self.presets
        values = (float(_stiffness(self._joint, float(q), _candidate(low, high, k))) for k in range(CANDIDATES))
        return [value for value in values if not isnan(value)]


def resting(device: Device, q: float, preset: float) -> float:
    """x [rad] with which a link rests at `q` [rad] while the motors stand at `device.motor_angles(x, preset)`.

    Raises UnreachableError where there is none within the springs' stops.
    """
    x = float(_rest(_joint_of(device), float(q), float(preset)))
    if isnan(x):
        raise _no_rest(device, q, preset)
    return x


def _no_rest(device: Device, q: float, preset: float) -> UnreachableError:
    return UnreachableError(f"'{device.name}' cannot rest at {q:.4g} rad with preset {preset:.4g} rad")


def _joint_of(device: Device) -> Joint:
    laws, link = device.spring_laws, device.link
    return (
        np.array([law.kind for law in laws]),
        np.array([law.coefficients() for law in laws]),
        np.array([1.0, -1.0] if device.arrangement == "antagonistic" else [0.0]),
        device.arrangement == "serial",
        float(min(law.max_deflection for law in laws)),
        float(link.gravity_torque),
        float(link.gravity_angle),
    )


@njit(cache=True, error_model="numpy")
def _candidate(low: float, high: float, k: int) -> float:
    """Preset [rad] number k of CANDIDATES."""
    return low + (high - low) * k / (CANDIDATES - 1)


@njit(cache=True, error_model="numpy")
def _preset(joint: Joint, q: float, stiffness: float, low: float, high: float) -> float:
    """s [rad] with which the joint is so stiff [N m/rad] at rest at q [rad]; NaN where none is found."""
    found = _preset_between(joint, q, stiffness, low, high)
    before = nan
    for k in range(CANDIDATES):
        if not isnan(found):
            break
        here = _candidate(low, high, k)
        if isnan(_stiffness(joint, q, here)):
            continue
        if not isnan(before):
            found = _preset_between(joint, q, stiffness, before, here)
        before = here
    return found


@njit(cache=True, error_model="numpy")
def _preset_between(joint: Joint, q: float, stiffness: float, low: float, high: float) -> float:
    """As `_preset`; NaN where the ends do not enclose one, where a jump does, or where the link cannot rest."""
    y_low, y_high = _stiffness(joint, q, low) - stiffness, _stiffness(joint, q, high) - stiffness
    if not y_low * y_high <= 0.0:
        return nan
    search = _begun(low, high, y_low, y_high)
    for _ in range(STEPS):
        preset = _next(search)
        if preset == search[0]:
            break
        _look(search, preset, _stiffness(joint, q, preset) - stiffness)
    if not abs(search[3]) <= NEAR * max(1.0, abs(stiffness)):
        return nan  # rest jumps from one angle of the motors to another
    return float(search[0])


@njit(cache=True, error_model="numpy")
def _stiffness(joint: Joint, q: float, preset: float) -> float:
    """sigma [N m/rad] at rest at q [rad] with this preset [rad]; NaN where it cannot rest."""
    kinds, rows, signs, serial = joint[:4]
    x, total = _rest(joint, q, preset), 0.0
    for i in range(kinds.size):
        theta = x + signs[i] * preset
        total += spring_stiffness(kinds[i], rows[i], q - theta, preset if serial else theta)
    return total


@njit(cache=True, error_model="numpy")
def _rest(joint: Joint, q: float, preset: float) -> float:
    """x [rad] of rest at q [rad] with this preset [rad]; NaN where there is none within the stops."""
    signs, stop = joint[2], joint[4]
    if abs(_torque(joint, q, q, preset)) < BALANCED:  # equal springs without a load
        return q
    reach = stop - abs(signs[0] * preset)
    y_low, y_high = _torque(joint, q, q - reach, preset), _torque(joint, q, q + reach, preset)
    if reach <= 0.0 or not y_low * y_high <= 0.0:
        return nan
    search = _begun(q - reach, q + reach, y_low, y_high)
    for _ in range(STEPS):
        x = _next(search)
        if x == search[0]:
            break
        _look(search, x, _torque(joint, q, x, preset))
    return float(search[0])


@njit(cache=True, error_model="numpy")
def _torque(joint: Joint, q: float, x: float, preset: float) -> float:
    """What turns the link at q [rad] back [N m] while motors stand about x [rad]."""
    kinds, rows, signs, serial, _, gravity, angle = joint
    total = gravity * sin(q - angle)
    for i in range(kinds.size):
        theta = x + signs[i] * preset
        total += spring_torque(kinds[i], rows[i], q - theta, preset if serial else theta)
    return total


# A search keeps x1, x2, x3, y1, y2, y3 (6,): the newest point, the one across the root, the last one thrown out.
# Compiled functions that take functions are not kept from one process to the next: hence two loops around these three.


@njit(cache=True, error_model="numpy")
def _begun(low: float, high: float, y_low: float, y_high: float) -> Array:
    """A search between two points, from the better one."""
    if abs(y_low) < abs(y_high):
        return np.array([low, high, high, y_low, y_high, y_high])
    return np.array([high, low, low, y_high, y_low, y_low])


@njit(cache=True, error_model="numpy")
def _next(search: Array) -> float:
    """Where to look next; where it looked last when that is the root to WITHIN.

    The inverse parabola of the three points is trusted where it is monotonic in between, else the interval is halved.
    """
    x1, x2, x3, y1, y2, y3 = search
    width = abs(x2 - x1)
    if y1 == 0.0 or width <= WITHIN + 1e-15 * abs(x1):
        return x1
    share, xi, phi = 0.5, (x1 - x2) / (x3 - x2), (y1 - y2) / (y3 - y2)
    if 1.0 - sqrt(1.0 - xi) < phi < sqrt(xi):
        share = y1 / (y2 - y1) * y3 / (y2 - y3) + (x3 - x1) / (x2 - x1) * y1 / (y3 - y1) * y2 / (y3 - y2)
    least = 0.5 * (WITHIN + 1e-15 * abs(x1)) / width
    return x1 + min(max(share, least), 1.0 - least) * (x2 - x1)


@njit(cache=True, error_model="numpy")
def _look(search: Array, x: float, y: float) -> None:
    """Take in what is at x."""
    x1, x2, y1, y2 = search[0], search[1], search[3], search[4]
    if (y > 0.0) == (y1 > 0.0):
        search[2], search[5] = x1, y1
    else:
        search[1], search[2], search[4], search[5] = x1, x2, y1, y2
    search[0], search[3] = x, y
