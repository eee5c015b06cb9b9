"""Limit cycle of an arm along one mode by switching motors: eqs. (121)-(123), with (122) about the static equilibrium.

    tau_z = w_1' [tau_e(q_0 - theta_0) - tau_e(q - theta)]                                            (122) corrected
    theta_d = theta_0 + w_1 theta_hat sign(tau_z)   where |tau_z| > epsilon,   theta_0 elsewhere       (121), (123)

w_1 is the direction in which the joints swing (`principal_components`); the motors track theta_d (`motor_pd`). The
controller needs no model of the links and no frequency: switching with the sign of the spring torque supplies the
energy that friction dissipates, and this balance sets the amplitude. w_1(0) selects the mode. (122) is printed with
both terms at the same q: only the offset of the motors remains then, it vanishes, and the motion stops. At rest at
theta_0 and q_0 nothing happens: the arm needs a push.
Source: the document's Section 6.2, after D. Lakatos et al. (its references [24], [25]).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array, locked

from via_controllers.arms.motor_pd import MotorPd
from via_controllers.arms.principal_components import adapted
from via_controllers.contract import (
    ArmController,
    ArmSample,
    Quantity,
    Torques,
    passive,
    require,
    require_not_negative,
)

LONGEST = 0.01  # [s] longest time step of the adaptation; after a longer gap this step is used


@dataclass(frozen=True)
class BangBangState:
    """State after a sample."""

    time: float  # [s]
    direction: Array  # w_1 (n,), of about unit length
    y: float  # [rad] modal coordinate w_1' (q - q_0)
    torque: float  # tau_z [N m]
    switch: int  # -1, 0 or 1


@dataclass(frozen=True, eq=False)
class ModalBangBang(ArmController[BangBangState]):
    """Bang-bang control of an arm along one mode. Raises ParameterError for values outside the stated ranges."""

    motors: MotorPd
    direction: Array  # w_1(0) (n,), not zero; it is normalised
    amplitude: float  # theta_hat >= 0 [rad]
    threshold: float  # epsilon >= 0 [N m]
    adaptation: float  # gamma per time, >= 0 [1/(rad^2 s)]

    def __post_init__(self) -> None:
        direction = locked(self.direction, "direction")
        length = float(np.linalg.norm(direction))
        n = self.motors.drives.n
        good = direction.shape == (n,) and np.isfinite(length) and length > 0.0
        require(good, f"direction must be ({n},), finite and not zero, got {direction}")
        object.__setattr__(self, "direction", locked(direction / length, "direction"))
        require_not_negative(self, "amplitude", "threshold", "adaptation")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        joints = range(1, self.motors.drives.n + 1)
        return (
            Quantity("y", "rad"),
            Quantity("tau_z", "N m"),
            Quantity("switch", "-"),
            *(Quantity(f"w_{joint}", "-") for joint in joints),
        )

    def observe(self, state: BangBangState) -> Array:
        return np.array([state.y, state.torque, state.switch, *state.direction])

    def init(self, sample: ArmSample) -> BangBangState:
        return self._after(sample, sample.time, self.direction)

    def step(self, state: BangBangState, sample: ArmSample) -> tuple[BangBangState, Torques]:
        if not sample.valid:
            return state, passive(self.motors.drives.n)
        step = min(max(sample.time - state.time, 0.0), LONGEST)
        motion = sample.q - self.motors.equilibrium
        direction = adapted(state.direction[:, None], self.adaptation * step, motion)[:, 0]
        after = self._after(sample, max(sample.time, state.time), direction)
        return after, self.motors.torques(sample, self.references(after))

    def references(self, state: BangBangState) -> Array:
        """theta_d (n,) [rad] in `state`."""
        return np.asarray(self.motors.motors + self.amplitude * state.switch * state.direction)

    def _after(self, sample: ArmSample, time: float, direction: Array) -> BangBangState:
        nominal, _, _ = self.motors.drives.spring_state(sample.q - sample.theta)
        tau_e = np.where(np.isfinite(sample.spring_torque), sample.spring_torque, nominal)
        torque = -float(direction @ (tau_e + self.motors.static_torque))
        switch = int(np.sign(torque)) if abs(torque) > self.threshold else 0
        y = float(direction @ (sample.q - self.motors.equilibrium))
        return BangBangState(time, direction, y, torque, switch)
