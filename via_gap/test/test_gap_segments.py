"""Segments: only a log's own plant explains it, down to the sensors' steps, for every effect that the row can hold."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid, servo
from via_core.errors import SignalError
from via_core.signals import Signals
from via_gap.logs.log import JointLog, believed
from via_gap.logs.quality import assessed
from via_gap.residual.cuts import rest_from
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import binned, cut_log
from via_gap.residual.true_starts import without_parts
from via_gap.selection.holdout import split
from via_sim.effects import Effect

DELAY = Effect("actuator_delay", "command", {"delay": 0.0043})
SKEW = Effect("channel_skew", "timing", {"delay": 0.003}, 0)
OFFSET = Effect("encoder_offset", "sensor", {"offset": 0.02}, 1)
ECCENTRIC = Effect("encoder_eccentricity", "sensor", {"amplitude": 0.01, "phase": 0.7}, 1)
BACKLASH = Effect("backlash", "transmission", {"gap": 0.02}, 1)
PULSE = Effect("external_torque", "environment", {"torque": 0.1, "start": 2.0, "stop": 4.0})
MAXWELL = Effect("hysteresis", "transmission", {"torque": 0.05, "stiffness": 1.0}, 1)


def explained(log: JointLog, effects) -> float:
    """Median mean squared whitened error of the segments under a plant: 1 is what the sensors leave."""
    segments = cut_log(log)
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    return float(np.median(problem.per_segment(problem.residual([problem.row(effects)])[0])))


@pytest.mark.parametrize("effect", [None, DELAY, SKEW, OFFSET, ECCENTRIC, BACKLASH, PULSE, MAXWELL], ids=str)
def test_only_its_own_plant_explains_a_log(effect):
    effects = () if effect is None else (effect,)
    log = log_of(flexible(), effects, seed=5, duration=6.0, tolerance=0.0)
    assert 0.5 < explained(log, effects) < 1.5
    if effect is not None and effect is not PULSE:  # which is over in most segments
        assert explained(log, ()) > 10.0


def test_motors_that_nobody_measured_follow_their_commands():
    log = log_of(servo(), (), seed=5, duration=12.0, tolerance=0.0)
    bare = Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"})
    unseen = JointLog("unseen", log.device, bare, log.commands)
    assert unseen.level == "commands only"
    assert cut_log(unseen).axes == (0,)
    assert explained(unseen, ()) < 2.0


def test_jitter_does_not_move_commands_off_their_ticks():
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    shift = 0.2e-3 * np.random.default_rng(1).uniform(-1.0, 1.0, len(log.measured))
    time = log.measured.time + shift
    angles = {name: np.empty_like(log.measured[name]) for name in ("q", "theta")}
    angles["q"] = np.interp(time, log.measured.time, log.measured["q"])
    angles["theta"] = np.interp(time, log.measured.time, log.measured["theta"][:, 0])[:, None]
    jittered = JointLog("jittered", log.device, Signals(time, angles, log.measured.units), log.commands)
    segments = cut_log(jittered)
    assert np.allclose((segments.origin * segments.rate) % 1.0, [0.0], atol=1e-6) or np.isclose(
        (segments.origin * 1000) % 1, 1
    )
    assert explained(jittered, ()) < 2.0


def test_a_log_without_a_drive_cannot_be_cut():
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    bare = Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"})
    with pytest.raises(SignalError, match="nothing can be simulated"):
        cut_log(JointLog("bare", log.device, bare, None))


def test_fitted_and_held_out_segments_are_disjoint_and_complete():
    segments = cut_log(log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0))
    (train,), (held,), _ = split([segments], [])
    assert sorted([*train, *held]) == list(range(len(segments)))
    assert len(held) > 0.25 * len(segments)
    train, held, logs = split([segments], [segments])
    assert len(logs) == 2
    assert (len(train[0]), len(train[1]), len(held[0]), len(held[1])) == (len(segments), 0, 0, len(segments))


def test_an_encoder_that_jumps_in_one_log_is_believed_in_none():
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    theta = log.measured["theta"].copy()
    theta[50::100] += 1.0
    wild = Signals(log.measured.time, {**log.measured.channels, "theta": theta}, log.measured.units)
    first, second = believed([log, JointLog("wild", log.device, wild, log.commands)])
    assert first.motors_seen == second.motors_seen == (False,)
    assert believed([log])[0].motors_seen == (True,)


def test_a_late_encoder_reads_what_was_before_the_shot():
    late = Effect("channel_skew", "timing", {"delay": 0.0047}, 0)
    segments = cut_log(log_of(rigid(), (late,), seed=3, duration=4.0, tolerance=0.0))
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    delayed = Effect("actuator_delay", "command", {"delay": 0.0047})
    found = problem.per_segment(problem.residual([problem.row([late]), problem.row([delayed])]))
    assert np.max(found[0]) < 2.5
    assert np.mean(found[0]) == pytest.approx(np.mean(found[1]), abs=0.05)  # of one encoder the two are the same


def test_a_shot_starts_at_the_speed_of_quick_motion():
    device = flexible()
    log = log_of(device, (), seed=5, duration=6.0, tolerance=0.0)
    amplitude, rate = 0.05, 2.0 * np.pi * 7.0
    time = np.arange(2001) / 1000.0
    quantum = device.sensors.link_quantum
    q = quantum * np.rint(amplitude * np.sin(rate * time) / quantum)
    measured = Signals(time, {"q": q, "theta": q[:, None]}, {"q": "rad", "theta": "rad"})
    segments = cut_log(JointLog("quick", device, measured, log.commands))
    speed = amplitude * rate * np.cos(rate * (time + segments.origin))[20:-20]
    error = segments.start[20 : 20 + len(speed), 3] - speed
    assert np.max(np.abs(speed)) > 2.0
    assert np.sqrt(np.mean(error**2)) < 0.01  # a quadratic's slope: 0.04
    assert np.sqrt(np.mean(error**2)) < segments.start_noise[0, 1]


@pytest.mark.parametrize("early", [0.0, 1e-12], ids=["at", "before"])
def test_commands_that_rounding_puts_before_their_samples_change_on_the_same_ticks(early):
    log = log_of(rigid(), (), seed=3, duration=4.0, tolerance=0.0)
    sent = log.commands
    commands = Signals(sent.time - early, sent.channels, sent.units, sent.held)
    segments = cut_log(JointLog("rounded", log.device, log.measured, commands))
    assert segments.origin == pytest.approx(log.measured.time[0], abs=1e-9)


@pytest.mark.parametrize("device", [rigid(), flexible()], ids=["sample by sample", "in bins"])
def test_what_stands_for_lost_samples_is_not_compared(device):
    log = log_of(device, (), seed=5, duration=6.0, tolerance=0.0)
    lost = np.zeros(len(log.measured), dtype=bool)
    lost[100:-100:47] = True
    there = {name: values[~lost] for name, values in log.measured.channels.items()}
    gappy = JointLog("gappy", log.device, Signals(log.measured.time[~lost], there, log.measured.units), log.commands)
    segments = cut_log(gappy)
    assert segments.valid.all() and 0.01 < np.mean(segments.weight == 0.0) < 0.1
    assert np.allclose(np.mean(segments.weight**2, axis=(1, 2)), 1.0)
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    moved = ResidualModel.of(
        [replace(segments, measured=segments.measured + (segments.weight == 0.0))], [np.arange(1, len(segments))]
    )
    left, same = (each.per_segment(each.residual([each.row(())])[0]) for each in (problem, moved))
    assert np.array_equal(left, same) and np.max(left) < 1.6


def test_segments_of_which_most_is_lost_count_by_what_was_measured():
    """Pauses of a busy machine: bursts of samples, and gaps that hide the motion in most of the time."""
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    count = len(log.measured)
    lengths = np.random.default_rng(2).integers(2, 6, count)  # of bursts and gaps in turn
    there = np.repeat(np.arange(count) % 2 == 0, lengths)[:count]
    few = {name: values[there] for name, values in log.measured.channels.items()}
    bursts = JointLog("bursts", log.device, Signals(log.measured.time[there], few, log.measured.units), log.commands)
    segments = cut_log(bursts, quality=assessed(bursts))
    assert segments.valid.mean() > 0.9
    assert np.mean(np.mean(segments.weight[segments.valid] > 0.0, axis=(1, 2)) < 0.5) > 0.3
    assert np.allclose(np.mean(segments.weight**2, axis=(1, 2)), 1.0)
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    assert 0.7 < np.mean(problem.residual([problem.row(())])[0] ** 2) < 1.4
    every = replace(segments, weight=np.ones_like(segments.weight))
    whole = ResidualModel.of([every], [np.flatnonzero(segments.valid)])
    assert np.mean(whole.residual([whole.row(())])[0] ** 2) > 2.0, "interpolated angles are no measurement"


def test_a_segment_counts_by_its_measured_values():
    """Of every four values one was measured: the mean square is the same, the loss and its curvature are a quarter."""
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    whole = cut_log(log)
    thin = replace(whole, weight=np.where(np.arange(whole.weight.shape[1])[:, None] % 4 == 1, 2.0, 0.0) * whole.weight)
    chosen = np.arange(1, len(whole))
    for robust in (False, True):
        every, fourth = (ResidualModel.of([each], [chosen], robust=robust) for each in (whole, thin))
        left, few = (each.residual([each.row(())])[0] for each in (every, fourth))
        assert fourth.per_segment(few).mean() == pytest.approx(every.per_segment(left).mean(), rel=0.1)
        share = fourth.measured / every.measured
        assert share == pytest.approx(16.0 / 62.0)
        assert fourth.loss(few) == pytest.approx(share * every.loss(left), rel=0.1)
        squares = [np.sum((each.weights(of) * of) ** 2) for each, of in ((every, left), (fourth, few))]
        assert squares[1] == pytest.approx(share * squares[0], rel=0.1)


def test_no_command_between_two_samples_is_lost():
    """Every tenth sample of a log whose commands change on every tick: with fewer ticks most would be left out."""
    log = log_of(flexible(), (), seed=9, duration=6.0, tolerance=0.0)
    channels = {name: values[::10] for name, values in log.measured.channels.items()}
    seldom = replace(log, measured=Signals(log.measured.time[::10], channels, log.measured.units))
    assert cut_log(seldom).rate == cut_log(log).rate == 1000.0
    rng = np.random.default_rng(1)
    restless = log.commands["motor"] + 0.05 * rng.normal(size=log.commands["motor"].shape)
    commanded = Signals(
        log.commands.time, {**log.commands.channels, "motor": restless}, log.commands.units, log.commands.held
    )
    assert np.unique(cut_log(replace(seldom, commands=commanded)).commands[:, 0]).size > 5900


def test_a_rest_counts_once_and_each_motion_for_itself():
    """A servo moves, rests at two angles with one move between, and moves: rests of six and four segments."""
    log = log_of(rigid(), (), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    path = np.zeros((14, segments.ticks + 1, 1))
    path[[0, 7, 12, 13]] = np.linspace(0.0, 1.0, segments.ticks + 1)[:, None]
    path[1:7] += 1.0
    path[8:12] += 2.0 + 1e-4 * np.random.default_rng(1).normal(size=(4, segments.ticks + 1, 1))
    found = rest_from(path, np.array([2e-3]))
    assert found.tolist() == [0, *[1] * 6, 7, *[8] * 4, 12, 13]
    slow = np.linspace(0.0, 0.02, 14)[:, None, None] + np.zeros((14, 3, 1))  # creeps: no rest, though no one moves
    assert len(set(rest_from(slow, np.array([2e-3])))) > 5
    resting = replace(segments, begin=segments.begin[:14], rest_from=found)
    every = ResidualModel.of([resting, resting], [np.arange(14), np.array([2, 3, 9])])
    squares = np.arange(17.0)
    assert every.once_per_rest(squares).tolist() == [0.0, 3.5, 7.0, 9.5, 12.0, 13.0, 14.5, 16.0]


@pytest.mark.parametrize("quantum", [0.0, 2e-3])
def test_a_rest_with_noise_is_one_rest(quantum):
    """Gaussian noise has a range of 5 to 7 sd in a segment; a coarse encoder that flickers, of one step."""
    log = log_of(rigid(), (), seed=5, duration=6.0, tolerance=0.0)
    time = log.measured.time
    angle = np.sin(5.0 * np.minimum(time, 2.0)) + 5e-4 * np.random.default_rng(2).normal(size=len(time))
    angle = quantum * np.round(angle / quantum) if quantum else angle
    held = Signals(time, {**log.measured.channels, "q": angle}, log.measured.units)
    segments = cut_log(replace(log, measured=held))
    resting = segments.begin / segments.rate > 2.1
    assert len(set(segments.rest_from[resting])) == 1
    moving = segments.begin / segments.rate < 1.5
    assert len(set(segments.rest_from[moving])) == np.count_nonzero(moving)


def test_whole_recordings_are_held_out_only_where_motion_is_comparable():
    segments = cut_log(log_of(rigid(), (), seed=5, duration=3.0, tolerance=0.0))
    phase = 2.0 * np.pi * np.arange(len(segments.start)) / segments.ticks  # each segment is one period
    swing = np.zeros_like(segments.start)
    swing[:, 0], swing[:, 3] = np.sin(phase), np.cos(phase)

    def whole(*sizes: float) -> bool:
        """Whether recordings with swings of these sizes are held out as a whole; if not, all are on both sides."""
        train, held, _ = split([replace(segments, start=size * swing) for size in sizes], [])
        divided = [len(a) > 0 and len(b) > 0 for a, b in zip(train, held, strict=True)]
        assert all(divided) or not any(divided)
        return not all(divided)

    assert whole(1.0, 1.0, 1.0, 1.0, 1.0) and whole(1.0, 1.2, 0.8)
    assert not whole(1.0, 0.02, 0.02)  # of one that moves 50 times as much, either side would have nothing


def test_recordings_of_one_segment_are_held_out_by_their_motion():
    """Blocks of such recordings are recordings as well, every third and fifth of five: here those that move most."""
    log = log_of(rigid(), (), seed=5, duration=1.0, tolerance=0.0)
    one = cut_log(log, span=0.9)
    assert len(one) == 1

    def held_out(*sizes: float) -> list[int]:
        logs = [replace(one, start=size * one.start, valid=np.array([True])) for size in sizes]
        return [number for number, each in enumerate(split(logs, [])[1]) if len(each)]

    assert len({2, 4} & set(held_out(0.3, 0.3, 3.0, 0.3, 3.0))) == 1
    assert held_out(1.0, 0.2, 0.2) == [1, 2]  # 7 % of the motion, which is better than the 4 % of the third alone


def test_the_first_segment_counts_only_where_a_log_begins_at_rest():
    """A one-sided fit does not know how fast a joint moves; that one at rest does not, it knows."""
    log = log_of(flexible(), (), seed=9, duration=6.0, tolerance=0.0)
    assert cut_log(log).valid.all()
    later = slice(2000, None)
    channels = {name: values[later] for name, values in log.measured.channels.items()}
    moving = replace(log, measured=Signals(log.measured.time[later], channels, log.measured.units))
    valid = cut_log(moving).valid
    assert not valid[0] and valid[1:].all()


def test_a_log_that_begins_slowly_does_not_begin_at_rest():
    """The first velocity of an axis at rest counts as 0; at .1 to .5 rad/s the first segment would be wrong."""
    log = log_of(flexible(), (), seed=9, duration=6.0, tolerance=0.0)
    speeds = np.abs(np.gradient(np.column_stack([log.measured["q"], log.measured["theta"]]), log.measured.time, axis=0))
    slow = np.convolve(np.all((speeds > 0.1) & (speeds < 0.5), axis=1), np.ones(20), "valid") == 20
    first = 200 + int(np.argmax(slow[200:3000]))
    assert slow[first]
    later = slice(first, None)
    channels = {name: values[later] for name, values in log.measured.channels.items()}
    moving = cut_log(replace(log, measured=Signals(log.measured.time[later], channels, log.measured.units)))
    assert not moving.rests and not moving.valid[0] and moving.valid[1:].all()


@pytest.mark.parametrize("every", [1, 4])
def test_angles_are_compared_per_bin_by_their_mean_or_the_last_one(every):
    angles = np.random.default_rng(1).normal(size=(3, 15, 2))  # the start, and 14 ticks
    ticks = [range(1 + bin * every, 1 + (bin + 1) * every) for bin in range(14 // every)]
    mean, last = (binned(angles, every, averaged) for averaged in (True, False))
    np.testing.assert_allclose(mean, np.stack([angles[:, each].mean(axis=1) for each in ticks], axis=1))
    np.testing.assert_array_equal(last, np.stack([angles[:, each[-1]] for each in ticks], axis=1))


def test_what_uncertain_starts_explain_is_removed_column_by_column():
    random = np.random.default_rng(2)
    error, shrink = random.normal(size=(2, 3, 5)), random.uniform(size=(3, 2))
    basis = np.linalg.qr(random.normal(size=(3, 5, 2)))[0]
    expected = error.copy()
    for row, segment, k in np.ndindex(2, 3, 2):
        column = basis[segment, :, k]
        expected[row, segment] -= shrink[segment, k] * (column @ error[row, segment]) * column
    np.testing.assert_allclose(without_parts(error, basis, shrink), expected, atol=1e-12)
