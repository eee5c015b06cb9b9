"""The page of a report as a browser shows it: every verdict, every figure drawn, nothing from the network."""

import json
import re
import shutil
import subprocess
from html import unescape

import pytest
from gap_reports import HOSTILE, KINDS, report_of
from via_core.errors import ViaError
from via_gap.rendering.page import page, write_page
from via_gap.rendering.words import headline

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PHONE = 390  # [px]
LARGEST = 5_000_000  # bytes
PROBE = """<script>
window.faults = []; window.addEventListener("error", (event) => faults.push(String(event.message)));
document.addEventListener("securitypolicyviolation", (event) => faults.push("blocked " + event.blockedURI));
</script>"""
MEASURE = """<script>
for (const each of document.querySelectorAll("details")) each.open = true;
const svgs = [...document.querySelectorAll("svg")].map((svg) => {
  const box = svg.getBoundingClientRect();
  return {
    kind: svg.getAttribute("class"), width: box.width, height: box.height,
    right: box.right,
    panels: svg.querySelectorAll("g.panel").length,
    labels: [...svg.querySelectorAll("text.label")].map((each) => each.textContent),
    empty: [...svg.querySelectorAll("path")].filter((p) => p.getTotalLength() === 0).length,
    curves: [...svg.querySelectorAll("g.panel path.curve")].map((p) => p.getTotalLength()),
    nan: svg.outerHTML.includes("NaN") || /[ "]nan/.test(svg.outerHTML),
    outside: [...svg.querySelectorAll("text")].filter((t) => {
      const r = t.getBoundingClientRect(); return r.left < box.left - 1 || r.right > box.right + 1;
    }).map((t) => t.textContent),
  };
});
const chart = document.querySelector("svg.chart g.panel path.curve");
let read = "";
if (chart) {
  const box = chart.getBoundingClientRect();
  const at = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true };
  chart.dispatchEvent(new PointerEvent("pointermove", at));
  read = document.getElementById("readout").textContent;
}
const result = { svgs, read, faults, inner: innerWidth, wide: document.documentElement.scrollWidth,
  title: document.title,
  loaded: performance.getEntriesByType("resource").length, verdict: document.getElementById("verdict").textContent };
parent.postMessage(JSON.stringify(result), "*");
</script>"""
FRAME = """<!doctype html><pre id="result"></pre><script>
addEventListener("message", (event) => { document.getElementById("result").textContent = event.data; });
</script><iframe src="page.html" style="width:{width}px;height:900px;border:0"></iframe>"""


def seen(folder, html, width):
    """What a browser of that width makes of a page: the numbers of MEASURE, and what it wrote to its console."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: the page was not looked at in a browser")
    shown = html.replace("<head>", f"<head>{PROBE}", 1).replace("</body>", f"{MEASURE}</body>")
    (folder / "page.html").write_text(shown, encoding="utf-8")
    frame = folder / "frame.html"  # a window may not be as narrow as a phone, a frame may
    frame.write_text(FRAME.replace("{width}", str(width)), encoding="utf-8")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom")
    late = ("--window-size=1300,1000", "--virtual-time-budget=1000", f"--user-data-dir={folder / 'profile'}")
    done = subprocess.run([CHROMIUM, *options, *late, frame.as_uri()], capture_output=True, text=True, timeout=600)
    result = re.search(r'<pre id="result">(.+?)</pre>', done.stdout, re.DOTALL)
    assert result, done.stderr[-2000:]
    return json.loads(unescape(result[1])), [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_on_a_phone(kind, tmp_path):
    report = report_of(kind)
    html = page(report)
    result, console = seen(tmp_path, html, PHONE)
    assert (result["faults"], console, result["loaded"]) == ([], [], 0)
    assert result["inner"] == PHONE and result["wide"] <= PHONE
    assert result["verdict"] == headline(report)
    assert result["title"] != "taken"
    charts = [svg for svg in result["svgs"] if svg["kind"].startswith("chart")]
    assert result["svgs"][0]["kind"] == "joint"
    if report.figures is not None and report.figures.residuals:
        figures = report.figures
        drawn = (figures.residuals, figures.spectra, figures.errors, figures.traces)
        assert len(charts) == sum(map(len, drawn)) + 1
        assert result["read"].count(":") >= 2 and re.search(r"rad|N m", result["read"])
    for svg in result["svgs"]:
        assert svg["width"] > 200 and svg["height"] > 50 and svg["right"] <= PHONE
        assert (svg["empty"], svg["nan"], svg["outside"]) == (0, False, [])
    for svg in charts:
        if "ladder" not in svg["kind"]:
            assert len(svg["labels"]) == svg["panels"] + 1
            assert len(svg["curves"]) >= 2 * svg["panels"] and min(svg["curves"]) > 20.0
        assert all(re.search(r"\[[^\]]+\]$", label) for label in svg["labels"])


def test_the_page_on_a_desk_is_no_wider_than_its_window(tmp_path):
    result, console = seen(tmp_path, page(report_of("several_effects")), 1200)
    assert (result["faults"], console) == ([], [])
    assert result["wide"] <= 1200


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_stands_alone_and_in_order(kind):
    html = page(report_of(kind))
    assert len(html.encode()) < LARGEST / 10
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:)|url\((?!#)|@import|https?://""", html)
    order = [html.index(f'id="{name}"') for name in ("verdict", "where", "which", "how-far", "next", "data")]
    assert order == sorted(order)


def test_text_from_logs_is_text():
    html = page(report_of("effect"))
    assert HOSTILE not in html and "<script>document" not in html
    assert "&lt;script&gt;document" in html


def test_a_page_that_cannot_be_written_is_one_line(tmp_path):
    with pytest.raises(ViaError, match="cannot write"):
        write_page(report_of("refused"), tmp_path / "nowhere" / "page.html")
