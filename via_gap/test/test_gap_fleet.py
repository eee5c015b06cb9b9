"""Many logs: every one has its row, whatever happens to a log, a process or the whole run."""

import json
import os
import signal
from pathlib import Path

import numpy as np
import psutil
import pytest
from distributed import Client
from distributed.security import Security
from gap_logs import flexible, log_of
from via_core.errors import ViaError
from via_gap.diagnosis import diagnose
from via_gap.logs.log import read_log
from via_gap.run import fleet
from via_gap.run.fleet import Row, Workers, key_of, row_of, run_fleet
from via_sim.effects import Effect

DEVICE = flexible()
LINK = Effect("coulomb_friction", "link", {"torque": 0.02})


def write(path: Path, seed: int, effects=(), duration: float = 3.0) -> Path:
    log = log_of(DEVICE, effects, seed=seed, duration=duration)
    torque = np.append(log.commands["motor"], 0.0)
    columns = np.column_stack([log.measured.time, log.measured["q"], log.measured["theta"], torque])
    np.savetxt(path, columns, delimiter=",", header="time,q,theta_1,motor_1", comments="", fmt="%.17g")
    return path


@pytest.fixture
def logs(tmp_path):
    return [write(tmp_path / f"log_{seed}.csv", seed) for seed in (41, 42, 43)]


def children():
    """Processes of workers, that is those that are not there before a run."""
    return {each.pid for each in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(each.cmdline())}


def test_a_killed_worker_loses_nothing_and_bad_logs_are_rows(logs, tmp_path):
    results, heard, addresses, killed = tmp_path / "results", [], set(), []
    broken, empty = tmp_path / "broken.csv", tmp_path / "empty"
    broken.write_text("time,q\n1,x\n")
    empty.mkdir()
    every = [logs[0], broken, logs[1], tmp_path / "none.csv", empty, logs[2], logs[0]]

    def progress(done, of, path):
        heard.append((done, of, None if path is None else path.name))
        if path is not None and not killed:
            listening = [each for each in psutil.Process().net_connections() if each.status == psutil.CONN_LISTEN]
            for pid in (workers := sorted(children())):
                listening += [c for c in psutil.Process(pid).net_connections() if c.status == psutil.CONN_LISTEN]
            addresses.update(each.laddr.ip for each in listening)
            killed.append(workers)
            for pid in workers:
                os.kill(pid, signal.SIGKILL)

    rows = run_fleet(every, DEVICE, results, progress, workers=Workers(count=1))
    assert killed and killed[0] and addresses == {"127.0.0.1"}
    assert [row.log for row in rows] == [str(path) for path in every]
    assert [bool(row.verdict) for row in rows] == [True, False, True, False, False, True, True]
    assert "No such file" in rows[3].reason and rows[1].reason and rows[4].reason
    assert all("\n" not in row.reason for row in rows)
    expected = row_of(diagnose([read_log(logs[1], DEVICE)], DEVICE), "", "")
    assert (rows[2].verdict, rows[2].after, rows[2].floor) == (expected.verdict, expected.after, expected.floor)
    assert heard[0] == (1, 6, None) and [done for done, _, _ in heard] == list(range(1, 7))
    assert not children(), "processes are left"
    assert sorted(each.name for each in (results / "rows").iterdir()) == sorted(
        f"{row.key}.json" for row in (*rows[:3], *rows[4:6])
    )
    # A second run takes what is there; a changed log, a lost report and a row cut short are done again.
    heard.clear()
    again = run_fleet(every, DEVICE, results, progress, workers=Workers(count=1))
    assert again == rows and heard == [(6, 6, None)]
    write(logs[0], 44)
    (results / rows[2].report).unlink()
    row_file = results / "rows" / f"{rows[5].key}.json"
    row_file.write_text(row_file.read_text()[:40])
    third = run_fleet(every, DEVICE, results, progress, workers=Workers(count=1))
    assert heard[1] == (3, 6, None) and {name for _, _, name in heard[2:]} == {path.name for path in logs}
    assert third[0].key != rows[0].key
    assert [row.after for row in third[1:6]] == [row.after for row in rows[1:6]]


def test_an_interrupted_run_keeps_what_was_done_and_leaves_no_process(logs, tmp_path):
    results = tmp_path / "results"

    def progress(_done, _of, path):
        if path is not None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_fleet(logs, DEVICE, results, progress, workers=Workers(count=1))
    assert not children()
    kept = list((results / "rows").iterdir())
    assert len(kept) == 1 and json.loads(kept[0].read_text())["verdict"]
    assert not list(results.rglob(".*")), "a file that was being written is left"


def test_a_row_says_what_a_report_says(tmp_path):
    report = diagnose([log_of(DEVICE, (LINK,), seed=23, duration=6.0)], DEVICE)
    row = row_of(report, "log", "key")
    assert (row.verdict, row.where, row.causes) == ("effect", "link", "coulomb_friction at link")
    assert row.parameters.startswith("torque 0.0") and row.parameters.endswith("N m")
    assert (row.before, row.after, row.explained) == (report.gap.before, report.gap.after, report.gap.explained)
    nothing = {"verdict": "cannot_tell", "where": (), "causes": (), "effects": (), "gap": None}
    blank = row_of(report.model_copy(update=nothing), "log", "key")
    assert blank == Row("log", "key", verdict="cannot_tell")


def test_a_key_is_of_content_name_and_device(logs, tmp_path):
    key = key_of(logs[0], DEVICE)
    (tmp_path / "other").mkdir()
    same = tmp_path / "other" / logs[0].name
    same.write_bytes(logs[0].read_bytes())
    assert key_of(same, DEVICE) == key
    heavier = DEVICE.model_copy(update={"link": DEVICE.link.model_copy(update={"inertia": 0.03})})
    assert len({key, key_of(logs[1], DEVICE), key_of(logs[0], heavier)}) == 3
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "a.mcap").write_bytes(b"1")
    before = key_of(folder, DEVICE)
    (folder / "b.mcap").write_bytes(b"1")
    assert key_of(folder, DEVICE) != before


def test_a_key_is_also_of_own_effects(logs, tmp_path, monkeypatch):
    own = tmp_path / "own.py"
    keys = [key_of(logs[0], DEVICE)]
    monkeypatch.setattr(fleet, "loaded", lambda: (str(own),))
    for text in ("x = 1\n", "x = 2\n"):
        own.write_text(text)
        keys.append(key_of(logs[0], DEVICE))
    assert len(set(keys)) == 3


def test_a_scheduler_that_is_not_there_is_one_line(logs, tmp_path, monkeypatch):
    monkeypatch.setattr("via_gap.run.fleet.PATIENCE", "1s")
    with pytest.raises(ViaError, match=r"scheduler tcp://127[.]0[.]0[.]1:9") as raised:
        run_fleet(logs, DEVICE, tmp_path / "results", workers=Workers("tcp://127.0.0.1:9"))
    assert "\n" not in str(raised.value)


def test_processes_of_a_fleet_obey_only_this_run():
    """Its scheduler and workers take no connection without the keys of the run."""
    with fleet._client(Workers(count=1)) as client:
        addresses = [client.scheduler.address, *client.scheduler_info()["workers"]]
        assert all(address.startswith("tls://127.0.0.1:") for address in addresses)
        for address in addresses:
            for tried in (address, address.replace("tls://", "tcp://")):
                security = Security.temporary() if tried.startswith("tls") else None
                with pytest.raises(OSError, match=r"Timed out|TLS certificate does not match|TCP \(closed\)"):
                    Client(tried, timeout="3s", set_as_default=False, security=security)
        assert client.submit(pow, 2, 3).result() == 8
