"""A limit cycle that starts by itself: what is added to the force on a mode as long as it hardly swings.

(103) takes the energy of a mode from H to H_d by a power that is proportional to zd^2: at rest at z = 0 nothing ever
happens, and from near there next to nothing. No force that is continuous in z and zd can help it: at the turning points
of the cycle it points inwards, somewhere between them it is zero, and there a hand may hold the arm. With one number
more that remembers the way to go it can. With A = sqrt(2 H_d), h = H / H_d and w = sqrt(lambda) let (99) be

    zdd + lambda z = u + lambda s,   s = a A sigma(h) S(p)

    sigma(h)  falls from 1 at h = 0 to 0 at ENOUGH, and is 0 beyond: the cycle is that of (102), bit by bit
    p         the way to go, -1 to 1; S(p) goes from -1 to 1 with it; 0 before the first sample: s begins at 0
    pd        +- w / TURN towards the sign of  d = zd / w - z  where |d| > BAND a A, else on the way it is on
    a         share of A, `start`; 0 leaves (102) alone

sigma and S are quintic and twice differentiable, S with slope 0 at its ends: s has the two derivatives that tracking
asks for, but where p turns round half way.

Equilibria: with zd = 0 there would have to be z = s. Where |z| > BAND a A, p goes to -sign(z), and s and z have
opposite signs. Nearer to 0, |s| is close to a A, which is more than |z|. There is none for any a > 0.

Power: to (103) s zd is added. From rest near z = 0 with p = 1 the mode follows z = s (1 - cos w t) as long as sigma is
about 1: zd > 0 and h = 2 a^2 (1 - cos w t). Swinging wider than the band it is the sign of d that decides: d changes
sign a phase of pi / 4 before a turning point, p takes TURN = pi / 4 from its end to 0, and S(p) changes sign where zd
does: s zd >= 0, so that Hd >= 0 and Vd = (H - H_d) Hd <= 0 below ENOUGH as above. That is for a harmonic z of constant
lambda and BAND a A << |z|; within the band, and while p still turns after somebody took hold of the arm, s zd may be
negative, by no more than |zd| a A, and for no longer than it takes p to turn. V is told as it is.

Who holds the arm at z bears lambda |z - s|. |z| + a A sigma(z^2 / A^2) <= A wherever sigma > 0 for a <= .6: no more
than the springs of the cycle that is wanted have at its turning points. What swings on while a hand holds the tip alone
is not held.
Source: none but us; the document starts by a push, and leaves z = zd = 0 out where it shows the cycle to be attractive.
"""

from __future__ import annotations

from math import copysign, pi

START = 0.5  # a, unless somebody asks for another
ENOUGH = 0.8  # of H_d, from which on nothing is added
TURN = pi / 4.0  # [rad] of w t in which p goes from 0 to 1
BAND = 0.2  # of a A, within which d does not decide


def push(start: float, direction: float, h: float) -> float:
    """s / A [-] for a = `start`, p = `direction` and h = H / H_d."""
    if h >= ENOUGH or start == 0.0:
        return 0.0
    return start * (1.0 - _rise(h / ENOUGH)) * copysign(_rise(abs(direction)), direction)


def turning(start: float, direction: float, z: float, speed: float, w: float) -> float:
    """pd [1/s] for a = `start`, p = `direction`, z / A, zd / (w A) and w [rad/s]; 0 where p is at its end."""
    ahead = speed - z
    decided = direction != 0.0 and abs(ahead) <= BAND * start
    towards = copysign(1.0, direction if decided else ahead)
    return 0.0 if towards * direction >= 1.0 else towards * w / TURN


def turned(direction: float, rate: float, time: float) -> float:
    """p `time` [s] later, or before, while it turns at `rate` [1/s]."""
    return min(max(direction + rate * time, -1.0), 1.0)


def _rise(x: float) -> float:
    """From 0 at 0 to 1 at 1, with two derivatives zero at both."""
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
