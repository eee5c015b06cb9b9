"""Transmission error of a gear: the angle behind it differs periodically from that of the motor."""

from __future__ import annotations

from math import cos, sin

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, Slot, Spot, Values, harmonics
from via_sim.catalogue.starts import waves
from via_sim.catalogue.terms import Term

GEAR_HARMONICS = 4  # largest number per motor
_SLOTS = (
    Slot(
        "gear_amplitude",
        "rad",
        "of the transmission error, each harmonic; the first axis is unused",
        3 * GEAR_HARMONICS,
    ),
    Slot("gear_order", "-", "periods per turn", 3 * GEAR_HARMONICS, 1.0),
    Slot("gear_phase", "rad", "at angle zero", 3 * GEAR_HARMONICS),
)
_ALL = harmonics(GEAR_HARMONICS, "rad", 0.5, [slot.name for slot in _SLOTS])


def _error(gear_amplitude: float, gear_order: float, gear_phase: float, angle: float) -> tuple[float, float]:
    turned = gear_order * angle + gear_phase
    return gear_amplitude * sin(turned), gear_order * gear_amplitude * cos(turned)


def _write(spot: Spot, value: Values) -> None:
    """Refuse errors with which the gear would turn backwards."""
    steepest = 0.0
    for k, of in enumerate(("", *(f"_{k}" for k in range(2, GEAR_HARMONICS + 1)))):
        steepest += abs(value.get(f"amplitude{of}", 0.0) * value.get(f"order{of}", k + 1.0))
    if steepest >= 1.0:
        raise ParameterError(f"amplitude times order adds up to {steepest:.6g}, must be < 1: the gear would reverse")
    spot["input_errors"] = 1.0 if steepest > 0.0 else 0.0


KIND = EffectKind(
    name="gear_error",
    text="transmission error of the gear between motor and spring, a Fourier series of a few orders; the torque on the "
    "motor follows by virtual work",
    term="tau_e(q - theta - e), on the motor (1 + de/dtheta) tau_e, e = sum_k amplitude_k sin(order_k theta + phase_k)",
    confused_with="torque_ripple: proportional to the load; encoder_eccentricity: acts on the motion, not on a sensor",
    sites=("transmission",),
    parameters=_ALL[:3],
    optional=_ALL[3:],
    slots=_SLOTS,
    terms=(Term("input", _error, GEAR_HARMONICS),),
    write=_write,
    starts=waves(lambda here: [{"amplitude": 0.1 * here.deflection, "order": order} for order in here.orders]),
    whole_period=True,
)
