"""Cogging: a torque that is periodic in the motor angle."""

from __future__ import annotations

from math import sin

from via_sim.catalogue.kinds import EffectKind, Slot, harmonics
from via_sim.catalogue.starts import waves
from via_sim.catalogue.terms import Term

RIPPLE_HARMONICS = 8  # largest number per axis
_SLOTS = (
    Slot("ripple_amplitude", "N m", "of a torque periodic in the angle, each harmonic", 3 * RIPPLE_HARMONICS),
    Slot("ripple_order", "-", "periods per turn", 3 * RIPPLE_HARMONICS, 1.0),
    Slot("ripple_phase", "rad", "at angle zero", 3 * RIPPLE_HARMONICS),
)
_ALL = harmonics(RIPPLE_HARMONICS, "N m", 1e3, [slot.name for slot in _SLOTS])


def _torque(ripple_amplitude: float, ripple_order: float, ripple_phase: float, angle: float) -> float:
    return ripple_amplitude * sin(ripple_order * angle + ripple_phase)


KIND = EffectKind(
    name="torque_ripple",
    text="cogging: a torque that is periodic in the motor angle, a Fourier series of a few orders",
    term="sum_k amplitude_k sin(order_k theta + phase_k)",
    confused_with="encoder_eccentricity: order, and sign under reversal",
    sites=("motor",),
    parameters=_ALL[:3],
    optional=_ALL[3:],
    slots=_SLOTS,
    terms=(Term("axis", _torque, RIPPLE_HARMONICS),),
    starts=waves(lambda here: [{"amplitude": 0.1 * here.torque, "order": order} for order in here.orders]),
    needs_torque_drive=True,
    of_drive=True,
    whole_period=True,
)
