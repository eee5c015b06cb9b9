"""Friction of a gear, which increases with the torques on it; equations in joint/friction.py."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import grid

_FURTHER = ("counter_coefficient", "stribeck", "counter_stribeck", "quadratic")
_SHARE = 0.3  # initial value of each further term over the coefficient of the load, and of its velocity over the speed


def _write(spot: Spot, value: Values) -> None:
    if any(value.get(name, 0.0) != 0.0 for name in _FURTHER):
        spot["both_sides"] = 1.0


def _further(fitted: Values, speed: float, torque: float) -> list[Values]:
    """Terms of the models M3, M5 and M6 in joint/friction.py; a short log rarely determines all of them together."""
    share, velocity = _SHARE * fitted["coefficient"], _SHARE * speed
    return [
        {"counter_coefficient": share},
        {"velocity": velocity, "quadratic": share / torque},
        {"counter_coefficient": share, "stribeck": share, "counter_stribeck": share, "velocity": velocity},
    ]


KIND = EffectKind(
    name="load_dependent_friction",
    text="dry friction that increases with the load T of an axis (torque of its transmissions; in a rigid joint of its "
    "drive) and with the counter torque C from the other side (of a motor its drive; of a link gravity, walls and "
    "external torque); opposed torques press the teeth of a gear together",
    term="-(|coefficient T - counter_coefficient C| + exp(-(v/velocity)^2) (|stribeck T - counter_stribeck C| + "
    "quadratic min(|T|, |C|)^2 where T C < 0)) s",
    confused_with="coulomb_friction: the same speeds under another load; torque_gain: reversals",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter(
            "coefficient", "-", 0.0, 1.0, 0.0, "friction per load, at any speed", True, slot="load_friction"
        ),
    ),
    optional=(
        EffectParameter(
            "counter_coefficient", "-", 0.0, 1.0, 0.0, "friction per counter torque, at any speed",
            slot="counter_friction",
        ),
        EffectParameter("stribeck", "-", 0.0, 1.0, 0.0, "increase at standstill per load", slot="load_stribeck"),
        EffectParameter(
            "counter_stribeck", "-", 0.0, 1.0, 0.0, "increase at standstill per counter torque",
            slot="counter_stribeck",
        ),
        EffectParameter(
            "velocity", "rad/s", 1e-3, 1e2, 1.0, "speed at which 1/e of the increase is left", slot="load_velocity"
        ),
        EffectParameter(
            "quadratic", "1/(N m)", 0.0, 10.0, 0.0, "increase per square of the smaller torque", True,
            slot="load_quadratic",
        ),
    ),
    slots=(
        Slot("load_friction", "-", "dry friction per load torque, see friction.py", 3),
        Slot("both_sides", "-", "1: any of the next four is nonzero", 3),
        Slot("counter_friction", "-", "dry friction per counter torque", 3),
        Slot("load_stribeck", "-", "increase at standstill per load", 3),
        Slot("counter_stribeck", "-", "increase at standstill per counter torque", 3),
        Slot("load_quadratic", "1/(N m)", "increase at standstill per square of the smaller torque, if opposed", 3),
        Slot("load_velocity", "rad/s", "speed at which the increase at standstill has fallen to 1/e", 3, 1.0),
    ),
    write=_write,
    starts=grid("coefficient", *_FURTHER, at=lambda _here: [{"coefficient": 0.05}]),
    further=_further,
)  # fmt: skip
