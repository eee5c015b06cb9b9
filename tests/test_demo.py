"""The demo on a few runs: every part is complete, no message is lost, and its own checks can fail."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from via_bringup.demo import live
from via_bringup.demo.live import same_bits, true_stiffness
from via_bringup.demo.run import MARK, run_demo, write_page
from via_bringup.demo.summary import Quantity, Summary, Traffic
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.status import Status
from via_gap.report.report import read_report

RUNS = ("constant/record/record_traj2_3.csv", "vardamp/record/record_traj3_3.csv")
CORRUPT = ("constant/record/record_traj3_5.csv", "vardamp/record/record_traj2_1.csv")
DURATION = 2.0  # [s] of the live run


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory, root: Path, domain: int) -> tuple[Path, Summary]:
    sample = root / "via_core" / "via_core" / "samples" / "maccepavd"
    folder = tmp_path_factory.mktemp("recordings")
    for name in (*RUNS, *CORRUPT):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(sample / name, folder / name)
    for strategy in ("constant", "vardamp"):
        shutil.copytree(sample / strategy / "command", folder / strategy / "command")
    out = tmp_path_factory.mktemp("out") / "demo"
    parts: list[str] = []
    return out, run_demo(out, folder, DURATION, lambda part, done, of, what: parts.append(part))


def test_summary_file_contains_the_summary(demo):
    out, summary = demo
    written = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    lost = written["live"]["traffic"].pop("lost")
    assert lost == summary.live.traffic.lost
    for run in written["robot"]["runs"]:
        assert {"status", "damping", "nrmse", "traffic"} <= run.keys()
        assert {"value", "standard_deviation", "reference"} == run["damping"].keys()


def test_good_runs_are_estimated_and_corrupt_ones_listed_with_reasons(demo):
    _, summary = demo
    robot = summary.robot
    assert {(run.strategy, run.trajectory, run.repeat) for run in robot.runs} == {("constant", 2, 3), ("vardamp", 3, 3)}
    assert {file.file for file in robot.refused} == set(CORRUPT)
    assert all(file.reasons for file in robot.refused)
    for run in robot.runs:
        assert run.status == "OK"
        assert 0.0 < run.damping.value < 0.06
        assert 0.1 < run.nrmse < 1.0


def test_no_message_is_lost(demo):
    _, summary = demo
    for run in summary.robot.runs:
        assert run.traffic.lost == 0
        assert run.traffic.samples > 300
    assert summary.live.traffic == Traffic(
        samples=2001, samples_recorded=2001, estimates_recorded=2001, numbers_missing=0
    )
    assert summary.live.replay.lost == 0


def test_live_and_replayed_estimates_are_bit_identical(demo):
    _, summary = demo
    assert summary.live.bit_identical


def test_live_estimates_agree_with_the_truth_within_their_standard_deviations(demo):
    """Load delays commands: the joint then moves less, and estimates are less certain, but not further off than that.

    Five standard deviations are beyond what noise does to some thousand dependent estimates; 2.7 were seen.
    """
    out, summary = demo
    device, bag = load_device(summary.live.device), read_bag(out / "bags" / "live")
    estimates, true = bag[f"/{device.name}/stiffness"], true_stiffness(device, bag)
    assert set(estimates["status"]) <= {Status.OK, Status.WARMING_UP, Status.NOT_EXCITED, Status.OUTSIDE_RANGE}
    assert np.all(np.abs(estimates["value"] - true) <= 5.0 * estimates["standard_deviation"])
    assert summary.live.ok == np.mean(estimates["status"] == Status.OK)
    assert (summary.live.stiffness_error is None) == (summary.live.ok == 0.0)


def test_a_run_without_an_estimate_has_no_accuracy_and_a_page_that_states_so(demo, tmp_path):
    _, summary = demo
    nothing = summary.live.model_copy(update={"ok": 0.0, "stiffness_error": None, "stiffness_coverage": None})
    write_page(summary.model_copy(update={"live": nothing}), tmp_path / "index.html")
    assert "No estimate had status OK" in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert live._accuracy(np.zeros(0), np.zeros(0), np.zeros(0)) == (None, None)


def test_a_single_changed_bit_is_detected(demo, tmp_path):
    out, summary = demo
    device, live = load_device(summary.live.device), read_bag(out / "bags" / "live")
    topic = f"/{device.name}/stiffness"
    payloads = list(live.topic(topic).payloads())
    value = live[topic]["value"][700].tobytes()
    at = payloads[700].index(value)
    payloads[700] = payloads[700][:at] + bytes([payloads[700][at] ^ 1]) + payloads[700][at + 1 :]
    with BagWriter(tmp_path / "changed") as writer:
        for name in (topic, f"/{device.name}/motor"):
            writer.add_topic(name, live.topic(name).type_name)
            data = payloads if name == topic else live.topic(name).payloads()
            for stamp, payload in zip(live.topic(name).log_time, data, strict=True):
                writer.write(name, payload, int(stamp))
    assert same_bits(device, live, live)
    assert not same_bits(device, live, read_bag(tmp_path / "changed"))


def test_page_shows_every_picture_run_and_reason(demo):
    out, summary = demo
    page = (out / "index.html").read_text(encoding="utf-8")
    for picture in ("joint", "model", "causes", "repair", "damping", "run", "gap", "nrmse", "live"):
        assert f'src="pictures/{picture}.png"' in page
        assert (out / "pictures" / f"{picture}.png").stat().st_size > 10_000
    for run in summary.robot.runs:
        assert f"{run.strategy} {run.trajectory}.{run.repeat}" in page
    for file in summary.robot.refused:
        assert file.file in page


def test_the_first_screen_answers_four_questions_each_with_one_picture(demo):
    out, _ = demo
    page = (out / "index.html").read_text(encoding="utf-8")
    answers = page[: page.index("<h2>")].split("<section>")[1:]
    assert len(answers) == 4
    for answer in answers:
        assert answer.count("<h3>") == answer.count("<p>") == answer.count("<img ") == 1


def test_diagnosis_is_the_first_link_of_the_page(demo):
    out, summary = demo
    page = (out / "index.html").read_text(encoding="utf-8")
    assert page.index(f'href="{summary.diagnosis.page}"') < page.index("<h2>")
    report = read_report((out / "diagnosis.json").read_text(encoding="utf-8"), "diagnosis.json")
    assert report.verdict == summary.diagnosis.verdict
    assert len(report.logs) == summary.diagnosis.runs == 12
    assert (out / summary.diagnosis.page).stat().st_size > 10_000


def test_every_bag_is_complete(demo):
    out, summary = demo
    bags = [path.parent for path in (out / "bags").rglob("metadata.yaml")]
    assert len(bags) == 2 * len(summary.robot.runs) + 2
    assert all(read_bag(bag).complete for bag in bags)


def test_a_folder_with_other_content_is_not_changed(tmp_path):
    (tmp_path / "thesis.tex").write_text("chapter 1")
    with pytest.raises(ViaError, match="not made by the demo"):
        run_demo(tmp_path, None, DURATION, lambda *_: None)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("out", ["thesis.tex", "thesis.tex/below"])
def test_a_file_in_place_of_the_folder_is_an_error(tmp_path, out):
    (tmp_path / "thesis.tex").write_text("chapter 1")
    with pytest.raises(ViaError, match="choose another folder"):
        run_demo(tmp_path / out, None, DURATION, lambda *_: None)


def test_a_failure_keeps_the_last_results(tmp_path):
    out = tmp_path / "demo"
    out.mkdir()
    (out / MARK).touch()
    (out / "index.html").write_text("the last results")
    with pytest.raises(ViaError, match="no folder"):
        run_demo(out, tmp_path / "nowhere", DURATION, lambda *_: None)
    assert (out / "index.html").read_text() == "the last results"


def test_losses_and_intervals_are_counted():
    traffic = Traffic(samples=100, samples_recorded=99, estimates_recorded=98, numbers_missing=1)
    assert traffic.lost == 4
    assert Quantity(value=1.0, standard_deviation=0.1, reference=1.19).covered
    assert not Quantity(value=1.0, standard_deviation=0.1, reference=1.2).covered
