"""The frame of `via tables`: sections in processes, what they send, what is kept when they fail, and the pages."""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from via_bringup import cli
from via_core.errors import ParameterError
from via_validation.commands import tables as command
from via_validation.provenance import Provenance
from via_validation.tables.page import PICTURE_BYTES, Report, as_json, number, verdict, write_html, write_markdown
from via_validation.tables.rows import Row
from via_validation.tables.run import SECTIONS, Finished, Section, chosen, run_sections

FAKE = Section("9", "A fake", "tables_fake_section")
LOST = Section("10", "Not there", "tables_fake_nowhere")
DEAD = Section("11", "Ends by itself", "tables_fake_dead")
SLOW = Section("12", "Never ends", "tables_fake_slow")


@pytest.fixture(name="report", scope="module")
def _report(tmp_path_factory):
    """What the fake section sends from its process, and what there is of one that does not exist."""
    sent = []
    folder = tmp_path_factory.mktemp("tables")
    finished, interrupted = run_sections((FAKE, LOST), 7, folder, lambda *words: sent.append(words))
    assert not interrupted
    assert ("9", 1, 2, "rows") in sent and ("9", 2, 2, "pictures") in sent
    return Report(finished, 7, Provenance("abc+", "via tables", "3.11", "2", "0.6")), folder


