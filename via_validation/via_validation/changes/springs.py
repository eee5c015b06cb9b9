"""A simulated joint whose springs follow a factor of time.

No effect covers steps and swings: the simulator's parameter row is set anew at every tick, so that the factor on the
springs is linear within a tick.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from via_core.signals import Array, Signals
from via_sim.joint.kernel import run
from via_sim.joint.layout import N_COMMANDS
from via_sim.joint.measurements import MEASURED, TRUTH
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import initial_state

RATE = 1000.0  # [Hz]


def changing_springs(
    plant: JointPlant, factor: Array, command: Callable[[int, Array], Array], sensors: Sensors, seed: int = 0
) -> tuple[Array, Array]:
    """Measured (n, 9) and true (n, 16) rows of a joint at 1 kHz whose springs have `factor` (n,) at the samples.

    command  motor torques [N m] (2,) after sample k, from k and its measured row (9,)
    """
    rate, sensor_row = RATE, sensors.row()
    row, state = plant.at_rate(rate), initial_state(plant, rate, None, seed)
    measured, truth = np.empty((len(factor), len(MEASURED))), np.empty((len(factor), len(TRUTH)))
    commands = np.zeros((1, N_COMMANDS))

    def set_factor(k: int) -> None:
        last = factor[min(k + 1, len(factor) - 1)]
        row[P.spring_scale : P.spring_scale + 2] = factor[k]
        row[P.stiffness_rate : P.stiffness_rate + 2] = (last / factor[k] - 1.0) * rate
        row[P.origin] = -k / rate  # the factor counts from the beginning of this tick

    set_factor(0)
    run(row, sensor_row, state, commands[:0], measured[:1], truth[:1])
    for k in range(len(factor) - 1):
        set_factor(k)
        commands[0, :2] = command(k, measured[k])
        run(row, sensor_row, state, commands, measured[k : k + 2], truth[k : k + 2])
    return measured, truth


def signals_of(time: Array, rows: Array) -> Signals:
    """Measured rows (n, 9) at `time` (n,) [s] as signals."""
    columns = {
        "q": rows[:, MEASURED.q],
        "theta": rows[:, MEASURED.theta_1 : MEASURED.theta_1 + 2],
        "theta_velocity": rows[:, MEASURED.theta_velocity_1 : MEASURED.theta_velocity_1 + 2],
        "tau": rows[:, MEASURED.tau_1 : MEASURED.tau_1 + 2],
    }
    return Signals(time, columns, {"q": "rad", "theta": "rad", "theta_velocity": "rad/s", "tau": "N m"})


def true_stiffness(rows: Array) -> Array:
    """Stiffness (n,) [N m/rad] in true rows (n, 16)."""
    return rows[:, TRUTH.stiffness]
