"""The data check: each trouble planted alone is found, named and weighed; a clean log passes without a word."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of
from hypothesis import given
from hypothesis import strategies as st
from via_core.bags.joints import JointRecording, StampReport
from via_core.devices import load_device
from via_core.encoder_steps import step_of
from via_core.signals import Signals
from via_gap.logs.breaks import LEFT
from via_gap.logs.checks import check_log
from via_gap.logs.log import JointLog
from via_gap.logs.quality import SPANS

REPORTS = (StampReport("/joint_states", 0, 1, 0, 0, 0, 1),)


def changed(log: JointLog, keep=None, **channels) -> JointLog:
    measured = log.measured
    values = {**measured.channels, **channels}
    keep = np.ones(len(measured), bool) if keep is None else keep
    kept = Signals(measured.time[keep], {name: each[keep] for name, each in values.items()}, measured.units)
    return JointLog(log.name, log.device, kept, log.commands)


def findings(log: JointLog) -> dict[str, str]:
    return {f.check: f.severity for f in check_log(log)}


@pytest.fixture(scope="module")
def clean() -> JointLog:
    return log_of(flexible(), (), seed=11, duration=6.0)


def test_a_clean_log_passes_without_a_word(clean):
    assert check_log(clean) == []


def test_a_link_angle_that_never_changes_is_refused(clean):
    assert findings(changed(clean, q=np.full(len(clean.measured), 0.3)))["stale"] == "refuse"


def test_a_log_without_any_drive_is_refused(clean):
    bare = Signals(clean.measured.time, {"q": clean.measured["q"]}, {"q": "rad"})
    assert findings(JointLog("bare", clean.device, bare, None))["drive"] == "refuse"
    (found,) = [
        f for f in check_log(JointLog("bare", clean.device, bare, None, hint="; see goal")) if f.check == "drive"
    ]
    assert found.text.endswith("record the commands; see goal")


def test_an_angle_that_starts_again_after_each_turn_is_mentioned(clean):
    (found,) = check_log(replace(clean, passed={"q": 3}))
    assert (found.check, found.signal, found.severity, found.value) == ("turn", "q", "note", 3.0)
    assert found.text == "the angle starts again after a turn, 3 times; read as continuous"


def test_single_samples_that_jump_are_outliers(clean):
    q = clean.measured["q"].copy()
    q[[500, 900, 2500]] += 0.7
    (found,) = check_log(changed(clean, q=q))
    assert (found.check, found.value) == ("outliers", 3.0)


def test_a_torque_that_follows_its_command_late_is_skewed(clean):
    tau = np.roll(clean.measured["tau"], 4, axis=0)
    tau[:4] = 0.0
    found = {f.check: f for f in check_log(changed(clean, tau=tau))}
    assert found["skew"].value == pytest.approx(0.004, abs=1e-6)


def test_a_coarser_encoder_than_the_file_says_shows_its_step(clean):
    q = 0.002 * np.rint(clean.measured["q"] / 0.002)
    (found,) = check_log(changed(clean, q=q))
    assert found.check == "quantisation"
    assert found.value == pytest.approx(0.002, rel=1e-3)


@given(st.floats(1e-5, 1e-2), st.integers(0, 2**32 - 1))
def test_the_step_of_readings_is_found(step, seed):
    angles = np.cumsum(np.random.default_rng(seed).normal(size=4000)) * 5.0 * step
    assert step_of(step * np.rint(angles / step)) == pytest.approx(step, rel=1e-3)


def test_readings_without_a_grid_have_no_step():
    assert step_of(np.cumsum(np.random.default_rng(3).normal(size=4000))) == 0.0


def test_short_and_slow_logs_are_refused(clean):
    first = np.arange(len(clean.measured)) < 500
    assert findings(changed(clean, first))["duration"] == "refuse"
    rare = np.arange(len(clean.measured)) % 40 == 0
    assert findings(changed(clean, rare))["rate"] == "refuse"


@pytest.mark.parametrize("rate", [100.0, 500.0])
@pytest.mark.parametrize("wobble", [0.0, 1e-4, 1e-3])
def test_a_steady_speed_is_no_grid(rate, wobble):
    """Each measurement advances by 2 rad/s over a period, up to 200 times the encoder's step."""
    quantum, time = 9.587e-5, np.arange(4000) / rate
    angle = 2.0 * time + wobble * np.sin(3.0 * time)
    assert step_of(quantum * np.rint(angle / quantum)) in (0.0, pytest.approx(quantum, rel=0.01))
    coarse = 0.0131
    assert step_of(coarse * np.rint(angle / coarse)) == pytest.approx(coarse, rel=0.01)


def swinging(driven: bool) -> JointLog:
    """A rigid pendulum whose torque is recorded as 0 throughout: released twice, or driven."""
    device = load_device("dfki_simple_pendulum")
    time = np.arange(0.0, 20.0, 2e-3)
    since = time % 10.0
    q = np.exp(-0.15 * since) * np.cos(4.0 * since) if not driven else np.sin(time**1.3) + 0.6 * np.sin(2.1 * time)
    signals = Signals(time, {"q": q, "tau": np.zeros((len(time), 1))}, {"q": "rad", "tau": "N m"})
    return JointLog("swing", device, signals, None)


def test_a_joint_that_gains_energy_without_torque_is_refused():
    assert "undriven" not in findings(swinging(driven=False))
    (found,) = [each for each in check_log(swinging(driven=True)) if each.check == "undriven"]
    assert found.severity == "refuse" and "0 N m in all samples" in found.text
    log = swinging(driven=True)
    push = {"arm_torque": np.sin(log.measured.time)}  # a passive joint of an arm
    of_arm = replace(log, commands=Signals(log.measured.time, push, {"arm_torque": "N m"}, frozenset(push)))
    assert "undriven" not in findings(of_arm)


def test_a_break_of_an_hour_is_made_short(clean):
    """Samples and commands keep their order, and the report says so."""
    measured, commands = clean.measured, clean.commands

    def set_forward(signals: Signals) -> Signals:
        return replace(signals, time=signals.time + 3600.0 * (signals.time > 2.0))

    log = JointLog.of("jump", clean.device, JointRecording(set_forward(measured), set_forward(commands), REPORTS))
    moved = 1.0 * (measured.time > 2.0)
    period = float(np.median(np.diff(measured.time)))
    assert np.allclose(log.measured.time, measured.time + (moved > 0) * (LEFT - period), atol=1e-9)
    late = commands.time > 2.0 + period
    assert np.allclose(log.commands.time[late], commands.time[late] + LEFT - period, atol=1e-9)
    (found,) = [each for each in check_log(log) if each.check == "break"]
    assert max(SPANS.values()) < LEFT and found.value == pytest.approx(3600.0, abs=0.01)
    assert np.all(np.diff(log.commands.time) > 0.0)
