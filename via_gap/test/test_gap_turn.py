"""Gaps that begin or end in a log: when, and only if the motion does not explain it."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import log_of, rigid
from gap_reports import report_of
from via_core.signals import Signals
from via_gap.diagnosis import diagnose
from via_gap.rendering.words import cautions, headline, next_steps
from via_gap.report.report import LogInterval
from via_gap.residual.quantities import quantities
from via_gap.residual.recordings import Recordings
from via_gap.selection.experiment import Experiment
from via_gap.selection.turn import FEWEST, Part, turning_point
from via_sim.effects import Effect

AT, DURATION = 18.0, 30.0  # [s]
COULOMB = Effect("coulomb_friction", "link", {"torque": 0.15})


def levels_of(seed, step=0.0, at=70, swing_up=False, count=120):
    """Levels that follow speed and amplitude, with correlated noise and a step; and the motion."""
    random = np.random.default_rng(seed)
    grows = np.linspace(0.2, 1.0, count) if swing_up else 1.0
    motion = grows * np.abs(random.normal(size=(3, count)) + 1.0)
    noise = np.zeros(count)
    for k in range(1, count):
        noise[k] = 0.5 * noise[k - 1] + random.normal()
    return 2.0 * motion[0] - 0.5 * motion[1] ** 2 + noise + step * (np.arange(count) >= at), motion


def test_a_change_is_seldom_found_where_there_is_none():
    found = [turning_point(*levels_of(seed, swing_up=bool(seed % 2))) for seed in range(200)]
    assert sum(each is not None for each in found) <= 10


@pytest.mark.parametrize("step", [6.0, -6.0])
def test_a_planted_change_is_found_where_it_is(step):
    found = [turning_point(*levels_of(seed, step)) for seed in range(20)]
    assert all(each is not None and abs(each[0] - 70) <= 2 and each[1] == (step > 0.0) for each in found)


def test_the_motion_explains_what_grows_with_it():
    """The same levels without the motion that causes them look like a change."""
    levels, motion = levels_of(1, swing_up=True)
    levels = levels + 8.0 * motion[0]
    assert turning_point(levels, motion) is None
    assert turning_point(levels, np.zeros((1, len(levels)))) is not None


def test_short_or_still_logs_have_no_turning_point():
    levels, motion = levels_of(1, 50.0, at=10, count=2 * FEWEST - 1)
    assert turning_point(levels, motion) is None
    assert turning_point(np.full(100, -20.0), np.ones((4, 100))) is None
    assert turning_point(np.zeros(100), np.ones((4, 100))) is None


def test_quantities_that_are_the_same_count_once():
    """A joint that hardly moves, or whose speed follows its angle; a step without any noise."""
    levels, motion = levels_of(2, 6.0)
    assert turning_point(levels, np.vstack([motion, motion, motion])) == turning_point(levels, motion)
    assert turning_point(np.where(np.arange(100) < 40, 0.0, 1.0), np.ones((1, 100))) == (40, True)


def joined(first, second, at):
    """The first log until `at` [s], then the second; both follow the same motion."""
    measured = []
    for log, late in ((first, False), (second, True)):
        chosen = (log.measured.time - log.measured.time[0] >= at) == late
        parts = {name: log.measured[name][chosen] for name in log.measured.channels}
        measured.append(parts | {"": log.measured.time[chosen]})
    columns = {name: np.concatenate([each[name] for each in measured]) for name in measured[0]}
    time = columns.pop("")
    old = first.measured
    return replace(first, name="joined", measured=Signals(time, columns, old.units, old.held))


@pytest.mark.parametrize("begins", [True, False])
def test_an_effect_that_begins_or_ends_in_a_log_is_named_with_its_time(begins):
    without, with_it = (
        log_of(rigid(), (), seed=5, duration=DURATION),
        log_of(rigid(), (COULOMB,), seed=5, duration=DURATION),
    )
    log, shares = joined(without, with_it, AT) if begins else joined(with_it, without, AT), []
    report = diagnose([log], rigid(), progress=lambda _what, share: shares.append(share))
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert [each.effect for each in report.effects] == ["coulomb_friction"]
    assert report.part is not None and report.part.log == "joined"
    low, high = (report.part.begin, log.duration) if begins else (0.0, report.part.end)
    assert (report.part.begin, report.part.end) == (low, pytest.approx(high))
    assert (low if begins else high) == pytest.approx(AT, abs=0.6)
    (cause,) = (each for each in report.causes if each.effect == "coulomb_friction")
    found = cause.parameters["torque"]
    assert abs(found.value - 0.15) < 2.0 * found.sd
    assert all(each.begin >= low - 0.5 and each.end <= high + 0.5 for each in report.held_out)


def test_an_effect_that_acts_all_the_time_is_not_dated():
    report = diagnose([log_of(rigid(), (COULOMB,), seed=5, duration=DURATION)], rigid())
    assert [each.effect for each in report.effects] == ["coulomb_friction"] and report.part is None


@pytest.mark.parametrize("always", [True, False])
def test_only_the_other_part_can_say_that_an_effect_does_not_act_there(always):
    without, with_it = (log_of(rigid(), effects, seed=5, duration=DURATION) for effects in ((), (COULOMB,)))
    recordings = Recordings.of([with_it if always else joined(without, with_it, AT)], None, rigid())
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    time = quantities(experiment.everywhere().views)["time"]
    part = Part("log", AT, DURATION, experiment, time >= AT)
    assert part.confines(replace(experiment.tuned.fit, effects=(COULOMB,))) != always
    assert np.sum(part.segments.valid) == np.sum(time >= AT)


def test_words_say_from_when_on_or_until_when():
    report = report_of("main_effect")
    late = report.model_copy(update={"part": LogInterval(log="log", begin=19.84, end=40.0)})
    assert (
        headline(late)
        == "Torque ripple at motor 1 explains most of the gap from 19.8 s on: 84 % of the explainable error."
    )
    assert cautions(late)[0].startswith("Before, this effect makes the error larger.")
    assert "Find out what changed at 19.8 s." in next_steps(late)
    early = report.model_copy(update={"part": LogInterval(log="log", begin=0.0, end=12.5)})
    assert " of the gap until 12.5 s: " in headline(early) and cautions(early)[0].startswith("Later, ")
    assert "Find out what changed at 12.5 s." in next_steps(early)
