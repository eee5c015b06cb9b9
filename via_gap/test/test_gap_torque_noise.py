"""Noise of measured torques that drive a simulation: its density, its pulses, and errors whitened with it."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import antagonistic_log, log_of, rigid
from scipy.signal import lfilter
from via_core.device_parts import Wire, WireColumn
from via_core.signals import Signals
from via_gap.api import diagnose
from via_gap.logs.log import JointLog
from via_gap.logs.noise import log_noise, torque_densities
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import cut_log
from via_gap.residual.torque_noise import noise_pulses
from via_sim.effects import Effect
from via_sim.joint.layout import EXTERNAL, M1, M2

NOISE = 0.05  # [N m]


def sensed(log: JointLog, noise: float = NOISE, seed: int = 9) -> JointLog:
    """A log of a rigid joint with its torque measured after each tick, in place of its commands."""
    sent = log.commands["external_torque"]
    rng = np.random.default_rng(seed)
    torque = np.append(0.0, sent) + noise * rng.standard_normal(len(sent) + 1)
    measured = Signals(log.measured.time, {"q": log.measured["q"], "tau": torque[:, None]}, {"q": "rad", "tau": "N m"})
    return replace(log, measured=measured, commands=None)


def free() -> JointLog:
    """A balanced joint without friction: its angle is the torque, integrated twice."""
    device = rigid()
    link = device.link.model_copy(update={"gravity_torque": 0.0, "viscous_friction": 0.0})
    return log_of(device.model_copy(update={"link": link}), (), seed=2, duration=4.0, tolerance=0.0)


def test_the_density_is_the_variance_of_means_over_a_long_time():
    log = sensed(free())
    (density,) = torque_densities(log, log_noise(log), 0.25)
    assert density == pytest.approx(NOISE**2 / 500.0, rel=0.1)


def test_noise_behind_a_filter_has_the_density_that_its_slow_part_has():
    """A first-order filter with memory .6 multiplies slow noise by 1 / (1 - .6)."""
    log, rng = log_of(rigid(), (), seed=2, duration=20.0), np.random.default_rng(2)
    noise = lfilter([NOISE], [1.0, -0.6], rng.standard_normal(len(log.measured.time)))
    measured = Signals(log.measured.time, {"q": log.measured["q"], "tau": noise[:, None]}, {"q": "rad", "tau": "N m"})
    slow = replace(log, measured=measured, commands=None)
    (density,) = torque_densities(slow, log_noise(slow), 1.0)
    assert density == pytest.approx((NOISE / 0.4) ** 2 / 500.0, rel=0.3)


@pytest.mark.parametrize("later", [0, 7], ids=["one after the other", "after a gap"])
def test_pulses_have_the_covariance_of_a_torque_integrated_twice(later):
    """Of white torque of density S, angles have the covariance S / I^2 (t^2 u / 2 - t^3 / 6) at t <= u."""
    cut = cut_log(sensed(free()))
    begin = cut.begin[:-1] + later * cut.every * (np.arange(len(cut) - 1) >= 3)
    segments = replace(cut, begin=begin, **{name: getattr(cut, name)[:-1] for name in ("measured", "weight", "valid")})
    rollout = Rollout.of(segments, np.flatnonzero(segments.valid))
    row = segments.nominal
    plain = rollout.motion(row[None])[0]
    moved = [rollout.motion(row[None], commands=(segments.commands + each)[None])[0] for each in noise_pulses(segments)]
    columns = np.stack([(each - plain)[3, :, 0] for each in moved], axis=-1)
    time = np.arange(1, columns.shape[0] + 1) * segments.every / segments.rate
    if segments.averaged:
        time -= 0.5 * (segments.every - 1) / segments.rate
    early, late = np.minimum.outer(time, time), np.maximum.outer(time, time)
    inertia = segments.log.device.link.inertia
    wanted = segments.torque_density[EXTERNAL] / inertia**2 * (early**2 * late / 2.0 - early**3 / 6.0)
    inside = time > 0.05
    found = (columns @ columns.T)[np.ix_(inside, inside)]
    assert found == pytest.approx(wanted[np.ix_(inside, inside)], rel=0.02)


def test_a_right_model_leaves_no_more_than_noise_in_both_views():
    log = sensed(log_of(rigid(), (), seed=4, duration=8.0, tolerance=0.0))
    segments = cut_log(log)
    chosen, row = np.flatnonzero(segments.valid), segments.nominal
    unaware = replace(segments, torque_density=np.zeros_like(segments.torque_density))
    known, unknown = (Rollout.of(each, chosen).residual(row[None])[0] for each in (segments, unaware))
    assert np.mean(known**2) == pytest.approx(1.0, abs=0.1)
    assert np.mean(unknown**2) > 30.0
    assert np.mean(InverseDynamics.of(segments, chosen).residual(row[None]) ** 2) == pytest.approx(1.0, abs=0.2)
    assert np.mean(InverseDynamics.of(unaware, chosen).residual(row[None]) ** 2) > 5.0


def test_each_motor_has_the_noise_of_its_own_torque():
    log = antagonistic_log()
    rng = np.random.default_rng(1)
    tau = np.concatenate([np.zeros((1, 2)), log.commands["motor"]])[: len(log.measured.time)]
    tau = tau + rng.standard_normal(tau.shape) * [0.02, 0.005]
    measured = Signals(log.measured.time, {**log.measured.channels, "tau": tau}, {**log.measured.units, "tau": "N m"})
    segments = cut_log(replace(log, measured=measured, commands=None))
    period = float(np.median(np.diff(log.measured.time)))
    assert segments.torque_density[[M1, M2]] / period == pytest.approx([0.02**2, 0.005**2], rel=0.15)
    assert np.count_nonzero(segments.torque_density) == 2
    assert not cut_log(replace(log, measured=measured)).torque_density.any()  # commands drive the simulation


def test_a_joint_with_a_noisy_torque_sensor_has_no_gap_and_friction_is_found_beside_it():
    healthy = diagnose([sensed(log_of(rigid(), (), seed=4, duration=8.0))], rigid())
    assert healthy.verdict == "no_gap"
    planted = (Effect("coulomb_friction", "link", {"torque": 0.2}),)
    found = diagnose([sensed(log_of(rigid(), planted, seed=4, duration=8.0))], rigid())
    assert (found.verdict, found.causes[0].effect) == ("effect", "coulomb_friction")
    assert found.causes[0].parameters["torque"].value == pytest.approx(0.2, rel=0.1)


def test_an_effort_recorded_as_a_command_has_noise_and_a_command_has_none():
    log = free()
    sent = log.commands["external_torque"] + NOISE * np.random.default_rng(4).standard_normal(len(log.commands))
    commands = Signals(log.commands.time, {"external_torque": sent}, log.commands.units, log.commands.held)
    for measured in (True, False):
        column = WireColumn(column="effort", measured=measured)
        device = log.device.model_copy(update={"wire": Wire(columns={"external_torque": column})})
        density = cut_log(replace(log, device=device, commands=commands)).torque_density[EXTERNAL]
        assert density == (pytest.approx(NOISE**2 / 500.0, rel=0.1) if measured else 0.0)
