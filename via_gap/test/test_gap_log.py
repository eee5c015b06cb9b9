"""Logs of several files keep names of their own."""

from via_core.devices import load_device
from via_gap.logs.log import read_logs


def test_files_of_one_name_are_told_by_their_folders(tmp_path):
    paths = [tmp_path / "monday" / "log.csv", tmp_path / "tuesday" / "log.csv", tmp_path / "tuesday" / "other.csv"]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_text("time,q,theta_1\n0.0,0.1,0.2\n0.001,0.1,0.2\n", encoding="utf-8")
    device = load_device("maccepavd")
    names = [log.name for log in read_logs(paths, device)]
    assert names == ["monday/log.csv", "tuesday/log.csv", "other.csv"]
    assert [log.name for log in read_logs(paths[:1], device)] == ["log.csv"]
