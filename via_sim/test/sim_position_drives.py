"""Position drives, commands and effects that several tests share."""

import numpy as np
from sim_joints import MORE, SIZES, positioned
from via_core.signals import Signals
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, places

RATE = 1000.0
M, KP, KD = 0.02, 4.0, 0.1
GRAVITY = f"{{inertia: {M}, viscous_friction: 0.02, gravity_torque: 0.3, gravity_angle: 0.2}}"
PLACES = [(name, *place) for name in EFFECTS for place in places(name, positioned(GRAVITY))]
EFFECT_SETS = [
    *([Effect(name, site, SIZES[name], motor)] for name, site, motor in PLACES),
    *([Effect(name, site, SIZES[name] | MORE[name], motor)] for name, site, motor in PLACES if name in MORE),
]
RICH = [each for each in EFFECT_SETS if each[0].name in MORE and len(each[0].parameters) > len(SIZES[each[0].name])]
EFFECT_SETS += [RICH[0] + RICH[1], [*RICH[0], *RICH[1], *RICH[2]]]
SERVOS = (
    "{kp: 4.0, kd: 0.1, torque_limit: 1.5}",
    "{kp: 4.0, kd: 0.1, speed_limit: 3.0, delay: 0.0023}",
    "{kp: 4.0, kd: 0.1, torque_limit: 1.0, limited: sum}",
    "{kp: 4.0, kd: 0.1, ki: 8.0, integral_limit: 0.4}",
    "{kp: 4.0, kd: 0.1, feedforward: 1.0, delay: 0.0023}",
)


def goals(values, rate: float = RATE, **others) -> Signals:
    channels = {"equilibrium": np.asarray(values, dtype=np.float64), **others}
    return Signals(np.arange(len(values)) / rate, channels, dict.fromkeys(channels, "-"), frozenset(channels))


def wave(ticks: int) -> np.ndarray:
    t = np.arange(ticks) / RATE
    return 0.6 * np.sin(5.0 * t) + 0.3 * np.sin(13.0 * t)
