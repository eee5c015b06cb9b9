"""Every block of README.md and docs/*.md: commands run as written and in order; files and programs are used.

EXCEPTED names what does not run here, and why. tests/page_blocks.py describes how commands are run.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from re import DOTALL, findall
from typing import Any

import pytest
import yaml
from own_robot import write_arm, write_robot, write_run
from page_blocks import DEADLINE, ROOT, Block, Shell, blocks, follow, run_python, shell_in
from via_core.devices import load_device
from via_gap.run.arm_payload import Payload
from via_ros.spin import spin_until
from via_sim.effects.files import load_effects

EXCEPTED = {  # start of a command -> why it does not run here
    "make ": "sets up, or runs the tests that contain this one; tests/test_demo.py runs the demo",
    "via action send": "diagnoses again; tests/test_ros_commands.py sends goals",
    "via gap diagnose my_bag --device my_joint.yaml --html": "the next section diagnoses the same bag",
    "via gap diagnose run.csv --arm": "tests/test_gap_arms.py diagnoses arms",
    "via gap fleet": "diagnoses again, or needs a cluster; via_bringup/test/test_gap_fleet_command.py",
}


BLOCKS = [block for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) for block in blocks(page)]
SHELL = [block for block in BLOCKS if block.language == ""]


def of_language(language: str) -> Any:
    """Parametrises a test by the blocks of a language."""
    chosen = [block for block in BLOCKS if block.language == language]
    return pytest.mark.parametrize("block", chosen, ids=lambda block: f"{block.page}{block.line}")


def excepted(command: str) -> str | None:
    """The reason why a command does not run here; None if it does."""
    return next((reason for start, reason in EXCEPTED.items() if command.startswith(start)), None)


def test_readme_has_the_figures_of_the_page_of_real_robots():
    """Cases, named, tied, silent, wrong, sizes and recordings that became worse."""
    report = " ".join((ROOT / "docs" / "results" / "gap-real.md").read_text().split())
    readme = " ".join((ROOT / "README.md").read_text().split())
    named, cases = findall(r"\*\*(\d+) of (\d+) known causes named", report)[0]
    tied, wrong = findall(r"(\d+) more rightly tied, (\d+) answers wrong", report)[0]
    missed = int(cases) - int(named) - int(tied) - int(wrong)
    off, sizes = findall(r"(\d+) of (\d+) sizes", report)[0]
    worse, others = findall(r"on (\d+) of (\d+) other recordings", report)[0]
    for stated in (
        f"In {cases} cases from public recordings",
        f"named the cause in {named}, listed it among causes that the recordings do not distinguish in {tied}, "
        f"missed it in {missed}, and was wrong in {wrong}",
        f"{off} of {sizes} sizes were off",
        f"on {worse} of {others} other recordings",
    ):
        assert stated in readme


def test_readme_has_the_figures_of_the_sealed_benchmark():
    """Cases, first causes, confidently wrong answers, and causes outside the catalogue that were recognised."""
    report = (ROOT / "docs" / "results" / "gap.md").read_text()
    readme = " ".join((ROOT / "README.md").read_text().split())

    def share(name: str) -> str:
        (value,) = findall(rf"\n## The numbers\n.*?\n\| {name} \| ([0-9.]+) \|", report, flags=DOTALL)
        return f"{100.0 * float(value):.0f} %"

    cases = findall(r"(\d+) cases, \d+ of \d+ limits kept", report)[0]
    for stated in (
        f"](docs/results/gap.md) of {cases} cases",
        f"the first cause was right in {share('top-1')}",
        f"{share('confidently wrong')} of all answers were wrong",
        f"{share('unknown recognised')} of the causes outside the catalogue",
    ):
        assert stated in readme


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, domain: int) -> Iterator[Shell]:
    """A folder with the files that README lets the reader write, and a bag of the reader's own joint."""
    folder = tmp_path_factory.mktemp("readme")
    write_robot(folder)  # the reader's own
    write_run(folder / "run.csv")
    write_arm(folder / "arm.parquet")
    payload = Payload("elbow", (), 0.5, 0.01, (0.0, 0.0, -0.2), (0.01, 0.01, 0.01), 0.9)  # of an arm's diagnosis
    (folder / "report_payload.json").write_text(json.dumps(asdict(payload)))
    with shell_in(folder, domain) as shell:
        for block in BLOCKS:
            if block.file:
                (folder / block.file).write_text(block.text)
            elif block.language == "yaml" and block.lines[0] == "name: my_joint":
                (folder / "my_joint.yaml").write_text(block.text)
        yield shell


@pytest.fixture(scope="module")
def my_bag(page: Shell) -> None:
    """The bag `my_bag` of `my_joint.yaml`, recorded like those of the first section."""
    joint = "--ros-args -p device:=my_joint.yaml"
    follow(
        page,
        ["via sim my_joint.yaml --mode lockstep &", f"via run via_controllers excitation {joint} &",
         "via bag record my_bag"],
    )  # fmt: skip


def test_the_page_has_blocks_and_every_exception_is_needed():
    commands = [command for block in SHELL for command in block.commands]
    assert len(SHELL) > 10
    assert all(any(command.startswith(start) for command in commands) for start in EXCEPTED)
    assert sum(excepted(command) is None for command in commands) > 25


@of_language("")
def test_shell_block_runs(block: Block, page: Shell, request: pytest.FixtureRequest):
    if "my_bag" in block.text or "my_joint" in block.text:
        request.getfixturevalue("my_bag")
    if "via bag play" in block.text:  # it publishes once a node listens
        page.start("via run via_estimators estimator --ros-args -p device:=my_joint.yaml")
        # Its kernels may take longer to compile than the player waits.
        assert spin_until(page.executor, lambda: page.node.count_subscribers("/joint_states") > 0, DEADLINE)
    try:
        follow(page, block.commands, excepted)
    finally:
        page.close()


@of_language("python")
def test_python_block_runs(block: Block, page: Shell, my_bag: None):
    run_python(page, block.text)


@of_language("yaml")
def test_yaml_block_is_valid(block: Block, page: Shell, tmp_path: Path):
    content = yaml.safe_load(block.text)
    assert content
    if isinstance(content, list):
        (tmp_path / "effects.yaml").write_text(block.text)
        assert load_effects(tmp_path / "effects.yaml")


def test_every_block_is_a_command_a_file_a_program_or_a_diagram():
    assert {block.language for block in BLOCKS} <= {"", "yaml", "python", "text"}


def test_the_described_joint_loads(page: Shell):
    assert load_device(page.folder / "my_joint.yaml").name == "my_joint"
