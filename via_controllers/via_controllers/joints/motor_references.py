"""Motor angles at which a joint of variable stiffness rests at a link angle q with stiffness sigma.

    sum_i tau_e,i(q - theta_i) + g(q) = 0,      sum_i sigma_i(q - theta_i) = sigma

With theta = (x + s, x - s) for an antagonistic joint, theta = (x, s) for a serial one, there is one x for every preset
s as long as the joint's stiffness is positive. s is a root of the second equation: two nested scalar searches.
Lever mechanisms may balance at several x, or at none: where a search encounters a jump between them, other presets are
tried. Both searches are compiled, so that a reference can be tracked at 1 kHz.
Source of the search: T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear
function without using derivatives, Advances in Engineering Software 28 (1997).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite, isnan, nan, sin, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.signals import Array
from via_core.spring_equations import spring_stiffness, spring_torque

from via_controllers.contract import require

WITHIN = 1e-12  # [rad] tolerance of motor angles
BALANCED = 1e-12  # [N m] rounding error of two opposing springs
NEAR = 1e-6  # tolerance of a stiffness, relative above 1 N m/rad
CANDIDATES = 33  # presets tried where the stiffness is not between those of the end presets
STEPS = 200  # limit of a search; bisection alone needs 50


class _Joint(NamedTuple):
    """Constants of a joint with k springs."""

    kinds: Array  # (k,) of the spring laws
    coefficients: Array  # (k, 8) of the spring laws
    signs: Array  # (k,) motor angles are x + signs * preset
    serial: bool  # whether the preset is the angle of a second motor
    stop: float  # [rad] smallest deflection limit
    gravity: float  # [N m]
    gravity_angle: float  # [rad]


class _Search(NamedTuple):
    """Three points of a root search: the latest, the one beyond the root, and the one discarded last."""

    x1: float
    x2: float
    x3: float
    y1: float
    y2: float
    y3: float


class UnreachableError(ViaError):
    """No motor angles give this stiffness at this angle; the message states the reachable range."""


@dataclass(frozen=True)
class MotorReferences:
    """Motor references of a device. Raises ParameterError for a joint whose stiffness no motor varies."""

    device: Device
    presets: tuple[float, float]  # [rad] range of s

    def __post_init__(self) -> None:
        varies = self.device.arrangement in ("antagonistic", "serial")
        require(varies, f"device: '{self.device.name}' has no preset: it is {self.device.arrangement}")
        low, high = self.presets
        require(isfinite(low) and isfinite(high) and low < high, f"presets must be a range, got {self.presets}")
        object.__setattr__(self, "presets", (float(low), float(high)))

    @cached_property
    def _joint(self) -> _Joint:
        return _joint_of(self.device)

    @classmethod
    def from_device(cls, device: Device, share: float = 0.95) -> MotorReferences:
        """Presets from 0 to a `share` of the springs' stop; closer to it any motion would reach the stop."""
        require(0.0 < share < 1.0, f"share must lie between 0 and 1, got {share}")
        stops = [spring.max_deflection for spring in device.springs]
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
        """Least and largest stiffness [N m/rad] at `q` [rad]; raises UnreachableError if there is no rest."""
        values = self._stiffnesses(q)
        if not values:
            raise UnreachableError(f"'{self.device.name}' cannot rest at {q:.4g} rad")
        return min(values), max(values)

    def stiffness(self, q: float, preset: float) -> float:
        """Stiffness [N m/rad] at rest at `q` [rad] with `preset` [rad]; raises UnreachableError beyond a stop."""
        value = float(_stiffness(self._joint, float(q), float(preset)))
        if isnan(value):
            raise _no_rest(self.device, q, preset)
        return value

    def _stiffnesses(self, q: float) -> list[float]:
        """Stiffnesses [N m/rad] with those candidate presets at which the link can rest at `q`."""
        low, high = self.presets
        values = (float(_stiffness(self._joint, float(q), _candidate(low, high, k))) for k in range(CANDIDATES))
        return [value for value in values if not isnan(value)]


def resting(device: Device, q: float, preset: float) -> float:
    """x [rad] for which the link rests at `q` [rad] with the motors at `device.motor_angles(x, preset)`.

    Raises UnreachableError if there is none within the springs' stops.
    """
    x = float(_rest(_joint_of(device), float(q), float(preset)))
    if isnan(x):
        raise _no_rest(device, q, preset)
    return x


def _no_rest(device: Device, q: float, preset: float) -> UnreachableError:
    return UnreachableError(f"'{device.name}' cannot rest at {q:.4g} rad with preset {preset:.4g} rad")


