"""Periodic error of an encoder."""

from __future__ import annotations

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, Slot, Spot, Values, harmonics
from via_sim.catalogue.sensor.encoder_offset import OFF
from via_sim.catalogue.starts import waves

ENCODER_HARMONICS = 4  # largest number per axis
_SLOTS = (
    Slot(
        "eccentricity", "rad", "amplitude of the encoder error: link, motors, for each harmonic", 3 * ENCODER_HARMONICS
    ),
    Slot("eccentricity_order", "-", "periods per turn", 3 * ENCODER_HARMONICS, 1.0),
    Slot("eccentricity_phase", "rad", "at angle zero", 3 * ENCODER_HARMONICS),
)
_AMPLITUDE, _ORDER, _PHASE, *_FURTHER = harmonics(ENCODER_HARMONICS, "rad", 0.5, [slot.name for slot in _SLOTS])


def _write(spot: Spot, value: Values) -> None:
    """Refuse encoder errors with which the measured angle would not increase with the angle; count the harmonics."""
    steepest, last = 0.0, 0
    for k, of in enumerate(("", *(f"_{k}" for k in range(2, ENCODER_HARMONICS + 1)))):
        amplitude = value.get(f"amplitude{of}", 0.0)
        steepest += abs(amplitude * value.get(f"order{of}", k + 1.0))
        last = k + 1 if amplitude != 0.0 else last
    spot["encoder_harmonics"] = last
    if steepest >= 1.0:
        raise ParameterError(
            f"amplitude times order adds up to {steepest:.6g}, must be < 1: the measured angle would decrease"
        )


KIND = EffectKind(
    name="encoder_eccentricity",
    text="periodic error of an encoder, of order 1 if mounted off its axis; `motor` 0 is the link encoder",
    term="measures angle + sum_k amplitude_k sin(order_k angle + phase_k)",
    confused_with="torque_ripple: affects every equation that contains the angle",
    sites=("sensor",),
    parameters=(_AMPLITUDE, _PHASE),
    optional=(_ORDER, *_FURTHER),
    slots=(
        Slot("encoder_harmonics", "-", "number of harmonics of the encoder error, up to the last nonzero amplitude", 3),
        *_SLOTS,
    ),
    write=_write,
    starts=waves(lambda _here: [{"amplitude": size} for size in OFF]),
)
