"""Commands between the samples of a log: a thinned log says itself that they went on, and how often they were sent."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from via_core.signals import Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.between import acting, in_lines, lines_finding
from via_gap.logs.log import JointLog
from via_gap.report.withheld import before_and_after
from via_sim.effects import Effect

DELAY = Effect("actuator_delay", "command", {"delay": 0.0213})
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
