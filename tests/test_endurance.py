"""`via soak`: a short run on the real graph, and evaluations that notice what a long run looks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from via_core.bags.reader import Bag, read_bag
from via_core.bags.writer import BagWriter
from via_interfaces.msg import StiffnessEstimate, VsaCommand
from via_ros.conversions import set_stamp
from via_validation.provenance import Provenance
from via_validation.reliability import endurance, endurance_page
from via_validation.reliability.endurance import COMMANDS, ESTIMATES, MIB, RECORDED, SAMPLES, TRUTH, Run, Usage

COUNT = 400
Keep = Callable[[str, int], bool]


def bag(folder: Path, keep: Keep = lambda *_: True, error: Callable[[int], float] = lambda _: 0.01) -> Bag:
    """A bag of COUNT ticks with the messages that `keep(topic, tick)` lets through; estimates have a relative error."""
    with BagWriter(folder / "bag") as writer:
        for topic, kind in RECORDED.items():
            writer.add_topic(topic, kind)
        for tick in range(COUNT):
            messages = {
                SAMPLES: JointState(),
                COMMANDS: VsaCommand(sequence=tick),
                ESTIMATES: StiffnessEstimate(sequence=tick, value=2.0 * (1.0 + error(tick))),
                TRUTH: StiffnessEstimate(sequence=tick, value=2.0),
            }
            for topic, message in messages.items():
                if keep(topic, tick):
                    set_stamp(message.header.stamp, 10**9 + tick * 10**6)
                    writer.write(topic, serialize_message(message), log_time=10**9 + tick * 10**6)
    return read_bag(folder / "bag")


def usage(growth: float = 0.0, code: int = 0) -> Usage:
    """A process whose memory grows by `growth` [MiB] over the run."""
    time = np.linspace(1.0, 100.0, 100)
    return Usage(time, 100.0 * MIB + growth * MIB * time / 100.0, 0.2, code)


def sound(folder: Path) -> Run:
    return Run(1000.0, 100.0, {"estimator": usage()}, frozenset(), frozenset(), 0.0, bag(folder))


def missed(run: Run) -> set[str]:
    return {row.id.removeprefix("endurance.") for row in endurance.rows(run) if row.ok is False}


def test_a_sound_run_misses_nothing(tmp_path: Path) -> None:
    rows = {row.id: row.ours for row in endurance.rows(sound(tmp_path))}
    assert missed(sound(tmp_path / "again")) == set()
    assert rows["endurance.samples"] == COUNT and rows["endurance.gap"] == pytest.approx(1.0)
    assert rows["endurance.error.last"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("topic", "expected"), [(ESTIMATES, {"lost.estimates", "lost.samples"}), (COMMANDS, {"lost.commands"})]
)
def test_one_lost_message_is_noticed(topic: str, expected: set[str], tmp_path: Path) -> None:
    lossy = bag(tmp_path / "lossy", lambda name, tick: (name, tick) != (topic, 200))
    assert missed(replace(sound(tmp_path), bag=lossy)) == expected


def test_an_error_that_grows_is_noticed(tmp_path: Path) -> None:
    drifting = bag(tmp_path / "drifting", error=lambda tick: 0.01 + 0.01 * tick / COUNT)
    assert missed(replace(sound(tmp_path), bag=drifting)) == {"error.last"}


def test_memory_exit_codes_and_shared_memory_are_noticed(tmp_path: Path) -> None:
    run = sound(tmp_path)
    assert missed(replace(run, usage={"estimator": usage(growth=10.0)})) == {"memory.estimator"}
    assert missed(replace(run, usage={"estimator": usage(growth=6.0)})) == set()  # 3 MiB over the second half
    assert missed(replace(run, usage={"estimator": usage(code=1)})) == {"code.estimator"}
    assert missed(replace(run, left=frozenset({"/dev/shm/fastrtps_x"}))) == {"shm.left"}


def test_the_page_has_every_row_and_names_what_is_missed(tmp_path: Path) -> None:
    run = replace(sound(tmp_path), left=frozenset({"/dev/shm/fastrtps_x"}))
    endurance_page.write(
        run, endurance.rows(run), Provenance("abc", "via soak", "3.11", "2", "0.6"), tmp_path / "page.md"
    )
    text = (tmp_path / "page.md").read_text("utf-8")
    assert "**Missed: files of shared memory left behind.**" in text
    assert "| samples recorded | count | 400 | - | shown |" in text


def test_a_short_run_loses_nothing_and_leaves_nothing(tmp_path: Path, domain: int) -> None:
    """At a rate that a machine under load keeps up with; what depends on its speed is shown without a limit."""
    run = endurance.run(tmp_path, 4.0, 100.0)
    expected = {"lost.bag", "lost.estimates", "lost.commands", "shm.left", "shm.opened"}
    assert {row.id.removeprefix("endurance."): row.ours for row in endurance.rows(run)}.items() >= {
        (name, 0.0) for name in expected
    }
    assert {each.code for each in run.usage.values()} == {0} and len(run.bag[SAMPLES]) > 100