@pytest.fixture(name="module")
def _module(tmp_path, monkeypatch):
    """Write a module that processes of this test can load."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return lambda name, text: (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")


def test_a_section_sends_rows_and_pictures_and_a_missing_one_an_error(report):
    fake, lost = report[0].sections
    assert [row.id for row in fake.rows] == ["9.kept", "9.missed", "9.shown", "9.lost", "9.diverged"]
    assert fake.rows[0].seeds == 7 and fake.trouble == "" and fake.seconds > 0.0
    assert [picture.name for picture in fake.pictures] == ["noise.png"] and fake.pictures[0].exists()
    assert lost.rows == () and "No module named 'tables_fake_nowhere'" in lost.trouble
    assert [row.id for row in report[0].missed] == ["9.missed", "9.diverged"] and report[0].limited == 3


def test_rows_sent_before_a_process_ends_are_kept(module, tmp_path):
    module(
        "tables_fake_dead",
        "import os\nfrom tables_fake_section import rows\ndef pictures(folder, progress):\n    os._exit(3)\n",
    )
    (dead,), interrupted = run_sections((DEAD,), 1, tmp_path, lambda *_: None)
    assert len(dead.rows) == 5 and dead.trouble == "its process ended before the pictures were drawn"
    assert not interrupted


def test_an_interrupt_keeps_what_is_finished(module, tmp_path):
    module("tables_fake_slow", "import threading\ndef rows(seeds, progress):\n    progress(0, 1, 'on')\n"
           "    threading.Event().wait()\n")  # fmt: skip
    sent = set()

    def interrupt() -> None:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline and not {("9", "pictures"), ("12", "on")} <= sent:
            pause.wait(0.01)
        while time.monotonic() < deadline and not (tmp_path / "9" / "noise.png").exists():
            pause.wait(0.01)
        pause.wait(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    pause = threading.Event()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        threading.Thread(target=interrupt, daemon=True).start()
        done, interrupted = run_sections((SLOW, FAKE), 1, tmp_path, lambda name, _a, _b, what: sent.add((name, what)))
    finally:
        signal.signal(signal.SIGINT, before)
    assert interrupted
    assert done[0].trouble == "interrupted" and done[0].rows == ()
    assert len(done[1].rows) == 5


def test_the_folder_of_recordings_goes_to_those_that_take_one(module, tmp_path):
    module("tables_fake_robot", "from tables_fake_section import rows as fake\ndef rows(seeds, progress, data):\n"
           "    return [] if data is None else fake(len(str(data)), progress)\n"
           "def pictures(folder, progress, data):\n    return []\n")  # fmt: skip
    robot = Section("13", "Takes recordings", "tables_fake_robot", recordings=True)
    for data, expected in ((None, 0), (tmp_path, 5)):
        (done,), _ = run_sections((robot,), 1, tmp_path, lambda *_: None, data)
        assert (len(done.rows), done.trouble) == (expected, "")
    assert done.rows[0].seeds == len(str(tmp_path))


def test_sections_by_name():
    assert chosen([]) == SECTIONS
    assert [section.name for section in chosen(["5", "3"])] == ["5", "3"]
    with pytest.raises(ParameterError, match="no section '8'; there are: 3, 4, 5, robot, servo, 6, errors, 7"):
        chosen(["8"])


def test_verdicts_and_numbers():
    assert [verdict(Row("i", "w", "q", None, ours, limit, "s")) for ours, limit in
            [(1.0, 1.0), (1.1, 1.0), (None, 1.0), (1.0, None), (None, None)]] == [
        "ok", "MISSED", "MISSED", "shown", "not reproduced"]  # fmt: skip
    assert [number(value) for value in (None, float("inf"), 0.00012345, 12.0)] == ["-", "-", "0.0001234", "12"]
    assert [number(value) for value in (291_873.0, 1e30, 12_345.6)] == ["291873", "1e+30", "1.235e+04"]


def test_json_holds_every_row_and_no_nan(report):
    text = json.dumps(as_json(report[0].rows), allow_nan=False)
    first, *_, last = json.loads(text)
    assert first == {
        "id": "9.kept", "what": "a | case", "quantity": "MSE [-]", "document": 1.0, "ours": 0.5, "limit": 1.0,
        "settings": "plant A", "seeds": 7, "remark": "", "ok": True,
    }  # fmt: skip
    assert last["ours"] is None and last["ok"] is False


def test_the_markdown_page_has_all_rows_marks_misses_and_brings_small_pictures(report, tmp_path):
    sent = report[0]
    other = Finished(replace(FAKE, page="control"), sent.sections[0].rows[:1])
    sent = replace(sent, sections=(*sent.sections, other))
    write_markdown(sent, tmp_path / "docs")
    page, second = write_markdown(sent, tmp_path / "docs")  # and again over itself
    assert page == tmp_path / "docs" / "estimation.md"
    control = second.read_text(encoding="utf-8")
    assert control.startswith("# Control: ") and "1 rows, 1 of them with a limit, 0 missed." in control
    text = page.read_text(encoding="utf-8")
    for row in report[0].rows:
        assert f"| `{row.id}` |" in text
    assert "a \\| case" in text and text.count("**missed**") == 2
    assert "`9.missed`: it is hard" in text and "2 missed: `9.missed`, `9.diverged`." in text
    assert "**Not complete: rows: ModuleNotFoundError" in text and "commit abc+" in text
    cells = [len(re.findall(r"(?<!\\)\|", line)) for line in text.splitlines() if line.startswith("| `9.")]
    assert cells == [9] * 5
    (picture,) = re.findall(r"!\[.*\]\((.*)\)", text)
    assert picture == "estimation/9_noise.png"
    small = page.parent / picture
    assert small.stat().st_size <= PICTURE_BYTES < report[0].sections[0].pictures[0].stat().st_size


def test_the_html_page_shows_pictures_where_they_lie_and_escapes(report):
    rows = (Row("9.x", "<b>", "q", None, 1.0, 0.5, "s"),)
    sent, folder = report
    write_html(Report((*sent.sections, Finished(FAKE, rows)), 7, sent.provenance), folder / "index.html")
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert '<img src="9/noise.png"' in text and "&lt;b&gt;" in text and "<b>" not in text.replace("<body>", "")


def test_the_command_prints_rows_and_writes_json(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(command, "chosen", lambda names: (FAKE,))
    monkeypatch.chdir(tmp_path)
    words = ["via", "tables", "--seeds", "3", "--out", "out"]
    for more, code in ((["--json", "rows.json", "--write", "docs"], 0), (["--json", "-"], 0)):
        monkeypatch.setattr(sys, "argv", [*words, *more])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code in (code, None)
        printed = capsys.readouterr().out
        if more[-1] == "-":
            assert json.loads(printed)[0]["id"] == "9.kept"
        else:
            assert "5 rows, 3 with a limit, 2 missed: 9.missed, 9.diverged" in printed
    assert len(json.loads(Path("rows.json").read_text(encoding="utf-8"))) == 5
    assert Path("docs/estimation.md").exists() and Path("out/index.html").exists()
