"""Imperfections of a recording (rate, noise, stamps, losses) and of its controller (late or missing commands)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from via_core.signals import Array

RATES = (100.0, 250.0, 500.0, 1000.0)  # [Hz] of logs
HIGHEST = 1000.0  # [Hz] of a control loop


@dataclass(frozen=True)
class Recorder:
    """Settings of one recording. The defaults record every tick exactly.

    encoder_noise  [-] standard deviation in encoder steps, before rounding
    jitter         [-] standard deviation of the sampling times in samples; stamps are correct
    stamp_jitter   [-] standard deviation of the stamps about the sampling times, in samples
    lost           [-] fraction of lost samples, one to three at a time
    late           [-] fraction of the ticks in which the controller acts late, by up to `latest` ticks
    stamped_due    late commands are stamped with their due time, not with the time at which they acted
    gaps           [1/s] rate of gaps in the commands, each up to `gap` [s] long
    gaps_in_log    commands in a gap acted but were not recorded; otherwise there were none
    every          ticks per sample
    snapshot       commands and torques are recorded once per sample; otherwise every command, and mean torques
    """

    encoder_noise: float = 0.0
    jitter: float = 0.0
    stamp_jitter: float = 0.0
    lost: float = 0.0
    late: float = 0.0
    latest: float = 0.0
    stamped_due: bool = False
    gaps: float = 0.0
    gap: float = 0.02
    gaps_in_log: bool = False
    every: int = 1
    snapshot: bool = False

    @property
    def quality(self) -> str:
        """'degraded' if the stamps or commands in the log differ from those of the drive, else 'good'."""
        bad = self.stamp_jitter or self.late or self.gaps or (self.snapshot and self.every > 1)
        return "degraded" if bad else "good"


def draw_recorder(rng: Generator, every: int, table: bool) -> Recorder:
    """A random recorder with a sample every `every` ticks; `table`: rows with sample and command, else a bag."""
    noise = float(rng.uniform(0.0, 1.0)) if rng.uniform() < 0.5 else 0.0
    which = rng.uniform()
    mild = {"jitter": float(rng.uniform(0.02, 0.1))} if which < 0.2 else {}
    if 0.2 <= which < 0.4:
        mild = {"lost": float(rng.uniform(0.001, 0.01))}
    if table:  # rows are written when the controller acts
        mild = {}
    faults = rng.uniform()
    more: dict[str, float | bool] = {}
    if faults < 0.12:
        more = {"stamp_jitter": float(rng.uniform(0.01, 0.05))}
    elif faults < 0.24:
        more = {"late": float(rng.uniform(0.05, 0.5)), "latest": float(rng.uniform(1.0, 5.0))}
        more["stamped_due"] = bool(rng.uniform() < 0.3)
    elif faults < 0.36:
        more = {"gaps": float(rng.uniform(0.3, 2.0)), "gap": float(rng.uniform(0.01, 0.02))}
        more["gaps_in_log"] = bool(rng.uniform() < 0.5)
    snapshot = bool(every > 1 and rng.uniform() < 0.3)
    return Recorder(encoder_noise=noise, every=every, snapshot=snapshot, **mild, **more)  # type: ignore[arg-type]


def acting(rng: Generator, recorder: Recorder, count: int, rate: float) -> Array | None:
    """(count,) [s] delay of the controller in each tick, NaN where it misses the tick; None: always on time."""
    if not recorder.late and (not recorder.gaps or recorder.gaps_in_log):
        return None
    out, k = np.zeros(count), 1  # the first command is on time
    while recorder.late and k < count:
        if rng.uniform() < recorder.late:
            by = float(rng.uniform(0.2, max(recorder.latest, 0.2)))
            out[k : k + int(by)] = np.nan
            k += int(by)
            out[k : k + 1] = (by % 1.0) / rate
        k += 1
    if recorder.gaps:
        out[in_gaps(rng, recorder, np.arange(count) / rate)] = np.nan
    return out


def in_gaps(rng: Generator, recorder: Recorder, time: Array) -> NDArray[np.bool_]:
    """(N,) whether a command at `time` [s] falls into a gap."""
    count = rng.poisson(recorder.gaps * (time[-1] - time[0]))
    begin = rng.uniform(time[0] + 0.1, time[-1], count)
    end = begin + rng.uniform(0.25 * recorder.gap, recorder.gap, count)
    return np.asarray(((time[:, None] >= begin) & (time[:, None] < end)).any(axis=1), dtype=np.bool_)
