"""Quality of a recording: each trouble planted alone is found with a remedy, and sound recordings pass."""

import os
from pathlib import Path

import numpy as np
import pytest
from gap_logs import flexible, log_of, positioned, rigid, servo
from via_core.signals import Signals
from via_gap.logs.log import JointLog
from via_gap.logs.noise import log_noise
from via_gap.logs.quality import Quality, assess
from via_gap.report.report import LogInterval
from via_gap.report.withheld import compared_segments
from via_gap.residual.recordings import Recordings

STEP = 9.587e-5
DATA = Path(os.environ.get("VIA_REAL_LOGS", "real-logs"))


def quality(log: JointLog) -> Quality:
    return assess(log, log_noise(log))


def checks(log: JointLog) -> dict[str, str]:
    return {each.check: each.severity for each in quality(log).findings}


def rigid_log(q: np.ndarray, tau: np.ndarray | None, rate: float = 500.0, time: np.ndarray | None = None) -> JointLog:
    """Prescribed motion and torque of a rigid joint, read by its encoder."""
    time = np.arange(len(q)) / rate if time is None else time
    channels = {"q": STEP * np.rint(q / STEP)}
    if tau is not None:
        channels["tau"] = tau[:, None]
    return JointLog("rigid", rigid(), Signals(time, channels, {"q": "rad", "tau": "N m"}), None)


def changed(log: JointLog, keep=None, commands=None) -> JointLog:
    measured = log.measured
    keep = np.ones(len(measured), bool) if keep is None else keep
    kept = Signals(measured.time[keep], {n: each[keep] for n, each in measured.channels.items()}, measured.units)
    return JointLog(log.name, log.device, kept, commands or log.commands)


def moving(seconds: float = 12.0, rate: float = 500.0) -> tuple[np.ndarray, np.ndarray]:
    """Angle of a pendulum swung irregularly, and the torque that this takes, dry friction included."""
    time = np.arange(round(seconds * rate)) / rate
    q = 0.9 * np.sin(2.0 * time) + 0.4 * np.sin(5.3 * time + 1.0) + 0.2 * np.sin(9.1 * time)
    speed, bend = np.gradient(q, 1.0 / rate), np.gradient(np.gradient(q, 1.0 / rate), 1.0 / rate)
    return q, 0.04 * bend + 0.1 * speed + 0.05 * np.sign(speed) + np.sin(q)


@pytest.fixture(scope="module")
def clean() -> JointLog:
    return log_of(flexible(), (), seed=11, duration=8.0)


@pytest.mark.parametrize("device", [flexible, rigid, servo])
def test_sound_recordings_pass(device):
    found = quality(log_of(device(), (), seed=11, duration=8.0))
    assert [f for f in found.findings if f.severity != "note"] == []
    assert found.cannot_tell == ""
    assert found.seconds == pytest.approx(8.0, abs=0.1)


def test_a_sound_recording_of_a_rigid_joint_with_torque_passes():
    assert quality(rigid_log(*moving())).findings == ()


def test_on_a_regular_clock_only_the_samples_of_a_gap_are_left_out(clean):
    keep = np.ones(len(clean.measured), bool)
    keep[1000:1100] = keep[3000:3030] = False
    found = quality(changed(clean, keep))
    assert {f.check for f in found.findings} == {"late"}
    assert found.seconds == pytest.approx(8.0, abs=0.01)  # segments weigh single samples


def test_gaps_that_interpolation_cannot_bridge_are_listed_and_cut_nothing(clean):
    keep = np.random.default_rng(4).random(len(clean.measured)) > 0.1
    keep[1000:1100] = False
    found = quality(changed(clean, keep))
    assert found.seconds == pytest.approx(8.0, abs=0.01)
    assert any(begin < 1.05 < end for begin, end in found.sample_gaps)


