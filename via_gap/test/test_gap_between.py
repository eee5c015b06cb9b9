"""Commands between the samples of a log: a thinned log says itself that they went on, and how often they were sent."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import controlled, flexible, log_of, rigid
from via_core.devices import Device, load_device
from via_core.signals import Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.between import LATE_TORQUES, acting, in_lines, lines_finding, steps_of
from via_gap.logs.log import JointLog
from via_gap.rendering.words import cautions
from via_gap.report.withheld import before_and_after
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DELAY = Effect("actuator_delay", "command", {"delay": 0.0213})
DEAD = Effect("position_deadband", "motor", {"width": 0.03}, 1)
LATE = Effect("actuator_delay", "command", {"delay": 0.006})  # less than a sample of 10 ms
LATER = Effect("actuator_delay", "command", {"delay": 0.015})
PAYLOAD = Effect("payload", "link", {"mass": 0.1, "distance": 0.3})


def thinned(log: JointLog, every: int) -> JointLog:
    """Every so manieth sample, with the command that acted from it on."""
    parts = [
        Signals(s.time[::every], {n: v[::every] for n, v in s.channels.items()}, s.units, s.held)
        for s in (log.measured, log.commands)
    ]
    return replace(log, measured=parts[0], commands=parts[1])


@pytest.mark.parametrize(
    ("device", "verdict"), [(rigid(), "no_gap"), (flexible(), "cannot_tell")], ids=["smooth", "of an encoder"]
)
def test_a_thinned_log_says_how_often_commands_were_sent(device, verdict):
    """What a controller made of its encoder's steps between the samples is lost, and nothing is blamed for it."""
    log = log_of(device, (), seed=11, duration=20.0)
    report = diagnose([thinned(log, 5)], device)
    assert report.verdict == verdict
    assert 2.0 * report.lined == pytest.approx(1.0 / device.sensors.rate, rel=0.3)
    assert any(finding.check == "between samples" for finding in report.data_check)


def test_a_log_as_fast_as_its_controller_keeps_its_steps():
    report = diagnose([log_of(rigid(), (PAYLOAD,), seed=11, duration=20.0)], rigid())
    assert report.lined is None and report.verdict == "effect" and report.effects[0].effect == "payload"


def test_an_effect_is_found_in_a_thinned_log_and_measured_on_another_one():
    logs = [thinned(log_of(rigid(), (PAYLOAD,), seed=seed, duration=20.0), 5) for seed in (11, 12)]
    report = diagnose(logs[:1], rigid())
    assert report.verdict == "effect" and report.effects[0].effect == "payload"
    before, after = before_and_after(report.as_read(logs[1:]), rigid(), report.repaired())
    assert after.overall < 0.3 * before.overall


@pytest.mark.parametrize("device", [rigid(), flexible()], ids=["rigid", "flexible"])
def test_the_interval_of_a_delay_contains_that_of_commands_between_samples(device):
    """The motion shows the sum of the drive's delay and that of steps which nobody commanded, up to half a sample."""
    whole = log_of(device, (DELAY,), seed=11, duration=20.0)
    cause = diagnose([thinned(whole, 5)], device).causes[0]
    assert cause.effect in ("actuator_delay", "channel_skew")  # with one encoder, both are one cause
    delay, period = cause.parameters["delay"], 5.0 / device.sensors.rate
    assert abs(delay.value - 0.0213) < 1.96 * delay.sd < 0.6 * period


def test_lines_act_late_and_pass_the_samples():
    time = np.arange(10) / 100.0
    commands = Signals(
        time, {"external_torque": 3.0 * time}, {"external_torque": "N m"}, frozenset({"external_torque"})
    )
    log = JointLog("log", rigid(), Signals(time, {"q": time}, {"q": "rad"}), commands)
    assert acting(log) is commands
    grid = np.arange(80) / 1000.0
    moved = acting(in_lines(log, 0.002), grid)["external_torque"]
    assert moved == pytest.approx(3.0 * np.maximum(grid + 0.0005 - 0.002, 0.0))
    assert "4 ms" in lines_finding(in_lines(log, 0.002)).text
    # Lines as late as steps of 10 ms are no sign of commands between the samples.
    assert "no command is missing" in lines_finding(in_lines(log, 0.0045)).text
    at_once = lines_finding(in_lines(log, 3e-6)).text
    assert "linear interpolation explains" in at_once and "ms" not in at_once


