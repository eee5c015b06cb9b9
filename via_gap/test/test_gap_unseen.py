"""States of motors without an encoder, simulated along the measured link, equal those of the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of
from via_core.signals import Signals
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Segments, cut_log
from via_gap.residual.unseen import OF_LINK, UnseenMotors
from via_sim.effects import Effect
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate


def without_motors(log):
    measured = Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"})
    return replace(log, measured=measured)


def rollout_of(segments: Segments):
    every = np.arange(len(segments))
    return Rollout(segments, every, np.empty(0), np.empty(0), 0, np.zeros(6), np.zeros((len(every), 6)), np.zeros(1))


def test_the_simulated_angle_of_an_unmeasured_motor_equals_its_encoder():
    log = log_of(flexible(), (), seed=3, duration=8.0, tolerance=0.0)
    seen, unseen = cut_log(log), cut_log(without_motors(log))
    assert seen.axes == (0, 1) and unseen.axes == (0,)
    rollout = rollout_of(unseen)
    states = rollout._states_of_unseen(rollout.segments.nominal[None], None)[0]
    read = seen.angles[unseen.begin, 1]
    late = unseen.time - unseen.origin > 2.0  # the initial angle has no influence any more
    assert late.any() and np.std(read[late]) > 0.05
    assert states[late, 1] == pytest.approx(read[late], abs=3e-4)


def test_segments_with_an_unmeasured_motor_show_an_effect():
    """If the link were reset at the beginning of each segment only, the error of the motor would grow without bound."""
    effect = Effect("payload", "link", {"mass": 0.05, "distance": 0.3}, 0)
    log = log_of(flexible(), (effect,), seed=4, duration=20.0, tolerance=0.0)
    segments = cut_log(without_motors(log))
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    right, nominal = problem.residual([problem.row([effect]), problem.row([])])
    assert np.sqrt(np.mean(right**2)) < 1.6
    assert np.sqrt(np.mean(nominal**2)) > 10.0


def test_torques_on_the_link_have_no_influence_on_an_unmeasured_motor():
    """Each slot of OF_LINK is changed alone, without the cache, in which such rows share their states."""
    segments = cut_log(without_motors(log_of(flexible(), (), seed=5, duration=4.0)))
    rollout, ticks = rollout_of(segments), segments.begin[2:]
    values = {
        P.inertia: 0.03,
        P.contact_angle: 5.0,
        P.contact_side: -1.0,
        P.stribeck_velocity: 0.4,
        P.load_velocity: 0.4,
    }
    rows = np.repeat(rollout.segments.nominal[None], 2 + len(OF_LINK), axis=0)
    rows[range(1, 1 + len(OF_LINK)), OF_LINK] = [values.get(slot, 0.05) for slot in OF_LINK]
    rows[-1, P.inertia + 1] *= 1.2  # of the motor
    fresh = rollout._initial(np.zeros(len(rows), dtype=np.intp), segments.commands, np.zeros(len(rows), dtype=np.intp))
    motors = UnseenMotors(segments.start, np.array([0]), ticks, segments.commands[None], fresh[:1])
    out = motors.integrated(rows, fresh)
    assert np.max(np.abs(out[1:-1, :, 1] - out[0, :, 1])) < 2e-5 < 1e-3 < np.max(np.abs(out[-1, :, 1] - out[0, :, 1]))
    shared = rollout._states_of_unseen(rows, None)[:, 2:]
    assert np.array_equal(shared[0], shared[5]) and not np.array_equal(shared[0], shared[-1])
    assert np.max(np.abs(shared[:, :, 1] - out[:, :, 1])) < 5e-5
    again = rollout._states_of_unseen(rows[-3:], None)[:, 2:]
    assert np.array_equal(again, shared[-3:])


def test_rows_with_starts_of_their_own_move_as_alone():
    """Starts of an unmeasured motor, of segments, and commands of several rows at once, beside one row at a time."""
    segments = cut_log(without_motors(log_of(flexible(), (), seed=6, duration=4.0)))
    rollout, rng = rollout_of(segments), np.random.default_rng(0)
    begun, rows = 0.05 * rng.normal(size=(3, 6)), np.repeat(segments.nominal[None], 3, axis=0)
    alone = [replace(rollout, motor_start=each).motion(rows[:1])[0] for each in begun]
    assert np.max(np.abs(alone[1] - alone[0])) > 1e-3
    assert rollout.motion(rows, begun=begun) == pytest.approx(np.stack(alone), abs=1e-9)
    aside = 0.01 * rng.normal(size=(3, len(segments), 6))
    alone = [rollout.motion(rows[:1], each)[0] for each in aside]
    assert rollout.motion(rows, aside) == pytest.approx(np.stack(alone), abs=1e-9)
    sent = segments.commands + 0.01 * rng.normal(size=(3, 1, 1))
    alone = [rollout.motion(rows[:1], commands=each[None])[0] for each in sent]
    assert rollout.motion(rows, commands=sent) == pytest.approx(np.stack(alone), abs=1e-9)


def test_a_log_that_begins_in_motion_leaves_noise_beside_the_true_device():
    """The motor's state at the beginning is unknown: it is estimated, and what stays uncertain counts as noise."""
    log = log_of(flexible(), (), seed=6, duration=10.0, tolerance=0.0)
    time = log.measured.time
    middle = (time > 4.1) & (time < 5.6)
    measured = Signals(time[middle], {"q": log.measured["q"][middle]}, {"q": "rad"})
    segments = cut_log(replace(log, measured=measured))
    assert not segments.rests
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    unfitted = replace(problem.views[0], motor_start=np.zeros(6))
    row = problem.row([])
    assert np.sqrt(np.mean(problem.residual([row]) ** 2)) < 1.3
    raw = unfitted.segments.measured[unfitted.chosen] - unfitted.motion(row[None])[0]
    estimated = unfitted.segments.measured[unfitted.chosen] - problem.views[0].motion(row[None])[0]
    assert np.std(estimated) < 0.5 * np.std(raw)


def test_a_motor_that_moves_while_the_link_still_rests_leaves_noise():
    """The first segment is not used, and what its motor still does later counts as noise."""
    log = log_of(flexible(), (), seed=3, duration=8.0, tolerance=0.0)
    begin = np.array([0.0, 0.0, 0.0, 0.0, -1.5, 0.0])
    sensors, start = Sensors.of_device(log.device), InitialConditions(begin, seed=3)
    rate = log.device.sensors.rate
    run = simulate(JointPlant.from_device(log.device), log.commands, 8.0, rate, sensors, start)
    segments = cut_log(without_motors(replace(log, measured=run.measured)))
    assert segments.rests and not segments.valid[0] and segments.valid[1]
    assert cut_log(log).valid[0]  # with an encoder the start is known
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    squares = problem.per_segment(problem.residual([problem.row([])])[0])
    assert squares.max() < 4.0 and squares.mean() < 1.5
