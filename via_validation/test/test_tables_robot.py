"""The real robot's tables on the recordings included in VIA."""

import numpy as np
import pytest
from via_validation.tables import robot

STRATEGIES = ("constant", "fixdamp", "optimal", "vardamp")


def silent(done, of, what):
    assert done <= of and what


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("elsewhere"))  # no data set beside it: the sample
        yield robot.robot_runs(robot.estimator_for(robot.load_device(robot.DEVICE)), silent)


def test_corrupt_recordings_are_refused_and_every_strategy_has_good_runs(runs):
    assert runs.source == "the sample that comes with VIA"
    assert runs.refused == 3 and runs.strategies == STRATEGIES
    assert len(runs.runs) == 12 and runs.unexcited == 0
    assert len(runs.of("all")) == sum(len(runs.of(name)) for name in STRATEGIES)


def test_a_run_has_one_estimate_with_a_standard_deviation_and_one_command(runs):
    for run in runs.runs:
        assert 0.0077 <= run.command <= 0.0363  # the published range
        assert run.error == run.value - run.command
        assert run.covered is bool(abs(run.error) <= 1.959964 * run.sd)
        assert 0.0 <= run.samples_outside <= 1.0


def test_rows_have_error_coverage_and_number_of_runs_per_strategy(runs, monkeypatch):
    monkeypatch.setattr(robot, "robot_runs", lambda *_, **__: runs)
    found = {row.id: row for row in robot.rows(1, silent)}
    errors = np.abs([run.error for run in runs.of("fixdamp")])
    assert found["robot.fixdamp.median"].ours == pytest.approx(np.median(errors))
    assert found["robot.fixdamp.mean"].ours == pytest.approx(np.mean(errors))
    assert found["robot.all.runs"].ours == 12.0
    covered = [run.covered for run in runs.runs]
    assert found["robot.all.coverage"].ours == pytest.approx(100.0 * np.mean(covered))
    assert {name.split(".")[1] for name in found} == {*STRATEGIES, "all"}


def test_the_picture_is_drawn(runs, monkeypatch, tmp_path):
    monkeypatch.setattr(robot, "robot_runs", lambda *_, **__: runs)
    (path,) = robot.pictures(tmp_path / "robot", silent)
    assert path.stat().st_size > 10_000
