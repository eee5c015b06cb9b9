"""Whether a mechanical stop holds a motor, from the contact condition and the innovation of one modulated equation.

A stop at an angle a carries a reaction R >= 0 only where the motor touches it: R (a - theta) = 0. No motor passes its
stop, so it can touch one only at the largest or smallest angle that it has ever reached, within PRESLIDING for rubber
and encoder steps. The motor equation then contains one more torque, outward: <tau, psi> = (all that the model predicts)
+ <R, psi>. There are three explanations of the innovation v of an equation:

    no contact   v ~ N(0, S)
    a jump of the spring (`interacting_models`), with probability 1 - exp(-dt / memory): v ~ N(0, S + jump)
    contact      v ~ half-normal outward, variance S + c^2 (y^2 + p^2) + (B w psi_m)^2

with y the modulated torque and p its prediction, whose sizes bound what motor and spring push together, c the share of
the window (by psi) that touches, and the impulse that takes the momentum B w of the motor at impact, psi_m the largest
psi there. Contact begins as often as the spring jumps, lasts while the motor touches, and ends where it leaves:

    prior of contact = P + (1 - P) (1 - exp(-dt / memory)),   P its probability at the last equation, 0 without touch.

An equation with contact says nothing about spring and motor, because R is unknown: it is left out where contact is the
likelier explanation. A turning point without contact has an innovation within S, and is used. A stop that yields by
more than PRESLIDING under the torque of the motor is not recognised.
"""

from __future__ import annotations

from math import exp, log

from numba import njit
from via_core.motor_stops import PRESLIDING, stopped_text
from via_core.signals import Array

from via_estimators.slots import slots
from via_estimators.transmissions import VISITED

# Smallest and largest mean motor angle of a window so far [rad], 1 if there is any; side touched last; probability of
# contact.
STOP = slots("lowest", "highest", "turned", "side", "contact", after=VISITED)


def fault(kept: Array, motor: int) -> str:
    """The text for a motor, from 1, if contact at a stop is likelier than none; else ''."""
    upper = bool(kept[STOP.side] > 0.0)
    angle = kept[STOP.highest if upper else STOP.lowest]
    return stopped_text(motor, float(angle), upper) if kept[STOP.contact] > 0.5 else ""


@njit(cache=True, error_model="numpy")
def reach(kept: Array, theta: Array) -> None:
    """Extend the range of angles reached by the mean of a window (L,): that of a bounce is shorter."""
    mean = theta.mean()
    if not kept[STOP.turned] > 0.0:
        kept[STOP.lowest], kept[STOP.highest], kept[STOP.turned] = mean, mean, 1.0
    kept[STOP.lowest], kept[STOP.highest] = min(kept[STOP.lowest], mean), max(kept[STOP.highest], mean)


@njit(cache=True, error_model="numpy")
def _touch(kept: Array, theta: Array, psi: Array) -> tuple[float, float, float]:
    """The side (1 upper, -1 lower, 0 none) at which a window touches, its share by psi, and the largest psi there.

    Without travel between both ends nothing distinguishes a stop from a motor that rests.
    """
    low, high = kept[STOP.lowest] + PRESLIDING, kept[STOP.highest] - PRESLIDING
    above = below = most_above = most_below = 0.0
    for k in range(theta.size):
        if theta[k] >= high:
            above, most_above = above + psi[k], max(most_above, psi[k])
        elif theta[k] <= low:
            below, most_below = below + psi[k], max(most_below, psi[k])
    if low >= high or above == below:
        return 0.0, 0.0, 0.0
    return (1.0, above, most_above) if above > below else (-1.0, below, most_below)


@njit(cache=True, error_model="numpy")
def holds(
    kept: Array, theta: Array, psi: Array, span: float, elapsed: float, memory: float, momentum: float, pull: float,
    innovation: float, variance: float, jump: float,
) -> bool:  # fmt: skip
    """Update the probability of contact; returns whether contact explains the innovation [N m] better.

    span, elapsed  [s] of the window, and since the last equation
    memory         [s] mean time between contacts
    momentum       B w [N m s]
    pull           y [N m]
    variance       S [(N m)^2] of the innovation without contact
    jump           what a spring that has just jumped adds to it
    """
    side, share, densest = _touch(kept, theta, psi)
    before = kept[STOP.contact] if side != 0.0 and kept[STOP.side] == side else 0.0
    prior = before + (1.0 - before) * (1.0 - exp(-elapsed / memory))
    kept[STOP.side], kept[STOP.contact] = side, 0.0
    if side * innovation <= 0.0 or not prior > 0.0:
        return False
    impulse, predicted = momentum * densest * (theta.size - 1) / span, pull - innovation
    wide = variance + share * share * (pull * pull + predicted * predicted) + impulse * impulse
    squared, changed = innovation * innovation, variance + jump
    steady = -0.5 * (squared / variance + log(variance))
    jumped = log(max(1.0 - exp(-elapsed / memory), 1e-12)) - 0.5 * (squared / changed + log(changed))
    most = max(steady, jumped)
    rest = most + log(exp(steady - most) + exp(jumped - most))
    odds = log(2.0 * prior / max(1.0 - prior, 1e-12)) - 0.5 * (squared / wide + log(wide)) - rest
    kept[STOP.contact] = 1.0 / (1.0 + exp(-odds)) if odds > -30.0 else 0.0
    return odds > 0.0
