"""Every block of README.md and docs/*.md: commands run as written and in order; files and programs are used.

A recording ends after SAMPLES joint states instead of half a minute. EXCEPTED names what does not run here, and why.
Blocks without a language are shell commands; diagrams are blocks of language `text`.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from own_robot import write_arm, write_robot, write_run
from rclpy.node import Node
from via_core.devices import load_device
from via_ros import qos
from via_ros.spin import make_executor, spin_until
from via_sim.effects.files import load_effects

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = 8000  # joint states of a recording that README lets run for half a minute
DEADLINE = 1800.0  # [s] for one command: only what hangs
INTERRUPTED = 130  # exit code of `via` after Ctrl-C
EXCEPTED = {  # start of a command -> why it does not run here
    "make ": "sets up, or runs the tests that contain this one; tests/test_demo.py runs the demo",
    "via action send": "diagnoses again; tests/test_ros_commands.py sends goals",
    "via tables": "a quarter of an hour; via_validation/test/test_tables_*.py",
    "via compare": "some minutes; via_validation/test/test_compare.py",
    "via changes": "some minutes; via_validation/test/test_changes.py",
    "via faults": "some minutes; tests/test_faulty_signals.py, via_validation/test/test_faults.py",
    "via reliability": "a quarter of an hour; tests/test_reliability_faults.py",
    "via bench ": "some minutes; via_validation/test/test_bench_*.py",
    "via gap diagnose out/bags/*": "twelve recordings; tests/test_demo.py diagnoses the same ones",
    "via gap diagnose my_bag --device my_joint.yaml --html": "the next section diagnoses the same bag",
    "via gap diagnose run.csv --arm": "tests/test_gap_arms.py diagnoses arms",
    "via gap fleet": "diagnoses again, or needs a cluster; via_bringup/test/test_gap_fleet_command.py",
}


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, its language ('' for shell), and the line of text before it."""

    page: str
    line: int
    language: str
    lines: tuple[str, ...]
    before: str

    @property
    def commands(self) -> list[str]:
        """The commands without their comments."""
        return [command for line in self.lines if (command := re.sub(r"\s{2,}#.*$", "", line).strip())]


def blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a Markdown page."""
    before, language, start, inside = "", "", 0, None
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        if not line.startswith("```"):
            if inside is not None:
                inside.append(line)
            elif line.strip():
                before = line
        elif inside is None:
            language, start, inside = line[3:].strip(), number, []
        else:
            yield Block(page.stem, start, language, tuple(inside), before)
            inside = None


BLOCKS = [block for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) for block in blocks(page)]
SHELL = [block for block in BLOCKS if block.language == ""]


def of_language(language: str) -> Any:
    """Parametrises a test by the blocks of a language."""
    chosen = [block for block in BLOCKS if block.language == language]
    return pytest.mark.parametrize("block", chosen, ids=lambda block: f"{block.page}{block.line}")


@dataclass
class Shell:
    """Commands in one folder, with jobs in the background; `node` observes the ROS graph."""

    folder: Path
    node: Node
    executor: Any
    jobs: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def run(self, command: str) -> None:
        """Run to the end; fails unless the command succeeds."""
        done = subprocess.run(
            ["bash", "-c", command], cwd=self.folder, capture_output=True, text=True, timeout=DEADLINE, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"

    def start(self, command: str) -> subprocess.Popen[bytes]:
        """Start a node and wait until ROS sees it."""
        known = len(self._nodes())
        log = (self.folder / f"job_{len(list(self.folder.glob('job_*')))}.txt").open("wb")
        job = subprocess.Popen(
            ["bash", "-c", f"exec {command}"], cwd=self.folder, stdout=log, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        self.jobs.append(job)

        def there() -> bool:
            assert job.poll() is None, f"{command} ended:\n{Path(log.name).read_text()}"
            return len(self._nodes()) > known

        assert spin_until(self.executor, there, DEADLINE), f"{command}: no node"
        return job

    def record(self, command: str) -> None:
        """Record until the diagnostics of the recorder count SAMPLES joint states."""
        counts = [0]

        def take(report: DiagnosticArray) -> None:
            for status in report.status:
                if status.name == "recorder: /joint_states":
                    counts.extend(int(each.value) for each in status.values if each.key == "messages")

        subscription = self.node.create_subscription(DiagnosticArray, "/diagnostics", take, qos.CONTROL)
        recorder = self.start(command)
        assert spin_until(self.executor, lambda: max(counts) >= SAMPLES, DEADLINE), f"{command}: {max(counts)} samples"
        self.stop(recorder)
        self.node.destroy_subscription(subscription)

    def follow_output(self, command: str) -> None:
        """Start a command that prints until it is stopped, and stop it after its first line."""
        job = subprocess.Popen(["bash", "-c", f"exec {command}"], cwd=self.folder, stdout=subprocess.PIPE)
        self.jobs.append(job)
        assert job.stdout is not None and job.stdout.readline(), f"{command} printed nothing"
        job.stdout.close()
        self.stop(job)

    def stop(self, job: subprocess.Popen[bytes], with_signal: signal.Signals = signal.SIGINT) -> None:
        """End a job as Ctrl-C or `kill` does; fails unless it ends cleanly."""
        before = len(self._nodes())
        job.send_signal(with_signal)
        assert job.wait(DEADLINE) in (0, INTERRUPTED), job.args
        self.jobs.remove(job)
        spin_until(self.executor, lambda: len(self._nodes()) < before, 60.0)  # the graph forgets it a moment later

    def _nodes(self) -> list[str]:
        return list(self.node.get_node_names())

    def close(self) -> None:
        """End what is still running."""
        for job in list(self.jobs):
            job.kill()
            job.wait()
        self.jobs.clear()


def excepted(command: str) -> str | None:
    """The reason why a command does not run here; None if it does."""
    return next((reason for start, reason in EXCEPTED.items() if command.startswith(start)), None)


def is_node(command: str) -> bool:
    """Whether a command runs until it is stopped."""
    words = command.split()
    return words[:2] in (["via", "run"], ["via", "launch"]) or (words[:2] == ["via", "sim"] and "--record" not in words)


def prints_until_stopped(command: str) -> bool:
    """Whether a command prints messages until it is stopped."""
    return command.startswith(("via topic echo", "via topic hz", "via watch")) and "--once" not in command


def follow(shell: Shell, commands: list[str]) -> None:
    """Run a block's commands; what it leaves in the background ends with it."""
    jobs = []
    for command in commands:
        if excepted(command):
            continue
        if command.startswith("source "):
            subprocess.run(["bash", "-c", f"{command} && command -v via"], cwd=ROOT, check=True, capture_output=True)
        elif command.startswith("kill "):
            for number in re.findall(r"%(\d+)", command):
                shell.stop(jobs[int(number) - 1], signal.SIGTERM)
        elif command.endswith("&"):
            jobs.append(shell.start(command.removesuffix("&").strip()))
        elif command.startswith("via bag record"):
            shell.record(command)
        elif prints_until_stopped(command):
            shell.follow_output(command)
        elif is_node(command):
            shell.stop(shell.start(command))
        else:
            shell.run(command)
    for job in list(shell.jobs):
        shell.stop(job)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, domain: int) -> Iterator[Shell]:
    """A folder with the files that README lets the reader write, and a bag of the reader's own joint."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "out").mkdir()
    (folder / "via_core").symlink_to(ROOT / "via_core")
    write_robot(folder)  # the reader's own
    write_run(folder / "run.csv")
    write_arm(folder / "arm.parquet")
    for block in BLOCKS:
        if block.language == "yaml" and (name := re.search(r"Save this as `(.+?)`", block.before)):
            (folder / name[1]).write_text("\n".join(block.lines))
        elif block.language == "yaml" and block.lines[0] == "name: my_joint":
            (folder / "my_joint.yaml").write_text("\n".join(block.lines))
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("reader", context=context)
    executor = make_executor(context=context)
    executor.add_node(node)
    shell = Shell(folder, node, executor)
    try:
        yield shell
    finally:
        shell.close()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


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
    text = "\n".join(block.lines)
    if "my_bag" in text or "my_joint" in text:
        request.getfixturevalue("my_bag")
    if "via bag play" in text:  # it publishes once a node listens
        page.start("via run via_estimators estimator --ros-args -p device:=my_joint.yaml")
        # Its kernels may take longer to compile than the player waits.
        assert spin_until(page.executor, lambda: page.node.count_subscribers("/joint_states") > 0, DEADLINE)
    try:
        follow(page, block.commands)
    finally:
        page.close()


@of_language("python")
def test_python_block_runs(block: Block, page: Shell, my_bag: None):
    subprocess.run([sys.executable, "-c", "\n".join(block.lines)], cwd=page.folder, check=True, timeout=DEADLINE)


@of_language("yaml")
def test_yaml_block_is_valid(block: Block, page: Shell, tmp_path: Path):
    content = yaml.safe_load("\n".join(block.lines))
    assert content
    if isinstance(content, list):
        (tmp_path / "effects.yaml").write_text("\n".join(block.lines))
        assert load_effects(tmp_path / "effects.yaml")


def test_every_block_is_a_command_a_file_a_program_or_a_diagram():
    assert {block.language for block in BLOCKS} <= {"", "yaml", "python", "text"}


def test_the_described_joint_loads(page: Shell):
    assert load_device(page.folder / "my_joint.yaml").name == "my_joint"
