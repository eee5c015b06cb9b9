"""The documentation site: it builds without warnings, its links resolve, and every block of its guides runs as written.

tests/test_readme.py runs the blocks of the other pages. `python tests/test_docs.py` runs the guides, or
those named, and writes the pictures that they make to docs/guides/images.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml
from page_blocks import DEADLINE, ROOT, Shell, blocks, follow, run_python, shell_in
from via_bringup.cli import COMMANDS
from via_gap.report.report import GapReport
from via_ros.domains import reserved_domain

DOCS = ROOT / "docs"
GUIDES = sorted((DOCS / "guides").glob("*.md"))
PICTURES = re.compile(r"!\[.*?\]\(images/(.+?)\)")


class Page(HTMLParser):
    """Links and anchors of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.links.add(value)
            elif name == "id" and value:
                self.anchors.add(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site") / "docs"
    built = subprocess.run(
        [ROOT / "ros2_ws" / "docs.sh", folder], capture_output=True, text=True, timeout=DEADLINE, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in site.rglob("*.html")}


def test_every_page_is_in_the_site(pages: dict[Path, Page], site: Path):
    sources = {path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")}
    assert len(sources) > 30
    assert sources <= {path.relative_to(site) for path in pages}


def test_every_link_inside_the_site_resolves(pages: dict[Path, Page]):
    broken, checked = [], 0
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            checked += 1
            if not target.is_file():
                broken.append(f"{path.name}: {link}")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                broken.append(f"{path.name}: {link}: no such anchor")
    assert checked > 1000
    assert not broken


def test_no_page_loads_anything_from_elsewhere(pages: dict[Path, Page], site: Path):
    for path in pages:
        assert not re.search(r"<(script|link|img)[^>]*(src|href)=\"https?:", path.read_text(encoding="utf-8")), path


def test_the_search_index_contains_the_guides(site: Path):
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    assert all(f"guides/{guide.stem}" in index for guide in GUIDES)


def test_every_command_and_every_interface_has_a_section(pages: dict[Path, Page], site: Path):
    commands = pages[site / "commands.html"].anchors
    assert not {name for name in COMMANDS if f"command-via-{name.replace(' ', '-')}" not in commands}
    wire = (site / "wire.html").read_text(encoding="utf-8")
    files = [file for kind in ("msg", "srv", "action") for file in (ROOT / "via_interfaces" / kind).iterdir()]
    assert len(files) > 10
    assert not [file.name for file in files if f"via_interfaces/{file.parent.name}/{file.stem}" not in wire]


def test_the_python_reference_describes_the_diagnosis(pages: dict[Path, Page], site: Path):
    assert {"via_gap.api.diagnose", "via_gap.api.frames", "via_core.devices.load_device"} <= pages[
        site / "python.html"
    ].anchors


def test_a_broken_link_fails_the_build(tmp_path: Path):
    (tmp_path / "index.md").write_text("# Page\n\n[nowhere](nowhere.md)\n")
    command = [
        "python",
        "-m",
        "sphinx",
        "-q",
        "-W",
        "-c",
        DOCS,
        "-D",
        "extensions=myst_parser",
        tmp_path,
        tmp_path / "out",
    ]
    built = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE, check=False)
    assert built.returncode != 0
    assert "nowhere.md" in built.stderr


def run_guide(guide: Path, shell: Shell) -> list[Path]:
    """Run all blocks of a guide in order; returns the pictures that it shows, which its blocks must have made."""
    for block in blocks(guide):
        if block.file:
            (shell.folder / block.file).write_text(block.text)
        elif block.language == "":
            follow(shell, block.commands)
            shell.close()
        elif block.language == "python":
            run_python(shell, block.text)
        elif block.language == "bash":  # for a stock Jazzy, or what installs
            assert re.search(r"\bros2 |ros-jazzy|ROS_SECURITY|apt install|make setup|colcon build|docker ", block.text)
        else:
            assert block.language == "yaml", f"{guide.name}, line {block.line}: neither a file nor a program"
            assert yaml.safe_load(block.text)
    pictures = [shell.folder / name for name in PICTURES.findall(guide.read_text(encoding="utf-8"))]
    assert all(picture.is_file() for picture in pictures)
    return pictures


def test_a_block_is_a_file_only_if_its_own_paragraph_says_so(tmp_path: Path):
    (tmp_path / "page.md").write_text(
        "Save this as `a.yaml`: two\nlines.\n\n```yaml\na: 1\n```\n\n```\nvia devices\n```\n\n```{toctree}\nb\n```\n"
    )
    first, second = blocks(tmp_path / "page.md")
    assert (first.file, first.language, first.text) == ("a.yaml", "yaml", "a: 1\n")
    assert (second.file, second.commands) == ("", ["via devices"])


@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: guide.stem)
def test_every_block_of_a_guide_runs(guide: Path, tmp_path: Path, domain: int):
    with shell_in(tmp_path, domain) as shell:
        run_guide(guide, shell)
    if guide.stem == "diagnose":
        promised_is_answered(guide.read_text("utf-8"), tmp_path / "out" / "maccepavd.json")
    if guide.stem == "arm":
        payload = json.loads((tmp_path / "report_payload.json").read_text("utf-8"))
        assert payload["link"] == "elbow" and f"{payload['mass']:.2f}" == "0.40"
        lift = GapReport.model_validate_json((tmp_path / "report_lift.json").read_text("utf-8"))
        friction = lift.causes[0].parameters["torque"].value
        assert lift.effects[0].effect == "coulomb_friction" and f"{friction:.1f}" == "0.5"


def promised_is_answered(text: str, answer: Path) -> None:
    """Verdict, named effects and sizes of the gap in a report are those in the text of the guide."""
    report = GapReport.model_validate_json(answer.read_text("utf-8"))
    gap = report.gap
    assert gap is not None and report.effects
    promised = {f"`{report.verdict}`", *(f"`{each.effect}`" for each in report.effects)}
    promised |= {f"{100.0 * value:.0f} %" for value in (gap.before, gap.tuned, gap.after)}
    assert not [each for each in promised if each not in text]


if __name__ == "__main__":
    (DOCS / "guides" / "images").mkdir(exist_ok=True)
    with reserved_domain() as own:
        os.environ["ROS_DOMAIN_ID"] = str(own)
        for page_file in [guide for guide in GUIDES if guide.stem in (sys.argv[1:] or guide.stem)]:
            with tempfile.TemporaryDirectory() as folder, shell_in(Path(folder), own) as reader:
                for made in run_guide(page_file, reader):
                    shutil.copy(made, DOCS / "guides" / "images" / made.name)