def test_a_step_is_what_a_difference_shares_with_neither_neighbour():
    assert steps_of(np.array([0.0, 0.0, 2.0, 2.0, 2.0])) == pytest.approx([0.0, 2.0, 0.0, 0.0])
    assert not np.any(steps_of(np.array([0.0, 0.0, 1.0, 2.0, 3.0, 3.0])))  # a ramp
    noise = np.random.default_rng(2).normal(0.0, 0.1, 400)
    assert np.mean(np.abs(steps_of(noise)) > 0.0) < 0.02  # otherwise noise would be a row of steps
    assert 4.0 < steps_of(noise + np.where(np.arange(400) > 200, 5.0, 0.0))[200] < 5.0
    time = np.arange(0.0, 2.0, 0.01)
    smooth = np.sin(5.0 * time)
    assert np.abs(steps_of(smooth)).max() < 5.0**2 * 0.01**2 * 1.01  # a second difference
    both = smooth[:, None] + np.stack([time >= 0.995, np.zeros(len(time))], axis=1)
    assert np.abs(steps_of(both)[:, 0]).argmax() == 99 and steps_of(both)[99, 0] == pytest.approx(1.0, abs=1e-2)
    assert not np.any(steps_of(np.array([0.0, np.nan, 1.0, 1.0])))  # a drive that is off


