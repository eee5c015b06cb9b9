"""Where the motors of a joint of variable stiffness must stand, for a link at rest at q with stiffness sigma.

    sum_i tau_e,i(q - theta_i) + g(q) = 0,      sum_i sigma_i(q - theta_i) = sigma

With theta = (x + s, x - s) of an antagonistic joint, theta = (x, s) of a serial one, there is one x for every preset s
as long as the joint's stiffness is positive; s is then a root of the second equation: two searches, one unknown each.
Levers may balance at several x, or at none: where the search meets a jump between them, it looks elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, sin

import numpy as np
from scipy.optimize import brentq
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.signals import Array

from via_controllers.contract import require

WITHIN = 1e-9  # [rad] of motor angles
BALANCED = 1e-12  # [N m] that rounding leaves of two springs against each other
NEAR = 1e-6  # of a stiffness, at least 1 N m/rad
CANDIDATES = 33  # presets that are tried where stiffness is not between those of the ends


class UnreachableError(ViaError):
    """No motor angles give this stiffness at this angle; the message has what there is."""


@dataclass(frozen=True)
class MotorReferences:
    """References of one device. Raises ParameterError for a joint whose stiffness no motor varies."""

    device: Device
    presets: tuple[float, float]  # [rad] the range of s to use

    def __post_init__(self) -> None:
        varies = self.device.arrangement in ("antagonistic", "serial")
        require(varies, f"device: '{self.device.name}' has no preset: it is {self.device.arrangement}")
        low, high = self.presets
        require(isfinite(low) and isfinite(high) and low < high, f"presets must be a range, got {self.presets}")

    @classmethod
    def from_device(cls, device: Device, share: float = 0.95) -> MotorReferences:
        """Presets from 0 to a `share` of the springs' stop, beyond which a link that moves would meet it at once."""
        require(0.0 < share < 1.0, f"share must lie between 0 and 1, got {share}")
        stops = [law.max_deflection for law in device.spring_laws]
        return cls(device, (0.0, share * min(stops, default=1.0)))

    def at(self, q: float, stiffness: float) -> Array:
        """Motor angles (2,) [rad] for rest at `q` [rad] with `stiffness` [N m/rad]; raises UnreachableError."""
        require(isfinite(q) and isfinite(stiffness), f"q and stiffness must be finite, got {q} and {stiffness}")

        low, high = self.presets
        found = self._between(q, stiffness, low, high)
        if found is not None:
            return found
        known = [float(s) for s in np.linspace(low, high, CANDIDATES) if self._known(q, float(s)) is not None]
        for before, after in pairwise(known):
            found = self._between(q, stiffness, before, after)
            if found is not None:
                return found
        values = [self.stiffness(q, preset) for preset in known]
        there = f"{min(values):.4g} to {max(values):.4g} N m/rad are reached" if values else "it cannot rest there"
        raise UnreachableError(f"'{self.device.name}' at {q:.4g} rad has no stiffness {stiffness:.4g} N m/rad: {there}")

    def stiffness_range(self, q: float) -> tuple[float, float]:
        """Least and largest stiffness [N m/rad] at `q` [rad]; raises UnreachableError where no rest is."""
        values = [v for s in np.linspace(*self.presets, CANDIDATES) if (v := self._known(q, float(s))) is not None]
        if not values:
            raise UnreachableError(f"'{self.device.name}' cannot rest at {q:.4g} rad")
        return min(values), max(values)

    def stiffness(self, q: float, preset: float) -> float:
        """Of the joint at rest at `q` [rad] with `preset` [rad] [N m/rad]; raises UnreachableError beyond a stop."""
        return float(self.device.stiffness(q, self._motors(q, preset)))

    def _between(self, q: float, stiffness: float, low: float, high: float) -> Array | None:
        """Motor angles with a preset between these; None where the ends do not enclose one, or a jump does."""

        def off(preset: float) -> float:
            return self.stiffness(q, preset) - stiffness

        try:
            if off(low) * off(high) > 0.0:
                return None
            preset = _root(off, low, high)
            if abs(off(preset)) > NEAR * max(1.0, abs(stiffness)):
                return None  # rest jumps from one angle of the motors to another
            return self._motors(q, preset)
        except UnreachableError:
            return None  # a spring is at its stop, or nothing balances

    def _motors(self, q: float, preset: float) -> Array:
        return self.device.motor_angles(resting(self.device, q, preset), preset)

    def _known(self, q: float, preset: float) -> float | None:
        try:
            return self.stiffness(q, preset)
        except UnreachableError:
            return None


def resting(device: Device, q: float, preset: float) -> float:
    """x [rad] with which a link rests at `q` [rad] while the motors stand at `device.motor_angles(x, preset)`.

    Raises UnreachableError where there is none within the springs' stops.
    """
    stop = min(law.max_deflection for law in device.spring_laws)
    reach = stop - (abs(preset) if device.arrangement == "antagonistic" else 0.0)
    load = device.link.gravity_torque * sin(q - device.link.gravity_angle)

    def off(x: float) -> float:
        return float(device.torque_each(q, device.motor_angles(x, preset)).sum()) + load

    if abs(off(q)) < BALANCED:  # equal springs without a load
        return q
    if reach <= 0.0 or off(q - reach) * off(q + reach) > 0.0:
        raise UnreachableError(f"'{device.name}' cannot rest at {q:.4g} rad with preset {preset:.4g} rad")
    return _root(off, q - reach, q + reach)


def _root(off: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(off, low, high, xtol=WITHIN))
