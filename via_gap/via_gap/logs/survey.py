"""What a recording shows of a joint's sensors, and of the joint itself if its torque was recorded.

Numbers of a joint without model: least squares of

    M qdd + D qd + C sign(qd) + a sin q + b cos q = tau

with all terms smoothed by the same Gaussian, whose derivatives give qd and qdd of the smoothed angle exactly. Gains of
a position drive come from the same equation with tau = kp (goal - q) - kd qd and the gravity torque of the model.
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
# [SMOOTHING] where it ends. At 4 its second derivative of a constant 1 is -2 1/s^2, which becomes gravity; here -1e-10.
REACH = 8.0


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
    motion = _Motion.of(log)
    tau = np.interp(motion.time, log.measured.time, np.nan_to_num(torque[:, 0]))
    columns = [*motion.dynamics, motion.smooth(np.sin(motion.q)), motion.smooth(np.cos(motion.q))]
    terms, wanted = np.stack(columns, axis=1)[motion.inside], motion.smooth(tau)[motion.inside]
    if len(wanted) < 20 * terms.shape[1]:
        raise SignalError(f"{log.name}: {len(wanted)} samples are too few to measure an inertia")
    values, sd = _least_squares(terms, wanted)
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


def fit_gains(log: JointLog, gravity_torque: float, gravity_angle: float) -> dict[str, Fitted]:
    """kp and kd of a position drive by the gravity [N m] that it holds; empty where the motion does not show them.

    kd includes the viscous friction of the joint, and kp times the delay of the drive.
    """
    if log.commands is None or "equilibrium" not in log.commands or gravity_torque == 0.0:
        return {}
    motion = _Motion.of(log)
    last = np.maximum(np.searchsorted(log.commands.time, motion.time, side="right") - 1, 0)
    error = log.commands["equilibrium"][last] - motion.q
    on = motion.smooth(np.isfinite(error).astype(float)) > 1.0 - 1e-9
    on[: motion.inside.start] = on[motion.inside.stop :] = False
    # The error of the drive is the dependent variable: a joint that sticks and coarse encoders disturb it most.
    gravity = motion.smooth(gravity_torque * np.sin(motion.q - gravity_angle))
    terms = np.stack([gravity, *motion.dynamics], axis=1)
    if on.sum() < 20 * terms.shape[1]:
        return {}
    values, sd = _least_squares(terms[on], motion.smooth(np.nan_to_num(error))[on])
    if not values[0] > 3.0 * sd[0]:
        return {}
    kp = Fitted(1.0 / float(values[0]), float(sd[0] / values[0] ** 2))
    kd = Fitted(float(values[2] / values[0]), float(sd[2] / values[0]))
    return {"kp": kp, "kd": kd} if kd.value > 3.0 * kd.sd else {"kp": kp}


@dataclass(frozen=True)
class _Motion:
    """The angle (N,) [rad] of a log on an even grid of times (N,) [s], and the filter of the regressions."""

    time: Array
    q: Array
    period: float

    @staticmethod
    def of(log: JointLog) -> _Motion:
        period = float(np.median(np.diff(log.measured.time)))
        time = np.arange(log.measured.time[0], log.measured.time[-1], period)
        seen = np.isfinite(log.measured["q"])
        return _Motion(time, np.interp(time, log.measured.time[seen], log.measured["q"][seen]), period)

    def smooth(self, values: Array, order: int = 0) -> Array:
        """(N,) filtered values, or their derivative of that order."""
        smoothed = gaussian_filter1d(values, SMOOTHING / self.period, order=order, truncate=REACH)
        return np.asarray(smoothed) / self.period**order

    @property
    def dynamics(self) -> tuple[Array, Array, Array]:
        """Factors (N,) of inertia, viscous and dry friction."""
        speed = self.smooth(self.q, 1)
        return self.smooth(self.q, 2), speed, self.smooth(np.sign(speed))

    @property
    def inside(self) -> slice:
        """Samples that the ends of the log do not affect."""
        edge = int(REACH * SMOOTHING / self.period) + 1
        return slice(edge, -edge)


def _least_squares(terms: Array, wanted: Array) -> tuple[Array, Array]:
    """Coefficients (p,) of the terms (N, p) and their standard deviations, widened by the residual's correlation."""
    values, *_ = np.linalg.lstsq(terms, wanted, rcond=None)
    left = wanted - terms @ values
    memory = max(1.0, 1.0 + 2.0 * sum(_correlations(left)))
    covariance = np.linalg.pinv(terms.T @ terms) * float(left @ left) / len(left) * memory
    return np.asarray(values), np.sqrt(np.diag(covariance))


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
