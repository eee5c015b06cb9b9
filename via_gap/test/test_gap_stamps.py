"""Commands that depend on the measured angle distinguish a late stamp of the angle from a late command."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_logs import flexible, log_of, positioned, rigid
from gap_models import scales
from via_core.signals import Array, Signals
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.report.answer import _weights
from via_gap.report.causes import compared_causes
from via_gap.selection.evidence import Evaluation
from via_gap.selection.verdict import Decision
from via_gap.sensors.stamps import LATE_ANGLE, LATE_COMMAND, separate_delays, stamped_late, with_late_angle
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import simulate

SUBSTEPS = 20
DRY = Location("coulomb_friction", "link", 0)


def joint(dead: int, stamp: float, answers: bool, seed: int = 3) -> JointLog:
    """Ten seconds of an inertia with viscous friction under a drive that answers to the rounded angle, or to nothing.

    dead   substeps by which commands act late
    stamp  [s] by which the angle on record is older than its stamp
    """
    device = rigid()
    rate, step = device.sensors.rate, device.sensors.link_quantum
    rng = np.random.default_rng(seed)
    count, h = round(10.0 * rate), 1.0 / (rate * SUBSTEPS)
    time = np.arange(count + 1) / rate
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    tones = np.array([[0.3], [0.9], [2.3]]) * 2.0 * np.pi
    wish = np.array([0.5, 0.3, 0.1]) @ (np.sin(tones * time + phase[:, None]) - np.sin(phase)[:, None])
    random = rng.standard_normal(count)
    angle, command = np.zeros(count * SUBSTEPS + 1), np.zeros(count)
    q = v = speed = before = 0.0
    for k in range(count):
        read = step * np.rint(q / step)
        speed += 0.5 * ((read - before) * rate - speed)
        before = read
        command[k] = 8.0 * (wish[k] - read) - 0.5 * speed if answers else 0.5 * wish[k] + 0.2 * random[k]
        for j in range(SUBSTEPS):
            acting = k * SUBSTEPS + j - dead
            torque = command[acting // SUBSTEPS] if acting >= 0 else 0.0
            v += h * (torque - 0.1 * v - (0.0 if answers else 0.5 * q)) / 0.04
            q += h * v
            angle[k * SUBSTEPS + j + 1] = q
    fine = np.arange(len(angle)) * h
    seen = step * np.rint(np.interp(time - stamp, fine, angle) / step)
    commands = Signals(
        time[:-1], {"external_torque": command}, {"external_torque": "N m"}, frozenset({"external_torque"})
    )
    return JointLog("joint", device, Signals(time, {"q": seen}, {"q": "rad"}), commands)


@cache
def late_command() -> JointLog:
    return joint(dead=29, stamp=0.0, answers=True)


@cache
def late_angle() -> JointLog:
    return joint(dead=0, stamp=2.9e-3, answers=True)


@pytest.mark.parametrize("off", [0.0, 4e-5], ids=["known", "fitted"])
def test_a_drive_tells_what_it_read(off):
    assert stamped_late([late_command()], 2.9e-3 + off) is False
    assert stamped_late([late_angle()], 2.9e-3 + off) is True


@pytest.mark.parametrize("stamp", [0.9e-3, 2e-3, 6.6e-3], ids=["half a sample", "a whole sample", "three samples"])
def test_a_late_stamp_is_told_whatever_part_of_a_sample_it_is(stamp):
    assert stamped_late([joint(dead=0, stamp=stamp, answers=True)], stamp) is True


def test_a_drive_that_answers_to_nothing_tells_nothing():
    for dead, stamp in ((29, 0.0), (0, 2.9e-3)):
        assert stamped_late([joint(dead, stamp, answers=False)], 2.9e-3) is None


def test_a_smooth_command_that_resembles_its_motion_tells_nothing():
    device, time = rigid(), np.arange(4000) / 100.0
    speeds = 2.0 * np.pi * np.array([[0.4], [1.1], [2.7], [6.0]])
    command = np.array([0.6, 0.4, 0.3, 0.3]) @ np.cos(speeds * time + np.arange(4)[:, None])
    moved = np.array([0.6, 0.4, 0.3, 0.3]) / np.abs(0.1j * speeds[:, 0] - 0.04 * speeds[:, 0] ** 2)
    turned = np.angle(1.0 / (0.1j * speeds - 0.04 * speeds**2))
    angle = moved @ np.cos(speeds * (time - 5e-3) + np.arange(4)[:, None] + turned)
    angle = device.sensors.link_quantum * np.rint(angle / device.sensors.link_quantum)
    commands = Signals(time, {"external_torque": command}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    log = JointLog("joint", device, Signals(time, {"q": angle}, {"q": "rad"}), commands)
    assert stamped_late([log], 5e-3) is None


def test_commands_in_steps_tell_nothing():
    """Between their steps they do not change, so nothing is left to explain."""
    device, time = rigid(), np.arange(4000) / 500.0
    command = np.where(np.sin(2.0 * time) > 0.0, 0.5, 0.0)
    command[0] = 1.0  # the largest one is left out, as that of a drive at its limit
    angle = device.sensors.link_quantum * np.rint(0.3 * np.sin(2.0 * time) / device.sensors.link_quantum)
    commands = Signals(time, {"external_torque": command}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    log = JointLog("joint", device, Signals(time, {"q": angle}, {"q": "rad"}), commands)
    assert stamped_late([log], 5e-3) is None


def test_lost_samples_are_left_out():
    log = late_angle()
    kept = np.random.default_rng(1).uniform(size=len(log.measured)) > 0.01
    thinner = Signals(log.measured.time[kept], {"q": log.measured["q"][kept]}, {"q": "rad"})
    assert stamped_late([JointLog(log.name, log.device, thinner, log.commands)], 2.9e-3) is True


def evaluation(*locations: Location, loss: float) -> Evaluation:
    effects = tuple(p.effect({"torque": 0.1} if p == DRY else {"delay": 2.9e-3}) for p in locations)
    some: Array = np.ones(4)
    return Evaluation(Fit(effects, np.zeros(1), loss, some, np.zeros((1, 1))), some, loss * some, 1)


@pytest.mark.parametrize(
    ("log", "right", "wrong"),
    [(late_command, LATE_COMMAND, LATE_ANGLE), (late_angle, LATE_ANGLE, LATE_COMMAND)],
    ids=["command", "angle"],
)
def test_what_the_drive_rules_out_is_no_cause_alone_nor_beside_another(log, right, wrong):
    models = [evaluation(*each, loss=loss) for each, loss in (((wrong,), 1.0), ((right,), 1.1), ((DRY,), 9.0))]
    models.append(evaluation(wrong, DRY, loss=0.9))
    kept, (finding,) = separate_delays([log()], models)
    assert {each.fit.locations: each.fit.loss for each in kept} == {
        (right, DRY): 0.9,  # there is no other: the same numbers hold
        (right,): 1.1,  # the fit of the right one itself
        (DRY,): 9.0,
    }
    pair = next(each for each in kept if len(each.fit.effects) == 2)
    assert pair.fit.effects[0].parameters == {"delay": 2.9e-3}
    assert finding.check == "feedback" and finding.severity == "note"


def test_without_a_delay_nothing_is_asked():
    models = [evaluation(DRY, loss=1.0)]
    assert separate_delays([late_angle()], models) == (models, [])


def with_delay(delay: float, name: str = "actuator_delay") -> Evaluation:
    place = LATE_COMMAND if name == "actuator_delay" else DRY
    effect = place.effect({"delay": delay} if place == LATE_COMMAND else {"torque": 0.1})
    some: Array = np.ones(4)
    return Evaluation(Fit((effect,), np.zeros(1), 1.0, some, np.zeros((1, 1))), some, some, 1)


def late(delay: float = 0.01) -> Decision:
    """A decision for a late command, with friction as the other cause."""
    models = (with_delay(delay), with_delay(0.0, "friction"))
    shares = ((LATE_COMMAND, 0.7), (DRY, 0.4))
    return Decision("effect", models[0], 1.0, shares, models, (LATE_COMMAND,))


def link_alone(log: JointLog) -> JointLog:
    return replace(log, measured=Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"}))


def test_where_only_the_link_is_measured_a_late_angle_is_the_twin_of_a_late_command():
    both = log_of(flexible(), (), seed=1, duration=1.0)
    found = with_late_angle(late(), link_alone(both))
    assert found.shares == ((LATE_COMMAND, 0.7), (LATE_ANGLE, 0.7), (DRY, 0.4))
    assert found.equivalent == (LATE_COMMAND, LATE_ANGLE) and found.named == (LATE_COMMAND,)
    assert [each.fit.locations[0] for each in found.models] == [LATE_COMMAND, LATE_ANGLE, DRY]
    assert found.models[1].fit.effects[0].parameters == {"delay": 0.01}
    assert [found.alone(cause) for cause, _ in found.shares] == [0.5, 0.5, 1.0]
    positioned_log = replace(link_alone(both), device=positioned())
    assert LATE_ANGLE in with_late_angle(late(), positioned_log).equivalent


def test_twins_have_one_probability_and_one_part_of_the_error_together():
    found = with_late_angle(late(), link_alone(log_of(flexible(), (), seed=1, duration=1.0)))
    fit = found.chosen.fit
    named = replace(found.chosen, fit=replace(fit, effects=(*fit.effects, DRY.effect({"torque": 0.1}))))
    several = replace(found, chosen=named, without=(4.0, 25.0))
    assert several.part(LATE_ANGLE) == several.part(LATE_COMMAND) == pytest.approx(0.4)
    weights = _weights(several, ())
    assert weights["command", 0] == weights["timing", 0] == pytest.approx(0.5 * 0.7 * 0.4)
    assert weights["link", 0] == pytest.approx(0.4 * several.part(DRY))
    causes = compared_causes(flexible(), found, scales(), found.chosen)
    assert [each.effect for each in causes] == ["actuator_delay", "channel_skew", "coulomb_friction"]
    command, angle, dry = causes
    assert command.probability == angle.probability and command.share == angle.share == 0.7
    assert (command.probability + angle.probability) / dry.probability == pytest.approx(0.7 / 0.4)


@pytest.mark.parametrize("channel", ["external_torque", "arm_torque", "neighbour"])
def test_what_acts_in_time_separates_a_late_angle_from_a_late_command(channel):
    log = link_alone(log_of(flexible(), (), seed=1, duration=1.0))
    count = len(log.commands.time)

    def beside(values):
        other = Signals(log.commands.time, {channel: values}, {channel: "N m"}, frozenset({channel}))
        return replace(log, commands=log.commands.joined(other))

    decision = late()
    if channel == "neighbour":  # acts through a coupling only
        assert with_late_angle(decision, beside(np.sin(np.arange(count)))).twins
        fit = decision.chosen.fit
        coupled = Location("joint_coupling", "link", 0).effect({"stiffness": 1.0})
        decision = replace(decision, chosen=replace(decision.chosen, fit=replace(fit, effects=(*fit.effects, coupled))))
    assert not with_late_angle(decision, beside(np.sin(np.arange(count)))).twins
    assert with_late_angle(late(), beside(np.zeros(count))).twins
    assert not with_late_angle(decision, beside(np.where(np.arange(count) % 2, np.nan, 0.1))).twins  # partly recorded
    driven = replace(log, device=positioned(), measured=log.measured.joined(
        Signals(log.measured.time, {"tau": np.ones((len(log.measured), 1))}, {"tau": "N m"})))  # fmt: skip
    assert not with_late_angle(late(), driven).twins


def test_a_late_angle_is_not_added_where_something_separates_it():
    """Another measured angle, the drive of a rigid joint, a delay longer than stamps are late, no late command."""
    both = log_of(flexible(), (), seed=1, duration=1.0)
    dry = Decision("effect", with_delay(0.0, "friction"), 1.0, ((DRY, 1.0),), late().models[1:], (DRY,))
    for decision, log in (
        (late(), both), (late(), replace(link_alone(both), device=rigid())), (late(0.08), link_alone(both)),
        (dry, link_alone(both)),
    ):  # fmt: skip
        assert with_late_angle(decision, log) is decision


def test_a_report_shows_twins_at_both_sites_and_neither_as_untried():
    device, rate = positioned(), 500.0
    time = np.arange(6000) / rate
    sent = {"equilibrium": 0.4 * np.sin(1.3 * time) + 0.3 * np.sin(3.1 * time) + 0.1 * np.sin(9.0 * time)}
    commands = Signals(time, sent, {"equilibrium": "rad"}, frozenset(sent))
    plant = JointPlant.from_device(device).with_effects((LATE_COMMAND.effect({"delay": 0.02}),))
    measured = simulate(plant, commands, time[-1], rate, Sensors.of_device(device)).measured
    report = diagnose([JointLog("log", device, measured.select(["q"]), commands)], device)
    assert [each.effect for each in report.effects] == ["actuator_delay"]
    assert {each.effect for each in report.equivalence_set} == {"actuator_delay", "channel_skew"}
    assert {each.site: each.share for each in report.where} == {"command": 0.5, "timing": 0.5}
    assert "channel_skew" not in report.figures.untried
