"""Section 6.2 on the hopper: does it find its own rhythm, does it keep it under a load that nobody told it of?

Beside the law an open-loop sinusoid of the motors along the same direction, at the frequency that the law found without
the load, once with the first harmonic of the law's own switching and once so large that it hops as high as the law. The
robot falls 3 cm at the start; motors know theta_0, the law knows where the robot stands without the load. Figure 18 of
the document.

All of this is a motion that mirrors itself. The law has one coordinate and holds neither the trunk level nor the robot
in its place: a pitch of the start grows (`toppling`), some 2.5 times a second without and 6.5 times with the load, till
the robot falls. One that is to hop for long needs a law for that beside this one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import pi
from typing import TypeVar

import numpy as np
from via_controllers.bang_bang import ModalBangBang
from via_controllers.contract import ArmController, ArmSample, Quantity, Torques, blind
from via_controllers.motor_pd import MotorPd
from via_core.hopper import Hopper
from via_core.signals import Array
from via_sim.hopper import HopperPlant

from via_validation.control.cycles import Cycles, spread

CROUCH = 0.6  # a_0 [rad]
DROP = 0.03  # [m]
BANDWIDTH = 120.0  # omega_m [rad/s]
AMPLITUDE = 0.1  # theta_hat [rad]
THRESHOLD = 1.0  # epsilon [N m]
ADAPTATION = 50.0  # gamma [1/(rad^2 s)]
AS_HIGH = 0.15  # [rad] of the sinusoid that hops as high as the law does
PAYLOAD = 0.6  # of the trunk's mass
PERIOD = 1e-3  # [s] of the law
State = TypeVar("State")


@dataclass(frozen=True, eq=False)
class Sinusoid(ArmController[float]):
    """theta_d = theta_0 + w A sin(2 pi f t): what the law is compared with. The state is the time [s]."""

    motors: MotorPd
    direction: Array  # w (n,)
    amplitude: float  # A [rad]
    frequency: float  # f [Hz]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def told(self, state: float) -> Array:
        return np.zeros(0)

    def init(self, sample: ArmSample) -> float:
        return sample.time

    def step(self, state: float, sample: ArmSample) -> tuple[float, Torques]:
        if blind(sample):
            return state, Torques(np.zeros(self.motors.drives.n), False)
        swing = self.amplitude * np.sin(2.0 * pi * self.frequency * sample.time)
        return sample.time, self.motors.torques(sample, self.motors.motors + swing * self.direction)


@dataclass(frozen=True)
class HopperRun:
    """N samples."""

    time: Array  # (N,) [s]
    q: Array  # (N, 4) [rad]
    theta: Array  # (N, 4) [rad]
    trunk: Array  # (N, 3) x [m], z [m], pitch [rad]
    force: Array  # (N, 2) [N] on the feet
    told: Array  # (N, k)


@dataclass(frozen=True)
class Hopping:
    """Figures of number 7, over the second half of a run."""

    apex: float  # [m] mean of the trunk's highest points above where the robot stands
    apex_spread: float  # std / mean of them
    apex_height_spread: float  # std / mean of their heights above ground
    amplitude: float  # [m] peak to peak of the trunk's height, mean over cycles
    frequency: float  # [Hz]
    flight: float  # share of time without contact
    direction: Array  # (4,) w_1 at the end; empty where the law has none
    run: HopperRun


@cache
def reference_law() -> ModalBangBang:
    """The law with the reference set-up; it knows the robot without its load."""
    hopper = Hopper()
    motors = hopper.crouched(CROUCH)
    hold = MotorPd(hopper, motors, hopper.standing(CROUCH), BANDWIDTH)
    return ModalBangBang(hold, np.sign(motors), AMPLITUDE, THRESHOLD, ADAPTATION)


def hop(law: ArmController[State], payload: float = 0.0, duration: float = 12.0, pitch: float = 0.0) -> Hopping:
    """The law on the robot with a `payload` [of the trunk's mass] for `duration` [s], dropped at `pitch` [rad]."""
    hopper = Hopper()
    plant, motors = HopperPlant(replace(hopper, payload=payload * hopper.trunk_mass)), hopper.crouched(CROUCH)
    total, no_sensor = round(duration / PERIOD), np.full(hopper.n, np.nan)
    body, state = plant.start(motors, motors, DROP, pitch), None
    q, theta, trunk, force = np.empty((total, 4)), np.empty((total, 4)), np.empty((total, 3)), np.empty((total, 2))
    told = np.empty((total, len(law.quantities)))
    for tick in range(total):
        sample = ArmSample(tick * PERIOD, body.q, body.velocity, body.theta, body.motor_velocity, no_sensor)
        if state is None:
            state = law.init(sample)
        state, out = law.step(state, sample)
        q[tick], theta[tick], trunk[tick], force[tick], told[tick] = (
            body.q, body.theta, body.trunk, body.force, law.told(state)
        )  # fmt: skip
        body = plant.step(body, out.torque, PERIOD)
    run = HopperRun(np.arange(total, dtype=float) * PERIOD, q, theta, trunk, force, told)
    return _figures(run, hopper.leg_height(hopper.standing(CROUCH)[:2]))


def sinusoid(found: Hopping, amplitude: float = 4.0 / pi * AMPLITUDE) -> Sinusoid:
    """The open loop at the frequency of `found`, along its w_1; by default with a switching motor's first harmonic."""
    return Sinusoid(reference_law().motors, found.direction, amplitude, found.frequency)


def toppling(payload: float = 0.0) -> float:
    """By what factor pitch grows in a second, from a thousandth of a radian at the start: third second over second."""
    run = hop(reference_law(), payload, 3.0, 1e-3).run
    seconds = [np.abs(run.trunk[(run.time >= a) & (run.time < a + 1.0), 2]).max() for a in (1.0, 2.0)]
    return float(seconds[1] / seconds[0])


def _figures(run: HopperRun, stance: float) -> Hopping:
    late = slice(len(run.time) // 2, None)
    z = run.trunk[late, 1]
    cycles = Cycles(run.time[late], z, 0.5 * float(z.min() + z.max()))
    apexes = np.array([piece.max() for piece in cycles.each(z)])
    return Hopping(
        apex=float(apexes.mean()) - stance,
        apex_spread=spread(apexes - stance),
        apex_height_spread=spread(apexes),
        amplitude=float(cycles.swings.mean()),
        frequency=1.0 / float(cycles.periods.mean()),
        flight=float(np.mean(run.force[late].sum(axis=1) == 0.0)),
        direction=run.told[-1, 3:],
        run=run,
    )