def test_a_log_with_half_its_ticks_late_is_downgraded(clean):
    rng = np.random.default_rng(2)
    keep = rng.random(len(clean.measured)) > 0.35
    assert checks(changed(clean, keep))["late"] == "downgrade"


@pytest.mark.parametrize(("missing", "apart", "used", "short"), [(19, 20.0, 8.0, 1), (39, 40.0, 7.96, 0)])
def test_missing_commands_are_noise_and_cut_out_where_they_are_long(clean, missing, apart, used, short):
    commands = clean.commands
    keep = np.ones(len(commands), bool)
    keep[2001 : 2001 + missing] = False
    less = Signals(commands.time[keep], {"motor": commands["motor"][keep]}, commands.units, commands.held)
    found = quality(changed(clean, commands=less))
    (gap,) = (f for f in found.findings if f.check == "command gaps")
    assert gap.value == pytest.approx(apart, abs=0.5)
    assert found.seconds == pytest.approx(used, abs=0.005)
    assert len(found.command_gaps) == short


def test_commands_may_be_missing_for_a_tenth_of_a_segment_of_the_drive():
    """A position drive settles within a longer segment than a motor under torque drifts."""
    log = log_of(positioned(), (), duration=6.0)
    gaps = [(k, k + round(0.05 * positioned().sensors.rate)) for k in range(300, len(log.measured) - 200, 250)]
    keep = np.ones(len(log.measured), dtype=bool)
    for begin, end in gaps:
        keep[begin + 1 : end] = False
    sent = {name: values[keep[: len(values)]] for name, values in log.commands.channels.items()}
    commands = Signals(log.commands.time[keep[: len(log.commands)]], sent, log.commands.units, log.commands.held)
    found = quality(changed(log, keep, commands))
    assert len(found.command_gaps) >= len(gaps) - 1 and len(found.usable) == 1  # commands hardly change in one


def test_wrong_stamps_are_weighed_against_the_noise():
    q, tau = moving()
    time = np.arange(len(q)) / 500.0
    wrong = time + 1e-4 * np.random.default_rng(3).normal(size=len(q))
    assert checks(rigid_log(q, tau, time=wrong))["jitter"] == "downgrade"


def test_a_torque_faster_than_the_log_is_noticed():
    q, tau = moving()
    chatter = 6.0 * np.sign(np.random.default_rng(4).normal(size=len(q)))
    assert checks(rigid_log(q, tau + chatter)) == {"decimated": "downgrade"}


def test_a_rigid_joint_without_torque_cannot_be_told():
    q, _ = moving()
    found = quality(rigid_log(q, None))
    assert "external_torque" in found.cannot_tell
    log = rigid_log(q, None)
    free = Signals(log.measured.time, {"external_torque": np.zeros(len(q))}, {"external_torque": "N m"})
    assert quality(JointLog("free", log.device, log.measured, free)).cannot_tell == ""


def test_a_torque_of_the_angle_alone_cannot_be_told():
    q, _ = moving()
    noise = 0.004 * np.random.default_rng(5).normal(size=len(q))
    found = quality(rigid_log(q, np.sin(q) + 0.2 * np.abs(q) + 0.1 * np.tanh(8.0 * q) + noise))
    assert "hand" in found.cannot_tell
    assert {f.check for f in found.findings} == {"torque of angle"}


def test_a_slow_motion_against_gravity_is_not_taken_for_it():
    time = np.arange(0.0, 60.0, 0.01)
    q = 0.8 * np.sin(0.4 * time) + 0.3 * np.sin(0.17 * time)
    speed = np.gradient(q, 0.01)
    tau = 0.04 * np.gradient(speed, 0.01) + 0.1 * speed + np.sin(q)
    assert checks(rigid_log(q, tau, rate=100.0)) == {"torque of angle": "downgrade"}


