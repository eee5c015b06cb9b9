"""The document's antagonistic joint with cubic springs (Section 3.4), `cubic_aa_vsa`: motion and sensor noise.

Its excitation is not printed; E1 and E2 replace it, with a smooth start from rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import sqrt

import numpy as np
from via_core.devices import Device, load_device
from via_core.signals import Array, Signals
from via_estimators.contract import rows_of
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

TORQUE_RATIO = 2.82  # variance of signal over noise for 'SNR = 9' by the printed 20 log10
POSITION_RATIO = 1e7  # variance of signal over noise for 'SNR = 140', likewise
FROM = 2.0  # [s] after which errors count
TAU, THETA = (3, 5), (2, 4)  # columns of a log: t, q, theta_1, tau_1, theta_2, tau_2
EXCITATIONS = {"E1": (20.0, 0.5, 0.8), "E2": (40.0, 1.0, 1.7)}  # amplitude [N m], tones of motor 1 and 2 [Hz]
INERTIA, DAMPING = 1e-4, 1.27  # of the motors [kg m^2], [N m s/rad]


@dataclass(frozen=True)
class Log:
    """Noise-free signals of a joint, and its true stiffness."""

    rows: Array  # (n, 6) t [s], q, theta_1 [rad], tau_1 [N m], theta_2, tau_2
    stiffness: Array  # (n,) of the device [N m/rad]

    @property
    def later(self) -> np.ndarray:
        """(n,) bool: samples at which errors count."""
        return self.rows[:, 0] >= FROM - 1e-9

    def noisy(self, seed: int, torque: float, position: float = 0.0) -> Array:
        """Rows (n, 6) with white noise of these standard deviations [N m], [rad] on motor torques and motor angles."""
        rng, rows = np.random.default_rng(seed), self.rows.copy()
        rows[:, TAU] += torque * rng.normal(size=(len(rows), 2))
        if position > 0.0:
            rows[:, THETA] += position * rng.normal(size=(len(rows), 2))
        return rows

    def noise_sd(self, columns: tuple[int, int], ratio: float) -> float:
        """Noise standard deviation for a ratio of variances of signal (mean over both columns) and noise."""
        return sqrt(float(self.rows[self.later][:, columns].var(axis=0).mean()) / ratio)

    def every(self, stride: int) -> Log:
        """The log with every `stride`-th sample; torques are means over the interval that ends at the stamp."""
        rows = self.rows[::stride].copy()
        for column in TAU:
            rows[1:, column] = self.rows[1:, column].reshape(-1, stride).mean(axis=1)
        return Log(rows, self.stiffness[::stride])


@cache
def cubic_log(excitation: str) -> Log:
    """Log of the document's joint under E1 or E2, with torques constant over each millisecond."""
    amplitude, first, second = EXCITATIONS[excitation]
    t = np.arange(10_000, dtype=np.float64) * 1e-3
    middle = t + 5e-4
    u = np.clip(middle / 0.3, 0.0, 1.0)
    ramp = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    tones = np.sin(2.0 * np.pi * middle[:, None] * np.array([first, second]))
    motor = ramp[:, None] * (60.0 + amplitude * tones) * np.array([1.0, -1.0])
    return log_of(load_device("cubic_aa_vsa"), t, motor)


def log_of(device: Device, t: Array, motor: Array) -> Log:
    """Log of a simulation of the device with motor torques (n, m) [N m] at the times t (n,) [s]."""
    commands = Signals(t, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))
    run = simulate(JointPlant.from_device(device), commands, len(t) / 1000.0, 1000.0)
    return Log(rows_of(run.measured, ("q", "theta_1", "tau_1", "theta_2", "tau_2")), np.array(run.truth["stiffness"]))