def test_a_step_between_samples_acts_halfway_and_keeps_its_mean():
    """On a grid that no sample and no middle hits; the integral over all time is that of a step at .105 s."""
    time = np.arange(20) / 100.0
    values = np.where(time > 0.105, 3.0, 1.0)
    commands = Signals(time, {"external_torque": values}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    log = JointLog("log", rigid(), Signals(time, {"q": time}, {"q": "rad"}), commands)
    grid = 0.00073 * np.arange(255)
    for late in (0.0, 0.0031):
        moved = acting(in_lines(log, late), grid)["external_torque"]
        assert np.sum((moved > 1.0 + 1e-9) & (moved < 3.0 - 1e-9)) == 1
        first, last = grid[0], grid[-1] + 0.00073
        assert moved.sum() * 0.00073 == pytest.approx(last - first + 2.0 * (last - 0.105 - late))


@pytest.mark.parametrize(
    ("polled", "effect", "parameter"), [(True, DEAD, "width"), (True, LATER, "delay"), (False, LATE, "delay")], ids=str
)
def test_a_goal_that_jumps_between_samples_or_at_one(polled, effect, parameter):
    """The jump is at an unknown time before its sample, or at it: in either case the effect is found."""
    device = load_device("xl330_kp800")
    report = diagnose([jumping(device, effect, seed, polled) for seed in (1, 2)], device)
    assert (report.lined is not None) == polled
    (named,) = report.effects
    assert named.effect == effect.name and report.verdict in ("effect", "main_effect")
    estimate = report.causes[0].parameters[parameter]
    assert abs(estimate.value - effect.parameters[parameter]) < min(
        0.1 * effect.parameters[parameter], 1.96 * estimate.sd
    )


def jumping(device: Device, effect: Effect, seed: int, polled: bool) -> JointLog:
    """Every tenth sample of a position drive at 1 kHz, whose goal jumps at any tick or at such samples alone."""
    rng, count, every, rate = np.random.default_rng(seed), 12_000, 10, 1000.0
    goal, begin = np.zeros(count), 150
    while begin < count:
        begin = begin if polled else -(-begin // every) * every
        goal[begin:] = rng.uniform(-1.0, 1.0)
        begin += int(rng.uniform(300, 900))
    sensors = device.sensors.model_copy(update={"rate": rate})
    fast = device.model_copy(update={"sensors": sensors})
    commands = Signals(
        np.arange(count) / rate, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"})
    )
    plant, start = JointPlant.from_device(fast).with_effects([effect]), InitialConditions(seed=seed)
    motion = simulate(plant, commands, count / rate, rate, Sensors.of_device(fast), start).measured
    return thinned(JointLog(f"log {seed}", device, motion.select(["q"]), commands), every)


@pytest.mark.parametrize(("samples", "named"), [(6, ()), (6, ("coulomb_friction",)), (0, ("viscous_friction",))])
def test_measured_torques_that_are_late_are_shifted(samples, named):
    """A filtered current, alone and beside a friction; and a friction that a shift resembles, with torques in time."""
    friction = {
        "coulomb_friction": Effect("coulomb_friction", "link", {"torque": 0.05}),
        "viscous_friction": Effect("viscous_friction", "link", {"coefficient": 0.05}),
    }
    log = log_of(flexible(), tuple(friction[each] for each in named), seed=5, duration=15.0)
    measured, tau = log.measured, log.measured["tau"].copy()
    tau[samples:] = tau[: len(tau) - samples]
    channels = {**measured.channels, "tau": tau}
    late = replace(log, measured=Signals(measured.time, channels, measured.units, measured.held), commands=None)
    report = diagnose([late], flexible())
    assert report.verdict == ("effect" if named else "no_gap")
    assert tuple(each.effect for each in report.effects) == named
    for name in named:
        (parameter, value), *_ = report.causes[0].parameters.items()
        assert value.value == pytest.approx(friction[name].parameters[parameter], rel=0.03)
    notes = [each for each in report.data_check if each.signal == LATE_TORQUES]
    if not samples:
        assert report.lined is None and not notes
        return
    (note,) = notes
    assert note.value == pytest.approx(samples, abs=0.1)  # [ms]
    assert f"{note.value:.3g} ms later than the angles" in " ".join(cautions(report))
    before, after = before_and_after(report.as_read([late]), flexible(), report.repaired())
    assert after.overall < 0.1 * before.overall


def test_friction_in_motion_of_one_frequency_is_not_a_late_torque():
    """There a shift of the torques resembles viscous friction; beside the tuned device it would be taken for it."""
    device, friction = flexible(), Effect("viscous_friction", "motor", {"coefficient": 0.2}, 1)
    time = np.arange(15001) / 1000.0
    wish = 0.5 * np.clip(time, 0.0, 1.0) * np.sin(2.0 * np.pi * 2.5 * time)
    plant = JointPlant.from_device(device).with_effects([friction])
    measured, _ = controlled(plant, Sensors.of_device(device), 1000.0, time, wish, seed=3)
    report = diagnose([JointLog("one frequency", device, measured, None)], device)
    assert (report.verdict, [each.effect for each in report.effects]) == ("effect", ["viscous_friction"])
    assert report.lined is None


def test_a_command_between_two_ticks_acts_for_the_rest_of_the_tick():
    """Stamps with jitter are not on ticks; the integral is that of zero-order hold up to the end of every tick."""
    rng = np.random.default_rng(3)
    time = 0.01 * np.arange(60) + rng.uniform(0.0, 0.0004, 60)
    values = rng.normal(0.0, 1.0, 60)
    commands = Signals(time, {"external_torque": values}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    log = JointLog("log", rigid(), Signals(time, {"q": time}, {"q": "rad"}), commands)
    grid, fine = 0.002 * np.arange(290), 1e-5 * (np.arange(58000) + 0.5)
    held = values[np.clip(np.searchsorted(time, fine, side="right") - 1, 0, None)]
    moved = acting(log, grid)["external_torque"]
    assert np.abs(np.cumsum(moved) * 0.002 - np.cumsum(held.reshape(-1, 200).mean(axis=1)) * 0.002).max() < 1e-4
    off = replace(commands, channels={"external_torque": np.where(np.arange(60) == 30, np.nan, values)})
    unknown = np.isnan(acting(replace(log, commands=off), grid)["external_torque"])
    assert 4 <= np.count_nonzero(unknown) <= 6 and np.all(np.abs(grid[unknown] - time[30]) < 0.0105)


def test_commands_on_ticks_stay_as_recorded():
    time = 0.004 * np.arange(50)
    values = np.random.default_rng(4).normal(0.0, 1.0, 50)
    commands = Signals(time, {"external_torque": values}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    log = JointLog("log", rigid(), Signals(time, {"q": time}, {"q": "rad"}), commands)
    grid = time[0] + np.arange(190) / 1000.0
    np.testing.assert_array_equal(acting(log, grid)["external_torque"], np.repeat(values, 4)[:190])
    uneven = time + np.random.default_rng(5).uniform(0.0, 0.002, 50)
    log = replace(log, commands=replace(commands, time=uneven))
    np.testing.assert_array_equal(acting(log, uneven)["external_torque"], values)
