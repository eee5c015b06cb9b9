"""What a recording shows of a joint's sensors, and of the joint itself if its torque was recorded.

Numbers of a joint without model: least squares of

    M qdd + D qd + C sign(qd) + a sin q + b cos q = tau

with all terms smoothed by the same Gaussian, whose derivatives give qd and qdd of the smoothed angle exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from via_core.errors import SignalError
from via_core.signals import Array

from via_gap.logs.log import JointLog
from via_gap.logs.noise import log_noise

SMOOTHING = 0.02  # [s] standard deviation of the Gaussian
STEPS = 10.0  # of the encoder that the angle must pass


@dataclass(frozen=True)
class Survey:
    """Sampling rate [Hz], encoder step [rad] (None: none visible), and torque noise [N m] (None: no torque)."""

    rate: float
    link_quantum: float | None
    torque_noise: float | None


@dataclass(frozen=True)
class Fitted:
    """A fitted number and its standard deviation, widened by the correlation of the residual."""

    value: float
    sd: float


def survey(log: JointLog) -> Survey:
    """Rate and noise of a log."""
    noise = log_noise(log)
    torque = noise.channels.get("tau_1") if "tau" in log.measured else None
    quantum = noise.channels["q"].quantum
    return Survey(1.0 / noise.clock.period, quantum if quantum > 0.0 else None, None if torque is None else torque.sd)


def fit_joint(log: JointLog) -> dict[str, Fitted]:
    """inertia, viscous_friction, coulomb_friction, gravity_torque, gravity_angle. Raises SignalError without torque."""
    torque = log.torque
    if torque is None:
        raise SignalError(
            f"{log.name}: without a torque no inertia can be measured; add the URDF or MJCF file, or answer the "
            "questions of `via device new`"
        )
    period = float(np.median(np.diff(log.measured.time)))
    grid = np.arange(log.measured.time[0], log.measured.time[-1], period)
    seen = np.isfinite(log.measured["q"])
    q = np.interp(grid, log.measured.time[seen], log.measured["q"][seen])
    tau = np.interp(grid, log.measured.time, np.nan_to_num(torque[:, 0]))
    width = SMOOTHING / period

    def smooth(values: Array, order: int = 0) -> Array:
        return np.asarray(gaussian_filter1d(values, width, order=order)) / period**order

    speed = smooth(q, 1)
    columns = [smooth(q, 2), speed, smooth(np.sign(speed)), smooth(np.sin(q)), smooth(np.cos(q))]
    edge = int(4 * width) + 1
    terms, wanted = np.stack(columns, axis=1)[edge:-edge], smooth(tau)[edge:-edge]
    if len(wanted) < 20 * terms.shape[1]:
        raise SignalError(f"{log.name}: {len(wanted)} samples are too few to measure an inertia")
    values, *_ = np.linalg.lstsq(terms, wanted, rcond=None)
    left = wanted - terms @ values
    memory = max(1.0, 1.0 + 2.0 * sum(_correlations(left)))
    covariance = np.linalg.pinv(terms.T @ terms) * float(left @ left) / len(left) * memory
    sd = np.sqrt(np.diag(covariance))
    if not values[0] > 2.0 * sd[0]:
        raise SignalError(f"{log.name}: its motion does not determine an inertia; add the URDF or MJCF of the robot")
    gravity = float(np.hypot(values[3], values[4]))
    found = {"inertia": Fitted(float(values[0]), float(sd[0]))}
    for name, at in (("viscous_friction", 1), ("coulomb_friction", 2)):
        found[name] = Fitted(max(float(values[at]), 0.0), float(sd[at]))
    strong = gravity > 3.0 * float(np.hypot(sd[3], sd[4]))
    found["gravity_torque"] = Fitted(gravity if strong else 0.0, float(np.hypot(sd[3], sd[4])))
    found["gravity_angle"] = Fitted(float(np.arctan2(-values[4], values[3])) if strong else 0.0, 0.0)
    return found


def _correlations(left: Array) -> list[float]:
    """Autocorrelations up to the first that is not positive."""
    centred = left - left.mean()
    power = float(centred @ centred) or 1.0
    found: list[float] = []
    for lag in range(1, len(left) // 4):
        value = float(centred[lag:] @ centred[:-lag]) / power
        if value <= 0.0:
            break
        found.append(value)
    return found
