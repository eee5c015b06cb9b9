"""Integral action and feedforward of a position drive are found, and what is known of them is no gap."""

import numpy as np
import pytest
from gap_logs import positioned
from via_core.signals import Signals
from via_gap.candidates.covariance import delay_sd, unfitted_delay_sd
from via_gap.candidates.location import Location
from via_gap.diagnosis import diagnose
from via_gap.logs.between import in_lines
from via_gap.logs.log import JointLog
from via_gap.residual.nuisance import delay_between_samples, nuisances
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.run.arm_equation import _drive_torque
from via_gap.selection.experiment import Experiment
from via_sim.effects import Effect
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

RATE, KI, LATER = 500.0, 24.0, 1000  # [Hz], [N m/(rad s)], [samples]


def with_integral(ki: float = KI, **more: float):
    device = positioned()
    assert device.servo is not None
    return device.model_copy(update={"servo": device.servo.model_copy(update={"ki": ki, **more})})


def recorded(device, effects=(), seed: int = 5) -> JointLog:
    """A log that begins two seconds after the drive was switched on, when its integral holds the link."""
    time = np.arange(8000) / RATE
    goal = 0.9 + 0.5 * np.sin(1.3 * time) + 0.3 * np.sin(3.1 * time) + 0.1 * np.sign(np.sin(0.8 * time))
    commands = Signals(time, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    plant = JointPlant.from_device(device).with_effects(effects)
    begin = InitialConditions([goal[0], 0.0, 0.0, 0.0, 0.0, 0.0], seed=seed)
    measured = simulate(plant, commands, time[-1], RATE, Sensors.of_device(device), begin).measured
    time = time[: len(measured) - LATER]
    later = Signals(time, {"q": measured["q"][LATER:]}, {"q": "rad"})
    return JointLog("log", device, later, Signals(time, {"equilibrium": goal[LATER:]}, commands.units, commands.held))


def test_integral_action_is_found_with_its_torque_at_the_beginning():
    truth = with_integral()
    log = recorded(truth)
    report = diagnose([JointLog("log", positioned(), log.measured, log.commands)], positioned())
    assert [each.effect for each in report.effects] == ["integral_action"]
    (cause,) = [each for each in report.causes if each.effect == "integral_action"]
    rate, start = cause.parameters["rate"], cause.parameters["start"]
    assert rate.value == pytest.approx(KI / 12.0, rel=0.03)
    assert start.value > 0.3  # it held the weight of the link


def test_the_torque_of_a_known_integral_at_the_beginning_is_no_gap():
    report = diagnose([recorded(with_integral())], with_integral())
    assert report.verdict == "no_gap"
    assert "servo integral at the start" not in [each.name for each in report.nuisance]


def test_only_a_drive_with_integral_action_has_a_start_within_its_limits():
    known = {device.servo.ki: nuisances(JointPlant.from_device(device)) for device in (positioned(), with_integral())}
    assert [n.name for n in known[KI][len(known[0.0]) :]] == ["servo integral at the start"]
    model = ResidualModel.of_plant(JointPlant.from_device(with_integral(integral_limit=0.6)))
    offsets = np.zeros(len(model.nuisances))
    offsets[-1] = 1.3
    assert model.row((), offsets)[P.integral_start] == pytest.approx(0.6)
    assert model.repaired(offsets) == model.device


def test_an_arm_does_not_know_the_torque_of_a_drive_with_integral_action():
    log = recorded(positioned())
    q = log.measured["q"]
    known = _drive_torque(log, q, 0.0 * q)
    unknown = _drive_torque(JointLog("log", with_integral(), log.measured, log.commands), q, 0.0 * q)
    assert np.isfinite(known).all() and np.isnan(unknown).all()


def test_a_wrong_payload_beside_a_known_integral_is_found():
    heavy = Effect("payload", "link", {"mass": 0.5, "distance": 0.2})
    report = diagnose([recorded(with_integral(), [heavy])], with_integral())
    assert [each.effect for each in report.effects] == ["payload"]


def test_a_drive_whose_damping_follows_the_goal_is_found():
    log = recorded(positioned(), [Effect("velocity_feedforward", "motor", {"share": 1.0}, 1)])
    report = diagnose([JointLog("log", positioned(), log.measured, log.commands)], positioned())
    assert [each.effect for each in report.effects] == ["velocity_feedforward"]
    share = report.causes[0].parameters["share"]
    assert abs(share.value - 1.0) < 2.0 * share.sd


def test_a_feedforward_is_known_to_half_a_sample_at_best():
    """Commands may have been lines or steps: the lead of the goal, share kd / kp, is uncertain by that."""
    model = ResidualModel.of([cut_log(recorded(positioned()))], [np.arange(2)])
    (found,) = delay_sd(model, [Location("velocity_feedforward", "motor", 1)])
    assert found == pytest.approx(0.5 / 1.96 / RATE * 12.0 / 0.4)
    late = [Location(name, "command", 0) for name in ("actuator_delay", "actuator_lag")]
    assert unfitted_delay_sd(model, late) == pytest.approx([0.0, 0.5 / 1.96 / RATE])


@pytest.mark.parametrize(
    ("late", "sd"),
    [(None, 0.5 / 1.96), (0.0, 0.5 / 1.96), (0.2, 0.3 / 1.96), (0.4, 0.5 / 12**0.5), (-0.1, 0.5 / 12**0.5)],
)
def test_a_delay_is_not_known_by_what_is_left_of_half_a_period(late, sd):
    """Lines that act at once may stand for steps, which act late by half a period."""
    log = recorded(positioned())
    model = ResidualModel.of([cut_log(log if late is None else in_lines(log, late / RATE))], [np.arange(2)])
    assert delay_sd(model, [Location("actuator_delay", "command", 0)]) == pytest.approx([sd / RATE])


def test_an_arm_takes_the_goal_with_its_feedforward():
    log = recorded(positioned())
    q, goal = log.measured["q"], log.commands["equilibrium"]
    plain, led = (
        _drive_torque(JointLog("log", with_integral(0.0, feedforward=f), log.measured, log.commands), q, 0.0 * q)
        for f in (0.0, 1.0)
    )
    delay = 4  # ticks of .0073 s
    expected = 0.4 * np.diff(goal)[:1000] * RATE
    free = np.abs(led[delay + 1 : delay + 1001]) < 4.0  # within the torque limit
    np.testing.assert_allclose((led - plain)[delay + 1 : delay + 1001][free], expected[free], atol=1e-9)


@pytest.mark.parametrize("late", [-0.003, 0.0025])
def test_goals_that_act_between_samples_are_no_gap(late: float):
    """Goals at 100 Hz act 3 ms before or 2.5 ms after the sample that shows them; the drive has 7.3 ms of delay."""
    device, rate = positioned(), 100.0
    time = np.arange(2500) / rate
    goal = 0.3 + 0.9 * np.sin(2.6 * time) + 0.5 * np.sin(5.1 * time) + 0.3 * np.sin(0.7 * time)
    acts = Signals(time + 0.01, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    plant = JointPlant.from_device(device)
    begin = InitialConditions([goal[0], 0.0, 0.0, 0.0, 0.0, 0.0], seed=2)
    fast = simulate(plant, acts, time[-1], 2000.0, Sensors.of_device(device), begin).measured
    shift = round(late * 2000.0)
    at = (np.arange(50, 2400) * 20 - shift)[: len(fast) // 20 - 60]
    stamps = fast.time[at] + 0.5 - fast.time[at][0]
    measured = Signals(stamps, {"q": fast["q"][at]}, {"q": "rad"})
    shown = Signals(stamps, {"equilibrium": goal[49 : 49 + len(at)]}, acts.units, acts.held)
    log = JointLog("log", device, measured, shown)
    experiment = Experiment.of([cut_log(log)], [])
    found = dict(zip([n.name for n in experiment.fitted.nuisances], experiment.tuned.fit.offsets, strict=True))
    (delay,) = (n for n in experiment.fitted.nuisances if n.name == "goal delay between samples")
    assert delay.start * found[delay.name] == pytest.approx(late, abs=0.0005)
    assert np.mean(experiment.tuned.segments) < 2.0
    assert experiment.fitted.repaired(experiment.tuned.fit.offsets).servo.delay == device.servo.delay


def test_goals_do_not_act_before_they_are_sent():
    log = recorded(with_integral(0.0, delay=0.0002))
    (delay,) = delay_between_samples(log)
    assert delay.lowest * delay.start == pytest.approx(-0.0002)
    (free,) = delay_between_samples(JointLog("log", with_integral(0.0, delay=0.09), log.measured, log.commands))
    assert free.lowest == -1.3
