"""Commands that the log lacks for a moment: size of what may have acted, its groups, and errors whitened with it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_logs import positioned, rigid
from via_core.signals import Signals
from via_gap.logs.log import JointLog
from via_gap.logs.noise import stamp_jitter
from via_gap.residual.command_gaps import GROUPS, gap_pulses
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Segments, cut_log, lined
from via_sim.joint.layout import EXTERNAL
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DURATION, STEP = 4.0, 0.05  # [s]; [N m] usual difference of neighbouring commands
GAP = (900, 910)  # ticks: in the eighth segment of .25 s at 500 Hz


@cache
def recorded(lost: float) -> Segments:
    """A joint under commands that alternate, one of which, `lost` [N m] higher, acted in a gap and was lost."""
    device = rigid()
    rate = device.sensors.rate
    time = np.arange(round(DURATION * rate)) / rate
    sent = 0.5 * np.sin(3.0 * time) + 0.5 * STEP * (-1.0) ** np.arange(len(time))
    acted = sent.copy()
    acted[GAP[0] + 1 : GAP[1] + 1] = sent[GAP[0]] + lost
    units, held = {"external_torque": "N m"}, frozenset({"external_torque"})
    every = Signals(time, {"external_torque": acted}, units, held)
    motion = simulate(
        JointPlant.from_device(device), every, DURATION, rate, Sensors.of_device(device), InitialConditions(seed=5)
    ).measured
    kept = np.ones(len(time), dtype=bool)
    kept[GAP[0] + 1 : GAP[1] + 1] = False
    log = JointLog(
        "gap", device, Signals(motion.time, {"q": motion["q"]}, {"q": "rad"}),
        Signals(time[kept], {"external_torque": sent[kept]}, units, held),
    )  # fmt: skip
    return cut_log(log)


def with_gaps(commands: np.ndarray, gaps: list[tuple[int, int]], period: int = 1) -> Segments:
    """Segments with the external torque (T,) and these gaps."""
    segments = recorded(0.0)
    sent = np.zeros_like(segments.commands)
    sent[: len(commands), EXTERNAL] = commands
    sent[len(commands) :, EXTERNAL] = commands[-1]
    return replace(segments, commands=sent, gaps=np.array(gaps, dtype=np.intp).reshape(-1, 2), command_ticks=period)


def test_a_pulse_lasts_as_long_as_the_gap_and_is_as_large_as_what_may_have_acted():
    """On a ramp of .01 N m a tick every number is known: neighbours differ by (end + 1 - begin) steps."""
    slope = 0.01
    count = len(recorded(0.0).commands)
    (pulse,) = gap_pulses(with_gaps(slope * np.arange(count), [(200, 207)]))
    there = np.flatnonzero(pulse[:, EXTERNAL])
    assert (there[0], there[-1]) == (201, 207) and len(there) == 7
    wanted = np.sqrt((8 * slope) ** 2 / 3.0 + slope**2)
    assert np.abs(pulse[there, EXTERNAL]) == pytest.approx(np.full(7, wanted))
    assert len(set(np.sign(pulse[there, EXTERNAL]))) == 1
    assert not np.delete(pulse, EXTERNAL, axis=1).any()


def test_its_size_is_the_standard_deviation_of_drawn_commands():
    """Anywhere between the neighbours, give or take the usual step: 200000 draws have this root mean square."""
    rng = np.random.default_rng(1)
    before, after, usual = 0.3, 0.9, 0.2
    drawn = before + (after - before) * rng.uniform(size=200_000) + usual * rng.normal(size=200_000)
    sent = before + 0.5 * usual * (1.0 - (-1.0) ** np.arange(len(recorded(0.0).commands)))
    sent[300:] += after - before
    (pulse,) = gap_pulses(with_gaps(sent, [(298, 305)]))  # both at even ticks once the first after the gap has acted
    assert sent[306] - sent[298] == pytest.approx(after - before)
    assert np.abs(pulse[:, EXTERNAL]).max() == pytest.approx(np.sqrt(np.mean((drawn - before) ** 2)), rel=5e-3)


def test_a_long_gap_has_the_moments_of_a_change_that_came_at_any_time():
    """20000 draws of the time of the change, means over three pieces, and in each the usual step besides."""
    count = len(recorded(0.0).commands)
    gap, usual = (298, 327), 0.02  # 29 ticks of 2 ms: three pieces
    sent = 0.5 * usual * (1.0 - (-1.0) ** np.arange(count))
    sent[gap[1] + 1 :] += 0.6
    pulses = gap_pulses(with_gaps(sent, [gap]))[:, :, EXTERNAL]
    assert np.array_equal(np.flatnonzero(pulses.any(axis=0)), np.arange(299, 328))
    found = np.einsum("gi,gj->ij", pulses, pulses)
    rng = np.random.default_rng(3)
    acted = 0.6 * (np.arange(3000) / 3000 >= rng.uniform(size=(20_000, 1)))
    means = acted.reshape(20_000, 3, 1000).mean(axis=2) + usual * rng.normal(size=(20_000, 3))
    middles = [303, 313, 323]
    assert found[np.ix_(middles, middles)] == pytest.approx(means.T @ means / 20_000, rel=0.03)


def test_a_jump_of_the_commands_is_not_a_usual_step():
    sent = 0.1 * (np.arange(len(recorded(0.0).commands)) % 2)
    jump = sent + np.where(np.arange(len(sent)) >= 600, 50.0, 0.0)
    plain, jumped = (np.abs(gap_pulses(with_gaps(each, [(200, 205)]))).max() for each in (sent, jump))
    assert plain == pytest.approx(0.1)
    assert jumped == pytest.approx(plain, rel=0.01)


def test_gaps_of_one_segment_have_pulses_of_their_own_and_no_gap_has_none():
    ramp = 0.01 * np.arange(len(recorded(0.0).commands))
    assert gap_pulses(with_gaps(ramp, [])).shape[0] == 0
    begin, ticks = recorded(0.0).begin, recorded(0.0).ticks
    three = [(int(begin[2]) + k, int(begin[2]) + k + 5) for k in (10, 30, 50)]
    one = [(int(begin[4]) + 10, int(begin[4]) + 15)]
    found = gap_pulses(with_gaps(ramp, three + one))
    assert len(found) == 3
    here = slice(begin[2], begin[2] + ticks)
    assert [len(np.flatnonzero(each[here, EXTERNAL])) for each in found] == [5, 5, 5]
    many = [(int(begin[2]) + 4 * k, int(begin[2]) + 4 * k + 2) for k in range(1, GROUPS + 4)]
    found = gap_pulses(with_gaps(ramp, many))
    assert len(found) == GROUPS
    assert len(np.flatnonzero(np.sum(found != 0.0, axis=0)[:, EXTERNAL])) == 2 * len(many)


def gapped(lost: float) -> tuple[Rollout, Rollout, np.ndarray]:
    """All segments with and without the knowledge of the gap, and which of them end after it began."""
    segments = recorded(lost)
    known = replace(segments, gaps=np.array([GAP], dtype=np.intp))
    chosen = np.flatnonzero(segments.valid)
    after = (segments.begin[chosen] <= GAP[0]) & (segments.begin[chosen] + segments.ticks > GAP[0])
    return Rollout.of(known, chosen), Rollout.of(segments, chosen), after


def test_a_command_that_acted_unrecorded_leaves_no_more_than_noise():
    known, unknown, there = gapped(0.04)
    with_gap, without = (
        np.mean(each.residual(each.segments.nominal[None])[0] ** 2, axis=1) for each in (known, unknown)
    )
    assert there.sum() == 1
    assert without[there][0] > 30.0
    assert with_gap[there][0] < 2.0
    assert with_gap[~there] == pytest.approx(without[~there], rel=1e-6)


def test_errors_are_whitened_by_their_whole_covariance():
    """The same by matrices: |w|^2 = e' (Id + A A')^-1 e, columns of A from one simulation for each uncertainty."""
    known, _, _ = gapped(0.04)
    segments, row = known.segments, known.segments.nominal
    scale = segments.weight[known.chosen] / segments.noise
    plain = known.motion(row[None])[0]
    moved = []
    for slot, sd in zip((0, 3), segments.start_noise[0], strict=True):
        moved.append(known.motion(row[None], sd * np.eye(6)[slot])[0])
    moved += [known.motion(row[None], commands=(segments.commands + each)[None])[0] for each in gap_pulses(segments)]
    columns = np.stack([((each - plain) * scale).reshape(len(plain), -1) for each in moved], axis=-1)
    errors = ((segments.measured[known.chosen] - plain) * scale).reshape(len(plain), -1)
    whitened = known.residual(row[None])[0]
    for error, matrix, white in zip(errors, columns, whitened, strict=True):
        covariance = np.eye(len(error)) + matrix @ matrix.T
        assert white @ white == pytest.approx(error @ np.linalg.solve(covariance, error), rel=1e-6)


def test_a_step_between_samples_has_pulses_before_and_after_the_middle():
    """Drawn times have this error of the integral, in a log of 100 Hz under ticks of 2 ms."""
    device, period, size = rigid(), 0.01, 2.0
    time = np.arange(300) * period
    sent = np.where(time > 1.005, size, 0.0)
    commands = Signals(time, {"external_torque": sent}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    segments = cut_log(JointLog("steps", device, Signals(time, {"q": np.sin(time)}, {"q": "rad"}), commands))
    assert len(gap_pulses(segments)) == 0
    drawn = np.random.default_rng(3).uniform(1.0, 1.01, 200_000)
    wanted = size * np.sqrt(np.mean((drawn - 1.005) ** 2))
    for late in (0.0, 0.004):
        moved = lined(segments, late)
        pulses = gap_pulses(moved)[:, :, EXTERNAL]
        there = np.flatnonzero(pulses.any(axis=0))
        assert len(pulses) == 2 and np.count_nonzero(pulses) == len(there)
        assert moved.origin + there / moved.rate - late == pytest.approx(1.0 + 0.002 * np.arange(5))
        assert np.linalg.norm(pulses.sum(axis=1)) / moved.rate == pytest.approx(wanted, rel=0.01)


def test_the_largest_steps_have_pulses_of_their_own():
    device, rng = rigid(), np.random.default_rng(4)
    time = np.arange(300) * 0.01
    sizes = np.zeros(300)
    sizes[160:175] = rng.uniform(0.5, 1.0, 15) * np.array([3.0] + 14 * [0.01])
    sent = np.cumsum(sizes * (-1.0) ** np.arange(300))
    commands = Signals(time, {"external_torque": sent}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    segments = lined(cut_log(JointLog("s", device, Signals(time, {"q": time}, {"q": "rad"}), commands)), 0.0)
    pulses = gap_pulses(segments)
    largest = np.unravel_index(np.abs(pulses).argmax(), pulses.shape)
    here = np.searchsorted(segments.begin, largest[1], side="right") - 1
    same = pulses[largest[0], segments.begin[here] : segments.begin[here] + segments.ticks, EXTERNAL]
    assert len(pulses) == GROUPS and len(np.flatnonzero(same)) in (2, 3)


def late_stamps(jitter: float) -> Segments:
    """A position drive under steps of its goal every .4 s at 100 Hz, whose stamps are off by `jitter` [s]."""
    device, count = positioned(), 1000
    regular = 0.01 * np.arange(count)
    goal = np.repeat(np.random.default_rng(6).uniform(-1.0, 1.0, 25), 40)
    sent = Signals(regular, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    begin = InitialConditions([goal[0], 0.0, 0.0, 0.0, 0.0, 0.0], seed=4)
    plant, sensors = JointPlant.from_device(device), Sensors.of_device(device)
    motion = simulate(plant, sent, regular[-1] + 0.01, 1000.0, sensors, begin).measured
    stamps = regular + jitter * np.random.default_rng(7).normal(size=count)
    measured = Signals(regular, {"q": motion["q"][:: len(motion) // count][:count]}, {"q": "rad"})
    return cut_log(JointLog("late", device, measured, replace(sent, time=stamps)))


def test_a_step_whose_stamp_is_wrong_is_known_to_the_jitter_of_the_stamps():
    segments, jitter = late_stamps(0.0004), 0.0004
    pulses = gap_pulses(segments)
    variance = np.sum((pulses / segments.rate) ** 2)
    steps = np.diff(segments.log.commands["equilibrium"])
    assert variance == pytest.approx(jitter**2 * np.sum(steps**2), rel=0.2)
    assert len(gap_pulses(late_stamps(0.0))) == 0


def test_steps_with_wrong_stamps_leave_no_more_than_noise():
    segments = late_stamps(0.0004)
    known = Rollout.of(segments, np.flatnonzero(segments.valid))
    errors = np.mean(known.residual(segments.nominal[None])[0] ** 2, axis=1)
    assert np.mean(errors) < 2.0


def test_commands_without_a_period_have_right_stamps():
    """Goals sent when somebody pressed a key: the intervals differ, but no stamp is wrong."""
    rng = np.random.default_rng(4)
    regular = 0.4 * np.arange(100)
    keys = np.cumsum(rng.uniform(0.2, 0.6, 100))
    assert stamp_jitter(keys) == 0.0 and stamp_jitter(regular) < 1e-12
    assert stamp_jitter(regular + 0.002 * rng.normal(size=100)) == pytest.approx(0.002, rel=0.25)
    lost = np.delete(regular + 0.002 * rng.normal(size=100), [10, 11, 40])
    assert stamp_jitter(lost) == pytest.approx(0.002, rel=0.25)
