"""The benchmark of estimators: contenders compute the same, turns are fair, what is missing is said."""

from __future__ import annotations

import json
import mmap
import sys

import numpy as np
import pytest
from via_bringup import cli
from via_core.devices import load_device
from via_core.errors import ViaError
from via_estimators.methods import METHODS, method_for, methods_for
from via_validation.bench import eigen, estimators, kalman, kernels
from via_validation.bench.timing import Contender, Times, take_turns
from via_validation.commands import bench as command
from via_validation.tables.rows import Row

ROWS, Y = kernels.log(200, seed=3)


@pytest.fixture(name="reference", scope="module")
def _reference(tmp_path_factory):
    """The C++ reference; the packages of the set-up suffice to build it."""
    built = eigen.build(tmp_path_factory.mktemp("eigen"))
    assert isinstance(built, eigen.Reference), built
    return built


def test_every_contender_of_rls_finds_the_least_squares_solution(reference):
    prior = 1e5
    expected = np.linalg.solve(ROWS.T @ ROWS + np.eye(9) / prior, ROWS.T @ Y)
    for found in (
        kernels.fold_rls(ROWS, Y, prior), kernels.python_rls(ROWS, Y, prior), kernels.numpy_rls(ROWS, Y, prior),
        kernels.padasip_rls(ROWS, Y, prior), reference.rls(ROWS, Y, prior),
    ):  # fmt: skip
        assert np.allclose(found, expected, rtol=1e-6)  # what rounding leaves of P(0) = 1e5


def test_every_contender_of_qr_finds_the_forgetful_least_squares_solution(reference):
    prior, keep = 1e-2, 0.98
    roots = np.sqrt(keep) ** np.arange(len(Y) - 1.0, -1.0, -1.0)
    started = prior * np.sqrt(keep) ** len(Y) * np.eye(9)
    expected = np.linalg.lstsq(np.vstack([started, roots[:, None] * ROWS]), np.append(np.zeros(9), roots * Y))[0]
    for fold in (kernels.fold_qr, kernels.python_qr, kernels.numpy_qr, reference.qr_rls):
        assert np.allclose(fold(ROWS, Y, prior, keep), expected, rtol=1e-9)


def test_every_contender_of_the_kalman_filters_finds_the_same_state(reference):
    rows, given = kalman.log(300), (kalman.START, kalman.DIAGONAL)
    expected = kalman.fold_ekf(rows, *given)
    assert np.abs(expected - kalman.START)[2:].max() > 0.1  # the filter has learned
    for found in (kalman.filterpy_ekf(rows, *given), reference.ekf(rows, *given, kalman.SETTINGS)):
        assert np.allclose(found, expected, rtol=1e-6, atol=1e-7)
    assert np.allclose(kalman.filterpy_ukf(rows, *given), kalman.fold_ukf(rows, *given), rtol=1e-6, atol=1e-7)


@pytest.fixture(name="built")
def _built(monkeypatch, reference):
    """The reference that is there already, for rows that would build it again."""
    monkeypatch.setattr(eigen, "build", lambda folder: reference)


@pytest.mark.usefixtures("built")
def test_kalman_rows_have_times_and_ratios(monkeypatch):
    monkeypatch.setattr(kalman, "LOG", 100)
    monkeypatch.setattr(kalman, "SLOW", 5)
    rows = {row.id: row for row in kalman.kalman_rows(1)}
    ratios = {"kalman.ekf_over_ekf_eigen", "kalman.ukf_over_ukf_filterpy", "kalman.default_over_ekf_eigen"}
    assert {"kalman.ekf", "kalman.ukf", "kalman.default", "kalman.default_live"} | ratios <= set(rows)
    monkeypatch.setattr(kalman, "filterpy_ekf", lambda rows, start, diagonal: np.zeros(8))
    with pytest.raises(ViaError, match="contenders of ekf disagree"):
        kalman.kalman_rows(1)


