"""Start of a limit cycle from rest: a force added to a mode while it hardly moves.

(103) takes the energy of a mode from H to H_d with a power proportional to zd^2: at rest at z = 0 nothing happens, and
near it next to nothing. No force that is continuous in z and zd alone can start the motion from every state: at the
turning points of the cycle it points inwards, so that it is zero somewhere between them, where a hand may hold the arm.
One more state, a direction, solves this. With A = sqrt(2 H_d), h = H / H_d and w = sqrt(lambda) let (99) be

    zdd + lambda z = u + lambda s,   s = a A sigma(h) S(p)

    sigma(h)  falls from 1 at h = 0 to 0 at ENOUGH, and is 0 beyond: there the cycle is exactly that of (102)
    p         direction, -1 to 1; S(p) rises from -1 to 1 with it; 0 before the first sample: s starts at 0
    pd        +- w / TURN, with the sign of  d = zd / w - z  if |d| > BAND a A, otherwise with the sign of p
    a         `start`, a share of A; 0 leaves (102) unchanged

sigma and S are quintic and twice differentiable, S with slope 0 at its ends: s has the two derivatives that torque
tracking needs, except where p reverses between its ends.

Equilibria: with zd = 0 an equilibrium needs z = s. If |z| > BAND a A, p goes to -sign(z), and s and z have opposite
signs. Closer to 0, |s| is close to a A, which exceeds |z|. There is no equilibrium for any a > 0.

Power: s zd is added to (103). From rest near z = 0 with p = 1 the mode follows z = s (1 - cos w t) as long as sigma is
about 1: zd > 0 and h = 2 a^2 (1 - cos w t). In oscillations wider than the band the sign of d decides: d changes sign a
phase of pi / 4 before a turning point, p takes TURN = pi / 4 from its end to 0, and S(p) changes sign with zd:
s zd >= 0, so that Hd >= 0 and Vd = (H - H_d) Hd <= 0 below ENOUGH as above. This holds for a harmonic z of constant
lambda and BAND a A << |z|. Within the band, and while p still turns after the arm was held, s zd may be negative, at
most |zd| a A, until p has turned. The controller reports V as it is.

A hand that holds the arm at z bears lambda |z - s|. |z| + a A sigma(z^2 / A^2) <= A wherever sigma > 0 for a <= .6: not
more than the springs' load at the turning points of the desired cycle. A hand on the tip alone does not hold every
joint, so that the arm may continue to move.
Source: our own; the document starts with a push and excludes z = zd = 0 from its proof that the cycle is attractive.
"""

from __future__ import annotations

from math import copysign, pi

START = 0.5  # default a
ENOUGH = 0.8  # h from which nothing is added
TURN = pi / 4.0  # [rad] phase w t in which p goes from 0 to 1
BAND = 0.2  # over a A: smaller |d| does not change the direction


def push(start: float, direction: float, h: float) -> float:
    """s / A [-] for a = `start`, p = `direction` and h = H / H_d."""
    if h >= ENOUGH or start == 0.0:
        return 0.0
    return start * (1.0 - _rise(h / ENOUGH)) * copysign(_rise(abs(direction)), direction)


def turning(start: float, direction: float, z: float, speed: float, w: float) -> float:
    """pd [1/s] for a = `start`, p = `direction`, z / A, zd / (w A) and w [rad/s]; 0 when p is at its end."""
    ahead = speed - z
    decided = direction != 0.0 and abs(ahead) <= BAND * start
    towards = copysign(1.0, direction if decided else ahead)
    return 0.0 if towards * direction >= 1.0 else towards * w / TURN


def turned(direction: float, rate: float, time: float) -> float:
    """p at `time` [s] later, negative for earlier, while it turns at `rate` [1/s]."""
    return min(max(direction + rate * time, -1.0), 1.0)


def _rise(x: float) -> float:
    """Smooth step from 0 at 0 to 1 at 1, with two derivatives zero at both."""
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
