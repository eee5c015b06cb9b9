"""The real robot's tables on the recordings that come with VIA."""

import numpy as np
import pytest
from via_validation.tables import robot

STRATEGIES = ("constant", "fixdamp", "optimal", "vardamp")


def silent(done, of, what):
    assert done <= of and what


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("elsewhere"))  # no data set beside it: the sample
        yield robot.judge(robot.estimator_for(robot.load_device(robot.DEVICE)), silent)


def test_corrupt_recordings_are_refused_and_every_strategy_has_good_runs(judged):
    assert judged.source == "the sample that comes with VIA"
    assert judged.refused == 3 and judged.strategies == STRATEGIES
    assert len(judged.runs) == 12 and judged.unexcited == 0
    assert len(judged.of("all")) == sum(len(judged.of(name)) for name in STRATEGIES)


def test_a_run_is_one_number_with_a_deviation_beside_the_command(judged):
    for run in judged.runs:
        assert 0.0077 <= run.command <= 0.0363  # the published range
        assert run.error == run.value - run.command
        assert run.covered is bool(abs(run.error) <= 1.959964 * run.deviation)
        assert 0.0 <= run.samples_outside <= 1.0


def test_rows_say_error_coverage_and_number_of_runs_per_strategy(judged, monkeypatch):
    monkeypatch.setattr(robot, "judge", lambda *_, **__: judged)
    found = {row.id: row for row in robot.rows(1, silent)}
    errors = np.abs([run.error for run in judged.of("fixdamp")])
    assert found["robot.fixdamp.median"].ours == pytest.approx(np.median(errors))
    assert found["robot.fixdamp.mean"].ours == pytest.approx(np.mean(errors))
    assert found["robot.all.runs"].ours == 12.0
    covered = [run.covered for run in judged.runs]
    assert found["robot.all.coverage"].ours == pytest.approx(100.0 * np.mean(covered))
    assert {name.split(".")[1] for name in found} == {*STRATEGIES, "all"}


def test_the_picture_is_drawn(judged, monkeypatch, tmp_path):
    monkeypatch.setattr(robot, "judge", lambda *_, **__: judged)
    (path,) = robot.pictures(tmp_path / "robot", silent)
    assert path.stat().st_size > 10_000