def _joint_of(device: Device) -> _Joint:
    springs, link = device.springs, device.link
    return _Joint(
        kinds=np.array([spring.kind for spring in springs]),
        coefficients=np.array([spring.coefficients() for spring in springs]),
        signs=np.array([1.0, -1.0] if device.arrangement == "antagonistic" else [0.0]),
        serial=device.arrangement == "serial",
        stop=float(min(spring.max_deflection for spring in springs)),
        gravity=float(link.gravity_torque),
        gravity_angle=float(link.gravity_angle),
    )


@njit(cache=True, error_model="numpy")
def _candidate(low: float, high: float, k: int) -> float:
    """Preset [rad] number k of CANDIDATES."""
    return low + (high - low) * k / (CANDIDATES - 1)


@njit(cache=True, error_model="numpy")
def _preset(joint: _Joint, q: float, stiffness: float, low: float, high: float) -> float:
    """s [rad] that gives this stiffness [N m/rad] at rest at q [rad]; NaN if none is found."""
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
def _preset_between(joint: _Joint, q: float, stiffness: float, low: float, high: float) -> float:
    """As `_preset`; NaN if the ends enclose no root, if they enclose a jump, or if the link cannot rest."""
    y_low, y_high = _stiffness(joint, q, low) - stiffness, _stiffness(joint, q, high) - stiffness
    if not y_low * y_high <= 0.0:
        return nan
    search = _started(low, high, y_low, y_high)
    for _ in range(STEPS):
        preset = _next(search)
        if preset == search.x1:
            break
        search = _updated(search, preset, _stiffness(joint, q, preset) - stiffness)
    if not abs(search.y1) <= NEAR * max(1.0, abs(stiffness)):
        return nan  # the motor angles at rest jump here
    return search.x1


@njit(cache=True, error_model="numpy")
def _stiffness(joint: _Joint, q: float, preset: float) -> float:
    """sigma [N m/rad] at rest at q [rad] with this preset [rad]; NaN if the link cannot rest."""
    x, total = _rest(joint, q, preset), 0.0
    for i in range(joint.kinds.size):
        theta = x + joint.signs[i] * preset
        total += spring_stiffness(joint.kinds[i], joint.coefficients[i], q - theta, preset if joint.serial else theta)
    return total


@njit(cache=True, error_model="numpy")
def _rest(joint: _Joint, q: float, preset: float) -> float:
    """x [rad] of rest at q [rad] with this preset [rad]; NaN if there is none within the stops."""
    if abs(_torque(joint, q, q, preset)) < BALANCED:  # equal springs without a load
        return q
    reach = joint.stop - abs(joint.signs[0] * preset)
    y_low, y_high = _torque(joint, q, q - reach, preset), _torque(joint, q, q + reach, preset)
    if reach <= 0.0 or not y_low * y_high <= 0.0:
        return nan
    search = _started(q - reach, q + reach, y_low, y_high)
    for _ in range(STEPS):
        x = _next(search)
        if x == search.x1:
            break
        search = _updated(search, x, _torque(joint, q, x, preset))
    return search.x1


@njit(cache=True, error_model="numpy")
def _torque(joint: _Joint, q: float, x: float, preset: float) -> float:
    """Restoring torque [N m] of the link at q [rad] with the motors about x [rad]."""
    total = joint.gravity * sin(q - joint.gravity_angle)
    for i in range(joint.kinds.size):
        theta = x + joint.signs[i] * preset
        total += spring_torque(joint.kinds[i], joint.coefficients[i], q - theta, preset if joint.serial else theta)
    return total


# numba does not cache compiled functions that take functions as arguments: hence two loops around these three.


@njit(cache=True, error_model="numpy")
def _started(low: float, high: float, y_low: float, y_high: float) -> _Search:
    """A search between two points, starting from the better one."""
    if abs(y_low) < abs(y_high):
        return _Search(low, high, high, y_low, y_high, y_high)
    return _Search(high, low, low, y_high, y_low, y_low)


@njit(cache=True, error_model="numpy")
def _next(search: _Search) -> float:
    """The next point to evaluate; the latest one if it is the root to WITHIN.

    Inverse parabola of the three points where it is monotonic between them, otherwise bisection.
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
def _updated(search: _Search, x: float, y: float) -> _Search:
    """The search with the value `y` at `x`."""
    x1, x2, _, y1, y2, _ = search
    if (y > 0.0) == (y1 > 0.0):
        return _Search(x, x2, x1, y, y2, y1)
    return _Search(x, x1, x2, y, y1, y2)