def test_turns_alternate_and_the_first_round_does_not_count():
    order = []
    times = take_turns({name: Contender(4, lambda name=name: order.append(name)) for name in "ab"}, 3)
    assert order == list("abababab")
    assert [len(each.seconds) for each in times.values()] == [3, 3]


def test_ratios_are_medians_over_turns():
    slow_machine_in_the_middle = Times((1.0, 9.0, 1.0)), Times((2.0, 18.0, 4.0))
    assert slow_machine_in_the_middle[0].over(slow_machine_in_the_middle[1]) == 0.5
    assert slow_machine_in_the_middle[1].nanoseconds == 4e9


def test_without_a_compiler_or_headers_rows_have_the_reason(monkeypatch, tmp_path):
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert eigen.build(tmp_path) == "no compiler: no-such-compiler not found"
    monkeypatch.setattr(kernels, "LOG", 600)
    rows = {row.id: row for row in kernels.kernel_rows(1)}
    assert "kernel.rls.eigen" not in rows
    ratio = rows["kernel.qr.fold_over_eigen"]
    assert (ratio.ours, ratio.ok, ratio.remark) == (None, None, "no compiler: no-such-compiler not found")
    monkeypatch.setenv("CXX", "c++")
    monkeypatch.setattr(eigen, "headers", lambda: None)
    assert eigen.build(tmp_path) == "no Eigen headers"


@pytest.mark.usefixtures("built")
def test_contenders_that_disagree_are_not_timed(monkeypatch):
    monkeypatch.setattr(kernels, "numpy_rls", lambda rows, y, prior: np.zeros(9))
    with pytest.raises(ViaError, match="contenders of rls disagree"):
        kernels.kernel_rows(1)


def test_every_method_has_a_device_and_a_step_to_time(monkeypatch):
    monkeypatch.setattr(estimators, "SAMPLES", 3)
    monkeypatch.setattr(estimators, "FOLDED", 5)
    for method in METHODS:
        assert method in methods_for(estimators.device_for(method))
    rows = estimators.step_rows(1)
    two = [name for name in METHODS if estimators.device_for(name).n_transmissions == 2]
    assert two and load_device(estimators.ONE_TRANSMISSION).n_transmissions == 1
    assert [row.id for row in rows] == [
        f"step.{case}.{how}"
        for case in (*METHODS, *(f"one.{name}" for name in two))
        for how in ("call", "live", "fold")
    ]
    assert all(row.ours is not None and row.ours > 0.0 for row in rows)
    defaults = {name for name in METHODS if method_for(estimators.device_for(name)) == name}
    for row in rows:
        method = row.id.removeprefix("step.").removeprefix("one.").rpartition(".")[0]
        assert row.limit == (10.0 if method in defaults else None)
        assert bool(row.remark) == (method not in defaults)
    assert next(row for row in rows if row.id == "step.residual.fold").remark.endswith(" times modulated_torque")


def test_memory_is_that_of_this_process():
    # Mapped anew: an array might be given memory that the process holds already, freed by tests before this one.
    before = estimators.resident()
    with mmap.mmap(-1, 32_000_000) as held:
        pages = range(0, len(held), mmap.PAGESIZE)
        held[:: mmap.PAGESIZE] = b"1" * len(pages)  # resident only once it is written to
        assert 30e6 < estimators.resident() - before < 40e6
        assert estimators.peak_resident() >= estimators.resident() - 1e6


def test_the_command_prints_and_writes_rows(monkeypatch, capsys, tmp_path):
    rows = [Row("a.b", "what", "time [us]", None, 1.25, 1.0, "s", 0, "why")]
    monkeypatch.setattr(estimators, "estimator_rows", lambda turns, progress: rows)
    for words in (["--json", str(tmp_path / "rows.json")], ["--json", "-"]):
        monkeypatch.setattr(sys, "argv", ["via", "bench", "estimators", *words])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code in (0, None)
        printed = capsys.readouterr().out
        if words[-1] == "-":
            assert json.loads(printed) == json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
        else:
            assert "1.25" in printed and "MISSED" in printed and "why" in printed
    assert command.app.info.no_args_is_help
