"""What begins and ends at times of a run: few segments show it, and they are both fitted and held out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from gap_models import PAYLOAD, evaluated
from via_gap.candidates.fit import Axes
from via_gap.candidates.location import Location, locations
from via_gap.candidates.refinement import TIME_STEPS
from via_gap.candidates.scales import Scales, scales_of
from via_gap.diagnosis import diagnose
from via_gap.residual.recordings import Recordings
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.selection import comparison
from via_gap.selection.experiment import Experiment
from via_gap.selection.holdout import lopsided, one_sided, split, split_finely
from via_sim.effects import Effect

START, STOP = 5.33, 9.57  # in blocks that are held out whole
PUSH = Effect("external_torque", "environment", {"torque": 0.06, "start": START, "stop": STOP})
FRICTION = Effect("coulomb_friction", "link", {"torque": 0.04})
OFFERED = ("coulomb_friction", "viscous_friction", "gravity_error", "external_torque")  # the test is to be short


def test_segments_with_an_event_and_their_neighbours_are_on_both_sides_and_none_is_lost():
    segments = cut_log(log_of(flexible(), (), seed=22))
    (plain,), (held_out,) = split_finely([segments])
    begin = segments.time - segments.log.measured.time[0]
    first, second = int(held_out[3]), int(held_out[7])
    span = segments.ticks / segments.rate
    events = [float(begin[first]) + 0.5 * span, float(begin[second]) + 0.1 * span]
    (train,), (held,) = split_finely([segments], events)
    both = {first - 1, first, first + 1, second - 1, second, second + 1}
    assert set(train) & set(held) == both <= set(np.flatnonzero(segments.valid))
    assert set(train) == set(plain) | both and set(held) == set(held_out) | both
    assert np.array_equal(np.sort(train), train) and np.array_equal(np.sort(held), held)


def test_short_recordings_share_one_pattern_of_fitted_and_held_out_segments():
    """None of them alone has a segment to hold out."""
    short = replace(cut_log(log_of(flexible(), (), seed=22)), valid=np.arange(100) < 2)
    train, held = split_finely([short] * 10)
    assert [len(each) for each in held] == [0, 1, 1, 1, 1] * 2
    assert all(len(a) + len(b) == 2 for a, b in zip(train, held, strict=True))


def test_a_push_beside_friction_is_named_though_all_its_edges_were_held_out(monkeypatch):
    log = log_of(rigid(), (FRICTION, PUSH), seed=33)
    segments = cut_log(log)
    (train,), _, _ = split([segments], [])
    span = segments.ticks / segments.rate
    for event in (START, STOP):
        assert not np.any((segments.time[train] <= event) & (event < segments.time[train] + span))
    monkeypatch.setattr(
        "via_gap.candidates.candidate_set.locations",
        lambda *of: tuple(location for location in locations(*of) if location.name in OFFERED),
    )
    report = diagnose([log], log.device)
    assert report.verdict == "several_effects"
    found = {cause.effect: cause.parameters for cause in report.causes[:2]}
    assert set(found) == {"coulomb_friction", "external_torque"}
    assert found["coulomb_friction"]["torque"].value == pytest.approx(0.04, rel=0.03)
    assert found["external_torque"]["torque"].value == pytest.approx(0.06, rel=0.05)
    assert found["external_torque"]["start"].value == pytest.approx(START, abs=0.005)
    assert found["external_torque"]["stop"].value == pytest.approx(STOP, abs=0.005)


@pytest.mark.parametrize("begin", [3.1, 3.2, 3.3, 3.4])
def test_a_short_push_is_named_wherever_its_segments_were(monkeypatch, begin):
    """Two or three segments hold all of it: fitted alone, held out alone, or one after the other."""
    push = {"torque": 0.3, "start": begin, "stop": begin + 0.4}
    log = log_of(rigid(), (Effect("external_torque", "environment", push),), seed=5, duration=10.0)
    monkeypatch.setattr(
        "via_gap.candidates.candidate_set.locations",
        lambda *of: tuple(location for location in locations(*of) if location.name in OFFERED),
    )
    report = diagnose([log], log.device)
    assert [each.effect for each in report.effects] == ["external_torque"]
    found = report.causes[0].parameters
    assert {name: value.value for name, value in found.items()} == pytest.approx(push, rel=0.01)
    assert report.gap.after < 1.5 * report.gap.floor < 0.1 * report.gap.before


@pytest.fixture(scope="module")
def pushed() -> tuple[ResidualModel, Scales]:
    segments = cut_log(log_of(rigid(), (FRICTION, PUSH), seed=33))
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    scales = scales_of([segments], [None])
    return problem, scales


def test_a_moved_time_changes_the_touched_segments_only(pushed):
    problem, _ = pushed
    earlier = replace(PUSH, parameters={**PUSH.parameters, "start": START - 0.3})
    rows = [problem.row([FRICTION, push]) for push in (PUSH, earlier)]
    change = problem.per_segment(np.diff(problem.residual(rows), axis=0)[0])
    (touched,) = problem.touched(np.array([[START - 0.3], [START]]))
    assert 1 <= len(touched) <= 5
    assert change[touched].max() > 1.0
    assert np.delete(change, touched).max() < 1e-12


def test_times_are_found_as_by_a_search_with_all_segments(pushed):
    problem, scales = pushed
    members = [(Location.of(FRICTION), [0.04]), (Location.of(PUSH), [0.06, START + 0.5, STOP - 0.7])]
    axes = Axes.of(problem, members, scales)
    first = axes.coordinates(np.zeros(axes.count), [value for _, values in members for value in values])
    (begin,) = problem.answer([axes.best([first])])
    (found,) = problem.answer([axes.search_times(begin, TIME_STEPS)])
    slow, along = begin, np.eye(len(begin.at))[axes.count :][axes.times]
    for step in TIME_STEPS:
        for _ in range(3):
            moved = [np.clip(slow.at + side * step * unit, *axes.box) for unit in along for side in (-1, 1)]
            (best,) = problem.answer([axes.best(moved)])
            if best.loss < slow.loss:
                slow = best
    np.testing.assert_allclose(found.at, slow.at, atol=1e-12)
    assert found.loss == pytest.approx(slow.loss, rel=1e-9) and found.loss < begin.loss
    assert found.at[axes.count :][axes.times] * axes.size[axes.times] == pytest.approx([START, STOP], abs=0.1)


def test_errors_on_one_side_show_that_a_motion_repeats_with_the_blocks():
    rng = np.random.default_rng(2)
    fitted, held_out = 1.0 + 0.1 * rng.random(40), 1.0 + 0.1 * rng.random(30)
    assert not lopsided(fitted, held_out)
    wall = fitted.copy()
    wall[[3, 11, 25]] = 500.0
    assert lopsided(wall, held_out) and lopsided(held_out, wall)
    single = fitted.copy()
    single[3] = 500.0  # other blocks cannot share it out
    assert one_sided(single, held_out) and not lopsided(single, held_out)
    shared = held_out.copy()
    shared[[2, 9]] = 500.0
    assert not lopsided(wall, shared)
    assert not lopsided(wall[:1], held_out)


def test_a_model_is_lopsided_by_its_errors_on_all_segments():
    """One that begins too late, because its beginning was held out, may be worse than none on held-out segments."""
    quiet, push = np.full(20, 2.0), np.where(np.arange(20) < 6, 9e4, 2.0)
    tuned = replace(evaluated(push), fitted=push)
    late = replace(evaluated(1.1 * push, PAYLOAD), fitted=quiet)
    useless = replace(evaluated(1.1 * push, PAYLOAD), fitted=1.1 * push)
    harmful = replace(evaluated(quiet, PAYLOAD), fitted=push**2)
    here = SimpleNamespace(train=[np.arange(20)], held=[np.arange(20, 40)], tuned=tuned)
    assert late.score > tuned.score and Experiment.lopsided(here, [useless, late])
    assert not Experiment.lopsided(here, [useless, harmful])
    here.train, here.held = [np.arange(40), np.arange(0)], [np.arange(0), np.arange(40)]  # whole logs
    assert not Experiment.lopsided(here, [late])


def test_whether_there_is_an_event_is_decided_on_all_segments(monkeypatch):
    """Fitted to a part of a push, a model is worse than another one on held-out segments that hold the rest."""
    push = {"torque": 0.3, "start": 3.1, "stop": 3.5}
    log = log_of(rigid(), (Effect("external_torque", "environment", push),), seed=5, duration=10.0)
    experiment = Experiment.of(Recordings.of([log], None, log.device).fitted, ())
    tuned, around, asked = experiment.tuned, Experiment.around, []
    late = Effect("external_torque", "environment", {**push, "start": 3.2})
    drag = Effect("quadratic_drag", "link", {"coefficient": 1e-4})
    event, other = experiment.evaluate([replace(tuned.fit, effects=(each,)) for each in (late, drag)])
    event = replace(event, segments=1.1 * tuned.segments, fitted=np.ones(len(tuned.fitted)))
    other = replace(other, segments=0.9 * tuned.segments, fitted=tuned.fitted)
    assert other.score < event.score and event.on_all.score < other.on_all.score
    monkeypatch.setattr(comparison, "_searched", lambda *_: [event, other])
    monkeypatch.setattr(comparison, "with_interpolation", lambda *_: None)
    monkeypatch.setattr(Experiment, "around", lambda self, times: asked.append(times) or around(self, times))
    comparison.compare_models(experiment, comparison.candidates_of(experiment), lambda *_: None)
    assert asked[-1] == pytest.approx((push["start"], push["stop"]), abs=0.01)
