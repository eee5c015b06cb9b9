"""Runs of several plants in lockstep, as the tests compare them with single runs."""

import numpy as np
from via_sim.joint.layout import N_COMMANDS
from via_sim.lockstep.run import run_many
from via_sim.simulate import initial_state


def simulate_rows(rows, states, commands):
    """Motion (K, N+1, 6) of parameter rows (K, N_PARAMETERS) under commands (N, N_COMMANDS); advances `states`."""
    out = np.empty((len(rows), len(commands) + 1, 6))
    run_many(rows, states, commands, np.zeros(len(rows), dtype=np.int64), out)
    return out


def simulate_many(plants, commands, rate, initial=None):
    """Motion (K, N+1, 6) of K plants under the same commands (N, 4) or (N, N_COMMANDS)."""
    given = np.asarray(commands, dtype=np.float64)
    inputs = np.zeros((len(given), N_COMMANDS))
    inputs[:, : given.shape[1]] = given
    rows = np.stack([plant.at_rate(rate) for plant in plants])
    states = np.stack([initial_state(plant, rate, initial, 0) for plant in plants])
    return simulate_rows(rows, states, inputs)
