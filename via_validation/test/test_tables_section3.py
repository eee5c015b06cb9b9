"""Section 3's tables with two seeds: printed numbers, limits, and pictures."""

import numpy as np
import pytest
from PIL import Image
from via_validation.tables import section3
from via_validation.tables.cubic_joint import TAU, TORQUE_RATIO, cubic_log
from via_validation.tables.errors import mse
from via_validation.tables.section3_methods import as_printed, differentiated, outcome


@pytest.fixture(scope="module")
def table():
    reports = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(section3, "cubic_rows", lambda seeds: [])  # test_tables_shipped
        rows = section3.rows(2, lambda done, of, what: reports.append((done, of)))
    assert reports[0][0] == 0 and reports[-1][0] == reports[-1][1]
    return {row.id: row for row in rows}, len(rows)


def test_rows_are_unique_complete_and_of_this_section(table):
    by_id, count = table
    assert len(by_id) == count
    for row in by_id.values():
        assert row.id.startswith("3.") and row.what and row.quantity and row.settings
        assert row.ours is not None and np.isfinite(row.ours)


def test_all_lines_of_table_2_have_their_printed_numbers(table):
    by_id, _ = table
    assert by_id["3.table2.n2.clean.e2.mse"].document == 3.4e-2
    assert by_id["3.table2.n2.torque_noise.e1.mse"].document == 19.3
    assert by_id["3.table2.n2.torque_noise.e1.msrep"].document == 4.8e-2
    assert by_id["3.table2.n2.all_noise.e1.mse"].document == 38.4
    assert by_id["3.table2.n4.torque_noise.e2.mse"].document == 39.9
    assert by_id["3.table2.n4.all_noise.e2.msrep"].document == 0.12
    assert by_id["3.table2.n2.all_noise.e1.mse"].remark


def test_rows_without_seeds_keep_their_limits(table):
    by_id, _ = table
    for row in by_id.values():
        assert row.seeds > 0 or row.ok in (True, None), row
    assert by_id["3.table2.n2.clean.e2.mse"].ok is True


def test_printed_sampling_and_zeros_in_motion_are_far_off(table):
    """(26), (27) pair sample k - m with m/H; below (27), what was not measured is zero."""
    by_id, _ = table
    for case in ("e1", "e2"):
        right, printed = (by_id[f"3.printed.{name}.{case}.mse"].ours for name in ("right", "sampling"))
        assert right < 1e-3 and printed > 1000.0
        waiting, filled = (by_id[f"3.printed.{name}.{case}.mse"].ours for name in ("waiting", "zero_filled"))
        assert filled > 50.0 * waiting


def test_table_1_noise_grows_with_the_sampling_period(table):
    """Printed: falls."""
    by_id, _ = table
    assert by_id["3.table1.ts.10ms.mse"].ours > 1.5 * by_id["3.table1.ts.1ms.mse"].ours


def test_w_33_biases_inertia_on_plain_trapezoids_and_not_on_exact_weights(table):
    by_id, _ = table
    bias = {key: abs(by_id[f"3.order.{key}.inertia"].ours - 7.5) for key in ("w33.trapezoid", "w33.ours", "w55.ours")}
    assert bias["w33.trapezoid"] > 0.02 > 0.003 > max(bias["w33.ours"], bias["w55.ours"])


def test_table_2_was_made_with_the_printed_logarithm_of_a_ratio_of_variances():
    """'SNR = 9': by 20 log10 the ratio is 2.82, which gives the printed MSE; by 10 log10, 7.9, far less noise."""
    assert pytest.approx(10.0 ** (9.0 / 20.0), rel=1e-2) == TORQUE_RATIO
    log = cubic_log("E1")
    right, other = (
        outcome(differentiated(2, log), log, 12, log.noise_sd(TAU, 10.0 ** (9.0 / each))).mse for each in (20.0, 10.0)
    )
    assert 0.5 * 19.3 < right < 1.5 * 19.3
    assert other < 0.5 * 19.3


def test_plain_trapezoids_and_the_estimator_agree_on_clean_data():
    log = cubic_log("E2")
    plain = as_printed(log, backwards=False, filled=False)
    ours, _ = differentiated(2, log).run_rows(log.rows)[1].column("stiffness")
    assert mse(plain[log.later], ours[log.later]) < 1e-3


def test_pictures_are_written(tmp_path):
    paths = section3.pictures(tmp_path / "pictures", lambda done, of, what: None)
    assert [path.name for path in paths] == ["figure_3.png", "figure_5.png"]
    for path in paths:
        with Image.open(path) as image:
            assert image.width > 600 and image.height > 400
