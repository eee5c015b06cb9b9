"""How a spring or damper changes in time: a factor on its torque, and the interval in which errors count.

The cases were fixed before the first results. Sines let the fastest change followed be found; the step is the extreme
case, the drifts are what wear and temperature do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array

DURATION = 30.0  # [s]
CONVERGED = 10.0  # [s] after which errors count
STEP_TIME, STEP_SIZE, AFTER_STEP = 15.0, 1.5, 1.5  # [s], [-], [s] after the step in which its errors count
AMPLITUDE = 0.3  # [-] of the sines
FREQUENCIES = (0.1, 0.2, 0.5, 1.0, 2.0)  # [Hz]
DRIFTS = (0.001, 0.003)  # [1/s]


@dataclass(frozen=True)
class Schedule:
    """A factor on the torque of all springs, or on the damping, as a function of time.

    factor = 1 + rate t + amplitude sin(2 pi frequency t), and `size` times that from STEP_TIME on
    """

    name: str
    rate: float = 0.0  # [1/s]
    amplitude: float = 0.0  # [-]
    frequency: float = 0.0  # [Hz]
    size: float = 1.0  # [-]
    begin: float = CONVERGED  # [s] of the interval in which errors count
    end: float = DURATION  # [s]

    def factor(self, time: Array) -> Array:
        """The factor (n,) at `time` (n,) [s]."""
        smooth = 1.0 + self.rate * time + self.amplitude * np.sin(2.0 * np.pi * self.frequency * time)
        return np.where(time < STEP_TIME, smooth, self.size * smooth)

    def counts(self, time: Array) -> np.ndarray:
        """(n,) bool: samples in which errors count."""
        return (time >= self.begin - 1e-9) & (time < self.end - 1e-9)


CONSTANT = Schedule("constant")
STEP = Schedule(f"step x {STEP_SIZE:g}", size=STEP_SIZE, begin=STEP_TIME, end=STEP_TIME + AFTER_STEP)
SINES = tuple(Schedule(f"{f:g} Hz", amplitude=AMPLITUDE, frequency=f) for f in FREQUENCIES)
SCHEDULES = (CONSTANT, *(Schedule(f"drift {100.0 * rate:+g} %/s", rate=rate) for rate in DRIFTS), STEP, *SINES)
