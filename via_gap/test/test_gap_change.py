"""The live comparison: changes of the gap on a joint with an own integrator, missing channels, cost of a tick."""

import numpy as np
import pytest
from gap_logs import antagonistic_log, rigid
from gap_reports import report_of
from via_core.signals import Signals
from via_core.status import Status
from via_gap.logs.log import JointLog
from via_gap.residual.rollout import Rollout
from via_gap.run.change import DAY, Expectation
from via_gap.run.comparison import compare
from via_gap.run.monitor import Monitor, MonitorParameters
from via_gap.run.worker import Finished

RATE, STEPS = 500.0, 4  # [Hz] samples, integration steps between them
START = 1_700_000_000_000_000_000  # [ns]
INERTIA, DAMPING, GRAVITY = 0.04, 0.1, 1.0  # of the device `rigid`
ONSET = 14.0  # [s]


def motion(duration, friction, still=(0.0, 0.0)):
    """q [rad] and torque [N m] of a rigid joint under a position loop; dry friction [N m] begins at ONSET.

    still  [s] interval in which the joint is held where it is
    """
    rng, step = np.random.default_rng(7), 9.587e-5
    count = round(duration * RATE)
    time = np.arange(count) / RATE
    clock = time - np.clip(time, *still) + still[0]  # the reference does not move while it stands
    wish = sum(
        0.3 * np.sin(f * clock + p) for f, p in zip((1.3, 3.1, 7.7, 11.0), rng.uniform(0.0, 6.0, 4), strict=True)
    )
    q = np.empty((count, 2))
    x = v = before = 0.0
    dt = 1.0 / RATE / STEPS
    for n in range(count):
        seen = step * np.round(x / step)
        torque = 16.0 * (wish[n] - seen) - 0.8 * (seen - before) * RATE * 0.3
        before, dry = seen, friction if time[n] >= ONSET else 0.0
        q[n] = seen, torque
        for _ in range(STEPS):
            half = v + 0.5 * dt * (torque - DAMPING * v - GRAVITY * np.sin(x) - dry * np.tanh(v / 1e-3)) / INERTIA
            middle = x + 0.5 * dt * v
            force = torque - DAMPING * half - GRAVITY * np.sin(middle) - dry * np.tanh(half / 1e-3)
            x, v = x + dt * half, v + dt * force / INERTIA
    return time, q[:, 0], q[:, 1]


class InstantWorker:
    """Ends every diagnosis at once, with the report that all is well."""

    def __init__(self):
        self.busy, self.jobs = False, []
        self.report = report_of("no_gap").model_copy(update={"nuisance": ()}).to_json()

    def begin(self, job):
        self.busy = True
        self.jobs.append(job)

    def poll(self):
        ended, self.busy = self.busy, False
        return Finished(self.report) if ended else None

    def cancel(self):
        self.busy = False


def watched(duration, friction, still=(0.0, 0.0)):
    """A monitor at the end of a stream, its jobs with the time [s] they began, and its answers at every tick."""
    monitor = Monitor(rigid(), MonitorParameters(device="joint", rate=5.0, least=6.0, every=20.0), "/joint_states")
    monitor.worker = InstantWorker()
    begun, answers, acted = [], [], np.nan
    for n, (time, q, torque) in enumerate(zip(*motion(duration, friction, still), strict=True)):
        stamp = START + round(1e9 * time)
        monitor.rolling.command(stamp, 2, np.nan, np.nan, 0.0, np.array([torque]))
        monitor.sample(stamp, np.array([q, np.nan, np.nan, acted]), time)
        acted = torque
        if n % 100 == 99:
            list(monitor.poll())
            answers.append((time, *monitor.compare(time), monitor.change))
            count = len(monitor.worker.jobs)
            monitor.diagnose_if_due(time)
            begun += [(time, each) for each in monitor.worker.jobs[count:]]
    return monitor, begun, answers


def test_an_effect_that_begins_is_noticed_within_a_second_and_diagnosed_from_there():
    _, begun, answers = watched(23.0, 0.05)
    noticed = [time for time, _, text, change in answers if change is not None and "the gap has changed" in text]
    assert ONSET < noticed[0] < ONSET + 1.0
    assert not any(change for time, _, _, change in answers if time < ONSET)
    (first, _), (second, job) = begun
    assert first < ONSET and second - noticed[0] == pytest.approx(6.0, abs=0.3)
    assert job.source.duration == pytest.approx(second - noticed[0], abs=0.1)  # nothing from before the change
    assert answers[-1][3] is None  # the new report is about the changed joint


def test_a_joint_without_a_change_that_stands_in_between_raises_no_alarm():
    _, begun, answers = watched(30.0, 0.0, still=(16.0, 21.0))
    assert {status for _, status, _, _ in answers} == {Status.WARMING_UP, Status.OK, Status.NOT_EXCITED}
    assert all(change is None for *_, change in answers) and len(begun) == 2


def test_the_rate_of_false_alarms_is_the_promised_one_for_correlated_levels():
    rng, alarms, count = np.random.default_rng(3), 0, 4000
    for _ in range(count):
        noise = rng.normal(size=90)
        levels = noise[1:] + 0.6 * noise[:-1]
        alarms += Expectation.of(levels[:80]).exceeded(levels[80:88], 0.01 * DAY)
    assert 0.004 <= alarms / count <= 0.016
    levels = rng.normal(size=80)
    assert Expectation.of(levels).exceeded(levels[:8] + 3.0, 0.1)
    assert not Expectation.of(levels).exceeded(levels[:8] - 3.0, 0.1) and Expectation.of(levels[:5]) is None


def test_measured_torques_in_place_of_commands_do_not_multiply_the_simulations(monkeypatch):
    log, runs = antagonistic_log(duration=2.0), []
    alone = JointLog(log.name, log.device, log.measured, None)
    motion = Rollout.motion
    monkeypatch.setattr(Rollout, "motion", lambda *args, **options: runs.append(0) or motion(*args, **options))
    commanded = compare(log, log.device), len(runs)
    sensed = compare(alone, log.device), len(runs) - commanded[1]
    assert sensed[1] == commanded[1] < 12
    assert 0.0 < sensed[0].error < 0.1


def test_an_encoder_that_falls_silent_is_not_taken_to_stand_still():
    log = antagonistic_log(duration=2.0)
    theta = log.measured["theta"].copy()
    theta[round(0.93 * len(theta)) :, 0] = np.nan
    channels = dict(log.measured.channels) | {"theta": theta}
    silent = JointLog(log.name, log.device, Signals(log.measured.time, channels, log.measured.units), log.commands)
    whole, cut = compare(log, log.device), compare(silent, log.device)
    assert cut.residual_ratio == pytest.approx(whole.residual_ratio, rel=0.2)
    assert cut.error == pytest.approx(whole.error, rel=0.5)
