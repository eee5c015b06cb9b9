"""Spring torques as sums of polynomials with dead bands, which MuJoCo's fixed tendons have.

A tendon with rest length [-d, d] and stiffness (a, b, c) has the torque a x + b x^2 + c x^3 of the deflection x beyond
d. Such terms with knots d_0 = 0 < d_1 < ... are the truncated power basis of cubic splines (de Boor, A Practical Guide
to Splines, 1978, ch. VIII), so that a sum of tendons is a cubic spline. Beyond the mechanical stop the simulator
continues a spring law along its tangent; a last term cancels the second and third derivative there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from via_core.signals import Array
from via_core.spring_equations import MACCEPA, N_COEFFICIENTS, TWO_LEVER, spring_stiffness, spring_torque
from via_sim.joint.parameters import P

from via_export.target import Target

ACCURACY = 1e-3  # largest error relative to the torque at that deflection
SMALL = 0.1  # of the stop: at smaller deflections, relative to the torque there
MOST_INTERVALS = 16
CHECKED = 1025  # deflections at which the error is checked
NEGLIGIBLE = 1e-9  # of the torque at the stop
PRESET_LAWS = (MACCEPA, TWO_LEVER)  # depend on a motor angle besides the deflection
Slope = Callable[[float], float]


@dataclass(frozen=True)
class SpringTerm:
    """Torque a x + b x^2 + c x^3 of the deflection x beyond `knot` [rad], in a direction: 1, -1, or 0 for both."""

    direction: int
    knot: float
    a: float = 0.0  # [N m/rad]
    b: float = 0.0  # [N m/rad^2]
    c: float = 0.0  # [N m/rad^3]

    def torque(self, phi: Array) -> Array:
        """[N m] at deflections (N,) [rad]."""
        beyond = np.sign(phi) * np.maximum(np.abs(phi) - self.knot, 0.0)
        beyond = np.where((self.direction == 0) | (np.sign(phi) == self.direction), beyond, 0.0)
        return self.a * beyond + self.b * beyond**2 + self.c * beyond**3


def preload(target: Target, i: int) -> float:
    """[N m] torque of transmission i at deflection 0, scale included."""
    spring = target.device.springs[i]
    return float(target.row[P.spring_scale + i]) * float(spring.torque(0.0)) if spring.kind not in PRESET_LAWS else 0.0


def spring_terms(target: Target, i: int) -> tuple[SpringTerm, ...]:
    """Terms of transmission i that do not depend on a preset; scale and hardening are included, backlash is not."""
    row = target.row
    kind = int(row[P.spring_kind + i])
    coefficients = row[P.spring + i * N_COEFFICIENTS : P.spring + (i + 1) * N_COEFFICIENTS].copy()
    scale, hardening = float(row[P.spring_scale + i]), float(row[P.spring_hardening + i])
    stop = target.device.springs[i].max_deflection

    def torque(phi: Array) -> Array:
        plain = np.array([spring_torque(kind, coefficients, float(x), 0.0) for x in phi])
        return scale * (1.0 + hardening * phi**2) * plain

    def slope(phi: float) -> float:
        plain = scale * spring_torque(kind, coefficients, phi, 0.0)
        slope = scale * spring_stiffness(kind, coefficients, phi, 0.0)
        return float((1.0 + hardening * phi**2) * slope + 2.0 * hardening * phi * plain)

    at = np.linspace(0.0, stop, CHECKED)
    forward, backward = torque(at), torque(-at)
    if np.max(np.abs(forward + backward)) <= NEGLIGIBLE * np.max(np.abs(forward)):
        return _fitted(torque, slope, stop, 0)
    return (*_fitted(torque, slope, stop, 1), *_fitted(torque, slope, stop, -1))


def _fitted(torque: Callable[[Array], Array], slope: Slope, stop: float, direction: int) -> tuple[SpringTerm, ...]:
    """Terms of one direction, of both for an odd torque, without its value at 0.

    The interval with the largest error is halved until the torque is accurate.
    """
    sign = direction or 1
    at = np.linspace(0.0, stop, CHECKED)
    base = float(torque(np.zeros(1))[0])
    wanted = sign * (torque(sign * at) - base)
    scale = np.maximum(np.abs(wanted), abs(wanted[round(SMALL * (CHECKED - 1))]))
    chosen = [0, CHECKED - 1]
    begin = (2, 0.0) if direction == 0 else (1, slope(0.0))
    while True:
        spline = CubicSpline(at[chosen], wanted[chosen], bc_type=(begin, (1, slope(sign * stop))))
        error = np.abs(spline(at) - wanted) / scale
        worst = int(np.argmax(error))
        if error[worst] <= ACCURACY or len(chosen) > MOST_INTERVALS:
            break
        after = next(k for k, knot in enumerate(chosen) if knot > worst) if worst < CHECKED - 1 else len(chosen) - 1
        middle = (chosen[after - 1] + chosen[after]) // 2
        if middle in chosen:
            break
        chosen.insert(after, middle)
    return _terms(spline, stop, direction, NEGLIGIBLE * float(np.max(np.abs(wanted))))


def _terms(spline: CubicSpline, stop: float, direction: int, least: float) -> tuple[SpringTerm, ...]:
    """Terms of a cubic spline on [0, stop] that continues linearly; terms below `least` [N m] at the stop are dropped.

    In a negative direction x is negative, so that b x^2 changes its sign.
    """
    cubic, _, first, _ = spline.c
    square = spline.c[1]
    sign = direction or 1
    found = [SpringTerm(direction, 0.0, float(first[0]), sign * float(square[0]), float(cubic[0]))]
    found += [
        SpringTerm(direction, float(knot), c=float(step))
        for knot, step in zip(spline.x[1:-1], np.diff(cubic), strict=True)
        if abs(step) * stop**3 > least
    ]
    width = stop - float(spline.x[-2])
    bend = float(square[-1] + 3.0 * cubic[-1] * width)
    if abs(bend) * stop**2 > least or abs(cubic[-1]) * stop**3 > least:
        for each in (1, -1) if direction == 0 else (direction,):
            found.append(SpringTerm(each, stop, b=-each * bend, c=-float(cubic[-1])))
    if direction == 0:
        found[0] = SpringTerm(0, 0.0, found[0].a, 0.0, found[0].c)
    return tuple(found)
