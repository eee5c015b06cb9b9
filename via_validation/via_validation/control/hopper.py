"""Section 6.2 on the hopper: convergence to its natural hopping, without and with an unknown payload (Figure 18).

For comparison, the motors follow an open-loop sinusoid along the same direction, at the frequency that the controller
found without payload: once with the amplitude of the first harmonic of the controller's switching, and once with an
amplitude at which it hops as high. The robot is dropped from 3 cm. The motors' theta_0 and the controller's standing
posture are those without payload.

The motion is left-right symmetric. The controller has one coordinate and stabilises neither the trunk's pitch nor the
robot's position: an initial pitch grows (`toppling`), by about 2.5 per second without and 6.5 with the payload, until
the robot falls. Sustained hopping needs an additional controller for balance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import pi
from typing import TypeVar

import numpy as np
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.motor_pd import MotorPd
from via_controllers.contract import ArmController, ArmSample, Quantity, Torques, passive
from via_core.hopper import Hopper
from via_core.signals import Array
from via_sim.robots.hopper import HopperPlant

from via_validation.control.cycles import Cycles, relative_sd

CROUCH = 0.6  # a_0 [rad]
DROP = 0.03  # [m]
BANDWIDTH = 120.0  # omega_m [rad/s]
AMPLITUDE = 0.1  # theta_hat [rad]
THRESHOLD = 1.0  # epsilon [N m]
ADAPTATION = 50.0  # gamma [1/(rad^2 s)]
AS_HIGH = 0.15  # [rad] amplitude of the sinusoid that hops as high as the controller
PAYLOAD = 0.6  # [-] of the trunk's mass
PERIOD = 1e-3  # [s] sampling period of the controller
State = TypeVar("State")


@dataclass(frozen=True, eq=False)
class Sinusoid(ArmController[float]):
    """Open-loop control theta_d = theta_0 + w A sin(2 pi f t). The state is the time [s]."""

    motors: MotorPd
    direction: Array  # w (n,)
    amplitude: float  # A [rad]
    frequency: float  # f [Hz]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def observe(self, state: float) -> Array:
        return np.zeros(0)

    def init(self, sample: ArmSample) -> float:
        return sample.time

    def step(self, state: float, sample: ArmSample) -> tuple[float, Torques]:
        if not sample.valid:
            return state, passive(self.motors.drives.n)
        swing = self.amplitude * np.sin(2.0 * pi * self.frequency * sample.time)
        return sample.time, self.motors.torques(sample, self.motors.motors + swing * self.direction)


@dataclass(frozen=True)
class HopperRun:
    """N samples of a run."""

    time: Array  # (N,) [s]
    q: Array  # (N, 4) [rad]
    theta: Array  # (N, 4) [rad]
    trunk: Array  # (N, 3) x [m], z [m], pitch [rad]
    force: Array  # (N, 2) [N] on the feet
    values: Array  # (N, k) quantities of the controller


@dataclass(frozen=True)
class Hopping:
    """Results of number 7 of the specification, over the second half of a run."""

    apex: float  # [m] mean of the trunk's highest points above its standing height
    apex_sd: float  # std / mean of these
    amplitude: float  # [m] peak to peak of the trunk's height, mean over cycles
    frequency: float  # [Hz]
    flight: float  # share of time without contact
    direction: Array  # (4,) w_1 at the end; empty for a controller without w_1
    run: HopperRun


@cache
def reference_controller() -> ModalBangBang:
    """The controller of the reference set-up, for the robot without payload."""
    hopper = Hopper()
    motors = hopper.crouched(CROUCH)
    hold = MotorPd(hopper, motors, hopper.standing(CROUCH), BANDWIDTH)
    return ModalBangBang(hold, np.sign(motors), AMPLITUDE, THRESHOLD, ADAPTATION)


def hop(controller: ArmController[State], payload: float = 0.0, duration: float = 12.0, pitch: float = 0.0) -> Hopping:
    """Run the controller on the robot for `duration` [s], dropped at `pitch` [rad]; `payload` over the trunk's mass."""
    hopper = Hopper()
    plant, motors = HopperPlant(replace(hopper, payload=payload * hopper.trunk_mass)), hopper.crouched(CROUCH)
    total, no_sensor = round(duration / PERIOD), np.full(hopper.n, np.nan)
    body, state = plant.start(motors, motors, DROP, pitch), None
    q, theta, trunk, force = np.empty((total, 4)), np.empty((total, 4)), np.empty((total, 3)), np.empty((total, 2))
    values = np.empty((total, len(controller.quantities)))
    for tick in range(total):
        sample = ArmSample(tick * PERIOD, body.q, body.velocity, body.theta, body.motor_velocity, no_sensor)
        if state is None:
            state = controller.init(sample)
        state, out = controller.step(state, sample)
        q[tick], theta[tick], trunk[tick], force[tick], values[tick] = (
            body.q, body.theta, body.trunk, body.force, controller.observe(state)
        )  # fmt: skip
        body = plant.step(body, out.torque, PERIOD)
    run = HopperRun(np.arange(total, dtype=float) * PERIOD, q, theta, trunk, force, values)
    return _figures(run, hopper.leg_height(hopper.standing(CROUCH)[:2]))


def sinusoid(found: Hopping, amplitude: float = 4.0 / pi * AMPLITUDE) -> Sinusoid:
    """Open-loop control at the frequency and along w_1 of `found`; default: amplitude of the switching's harmonic."""
    return Sinusoid(reference_controller().motors, found.direction, amplitude, found.frequency)


def toppling(payload: float = 0.0) -> float:
    """Growth of the pitch per second [-] from 1e-3 rad: largest of the third second over that of the second one."""
    run = hop(reference_controller(), payload, 3.0, 1e-3).run
    seconds = [np.abs(run.trunk[(run.time >= a) & (run.time < a + 1.0), 2]).max() for a in (1.0, 2.0)]
    return float(seconds[1] / seconds[0])


def _figures(run: HopperRun, stance: float) -> Hopping:
    late = slice(len(run.time) // 2, None)
    z = run.trunk[late, 1]
    cycles = Cycles(run.time[late], z, 0.5 * float(z.min() + z.max()))
    apexes = np.array([piece.max() for piece in cycles.each(z)])
    return Hopping(
        apex=float(apexes.mean()) - stance,
        apex_sd=relative_sd(apexes - stance),
        amplitude=float(cycles.swings.mean()),
        frequency=1.0 / float(cycles.periods.mean()),
        flight=float(np.mean(run.force[late].sum(axis=1) == 0.0)),
        direction=run.values[-1, 3:],
        run=run,
    )