def test_a_motor_that_only_turns_one_way_is_not_taken_for_it():
    time = np.arange(0.0, 10.0, 0.002)
    q = 0.62 * time + 0.002 * np.sin(4.0 * time)
    tau = 0.02 + 0.03 * np.sin(7.0 * q) + 0.02 * np.sin(12.0 * q) + 0.001 * np.sin(31.0 * time)
    assert "torque of angle" not in checks(rigid_log(q, tau))


def test_too_little_motion_cannot_be_told():
    q, tau = moving()
    found = quality(rigid_log(2e-4 * q, tau))
    assert "too little motion" in {f.check for f in found.findings}
    assert "clamp" in found.cannot_tell and "move it further" in found.cannot_tell


def test_a_link_held_by_a_stop_is_cut_out_and_mostly_held_refused():
    q, tau = moving(16.0)
    tau = 0.2 * np.sin(q) + 0.02 * tau
    top = float(np.max(q))
    rng = np.random.default_rng(6)
    pushed = 2.0 + np.repeat(rng.normal(size=40), 200)[: len(q)]
    for seconds, severity in ((4.0, "downgrade"), (12.0, "refuse")):
        held = np.arange(len(q)) / 500.0 > 16.0 - seconds
        found = quality(rigid_log(np.where(held, top, q), np.where(held, pushed, tau)))
        (stop,) = (f for f in found.findings if f.check == "clamped")
        assert stop.severity == severity
        assert found.seconds == pytest.approx(16.0 - seconds, abs=0.6)


@pytest.mark.skipif(not (DATA / "dfki_simple_pendulum").is_dir(), reason="needs VIA_REAL_LOGS")
@pytest.mark.parametrize(
    ("name", "caught"),
    [("gravity_compensation", True), ("energy_shaping", False), ("ddp", False), ("pd_system_identification", False)],
)
def test_of_real_pendulums_only_gravity_compensation_is_refused(name, caught):
    table = np.genfromtxt(DATA / "dfki_simple_pendulum" / f"{name}.csv", delimiter=",", skip_header=1)
    channels = {"q": table[:, 1], "tau": table[:, 3:4]}
    sensors = rigid().sensors.model_copy(update={"link_quantum": 0.0029})
    device = rigid().model_copy(update={"sensors": sensors})
    log = JointLog(name, device, Signals(table[:, 0], channels, {"q": "rad", "tau": "N m"}), None)
    assert ("angle alone" in quality(log).cannot_tell) == caught


@pytest.mark.skipif(not (DATA / "odrive_cogging").is_dir(), reason="needs VIA_REAL_LOGS")
def test_real_cogging_is_not_taken_for_a_controller():
    for path in sorted((DATA / "odrive_cogging").glob("*.csv")):
        table = np.genfromtxt(path, delimiter=",", skip_header=1)
        channels = {"q": table[:, 1] * 2.0 * np.pi / 8192, "tau": 0.0551 * table[:, 2:]}
        log = JointLog(path.name, rigid(), Signals(table[:, 0], channels, {"q": "rad", "tau": "N m"}), None)
        assert quality(log).cannot_tell == ""


def test_a_gap_measured_again_compares_the_segments_of_the_diagnosis(clean):
    """Those where commands are missing belong neither to the report nor to `via gap simulate --report`."""
    commands = clean.commands
    sent = (commands.time < 3.0) | (commands.time > 3.4)
    lost = Signals(commands.time[sent], {"motor": commands["motor"][sent]}, commands.units, commands.held)
    log = changed(clean, commands=lost)
    (diagnosed,) = Recordings.of([log], None, log.device).fitted
    (segments,), (chosen,) = compared_segments([log], [LogInterval(log=log.name, begin=0.0, end=9.0)])
    np.testing.assert_array_equal(segments.begin[chosen], diagnosed.begin[diagnosed.valid])
    begin, end = segments.time[chosen], segments.time[chosen] + segments.ticks / segments.rate
    assert not np.any((begin < 3.39) & (end > 3.01))
    assert np.min(begin[begin > 3.2]) < 3.42  # the next segment begins when there are commands again
