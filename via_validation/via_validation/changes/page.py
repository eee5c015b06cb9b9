"""Page, tables and picture of joints that change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import STYLE, save_figure

from via_validation.changes.experiment import LEVEL
from via_validation.changes.figures import BANDWIDTH, SHORT, Outcome
from via_validation.changes.run import Followed
from via_validation.changes.schedules import (
    AFTER_STEP,
    AMPLITUDE,
    CONSTANT,
    CONVERGED,
    DURATION,
    SINES,
    STEP,
    STEP_SIZE,
    STEP_TIME,
)
from via_validation.compare.figures import WITHIN
from via_validation.compare.looks import LOOKS
from via_validation.compare.page import percent
from via_validation.provenance import Provenance
from via_validation.template import write_page

COVERED = 0.85  # [-] required coverage of the default under every schedule
EXTRA = 0.002  # [-] allowed extra error of the default on constant springs
SUMMARY = ("method", "bias [%]", "random error [%]", "extra error [%]", "fastest sine followed [Hz]",
           "step followed after [s]", "lowest coverage", "OK there [%]", "seeds")  # fmt: skip
Defaults = Mapping[str, str]


def limits_of(found: Sequence[Followed], defaults: Defaults) -> list[tuple[str, bool]]:
    """The limits of the defaults, each with whether it is kept."""
    limits = []
    for each in found:
        if defaults[each.device] != each.method:
            continue
        for name, outcome in each.outcomes.items():
            limits.append((f"{each.device}, {name}: {_covered(outcome)}", outcome.coverage >= COVERED))
        if each.output == "stiffness" and isfinite(each.extra):
            limits.append(
                (f"{each.device}: extra error of {percent(each.extra)} % on constant springs", each.extra <= EXTRA)
            )
    return limits


def _covered(outcome: Outcome) -> str:
    return f"coverage {outcome.coverage:.2f}" if isfinite(outcome.coverage) else "no sample is OK"


def devices_of(found: Sequence[Followed]) -> dict[str, list[Followed]]:
    """The results of each device."""
    return {
        device: [each for each in found if each.device == device] for device in dict.fromkeys(e.device for e in found)
    }


def summary_rows(own: Sequence[Followed], default: str) -> list[list[str]]:
    """One row per method of a device, `SUMMARY` its titles."""
    rows = []
    for each in own:
        constant, (name, coverage) = each.outcomes[CONSTANT.name], each.weakest
        outcomes = each.outcomes.values()
        rows.append([
            _named(each, default),
            percent(constant.bias),
            percent(constant.random),
            percent(each.extra),
            f"{each.fastest:g}" if each.fastest else f"below {SINES[0].frequency:g}",
            f"{step:.2f}" if isfinite(step := each.outcomes[STEP.name].followed) else "never",
            f"{coverage:.2f} ({name})" if isfinite(coverage) else "-",
            f"{100.0 * each.outcomes[name].ok:.0f}" if isfinite(coverage) else "0",
            _seeds(sorted({outcome.seeds for outcome in outcomes})),
        ])  # fmt: skip
    return rows


def case_rows(own: Sequence[Followed], default: str) -> list[list[str]]:
    """One row per method: error and coverage by schedule; misses of the default in bold."""
    rows = []
    for each in own:
        cells = [_cell(outcome, each.method == default) for outcome in each.outcomes.values()]
        rows.append([_named(each, default), *cells])
    return rows


def _cell(outcome: Outcome, limited: bool) -> str:
    coverage = f"{outcome.coverage:.2f}" if isfinite(outcome.coverage) else "-"
    held = f"**{coverage}**" if limited and not outcome.coverage >= COVERED else coverage
    ok = f", OK {100.0 * outcome.ok:.0f} %" if outcome.ok < 0.9 else ""
    return f"{percent(outcome.error)} %; {held}{ok}"


def _named(each: Followed, default: str) -> str:
    return f"{each.method} (default)" if each.method == default else each.method


def _seeds(counts: Sequence[int]) -> str:
    return f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} .. {counts[-1]}"


def draw(found: Sequence[Followed], path: Path) -> None:
    """Per device: what a method misses of a sine over its frequency, its coverage, and its answer to the step."""
    parts = devices_of(found)
    methods = dict.fromkeys(each.method for each in found)
    frequencies = [each.frequency for each in SINES]
    with plt.rc_context({**STYLE, "font.size": 10}):
        figure, panels = plt.subplots(
            len(parts), 3, figsize=(12.5, 2.6 * len(parts) + 1.2), constrained_layout=True, squeeze=False, sharex="col"
        )
        for row, (device, own) in enumerate(parts.items()):
            lost, held, step = panels[row]
            for each in own:
                outcomes = [each.outcomes[sine.name] for sine in SINES]
                look = {**LOOKS[each.method], "linewidth": 1.4}
                lost.plot(frequencies, [min(one.missed, 1.6) for one in outcomes], **look)
                held.plot(frequencies, [one.coverage for one in outcomes], **look)
                step.plot(*each.step, color=look["color"], linewidth=1.4)
            lost.axhline(BANDWIDTH, color="black", linestyle="--", linewidth=1)
            lost.set_ylim(-0.05, 1.65)
            held.axhline(COVERED, color="black", linestyle="--", linewidth=1)
            held.set_ylim(-0.05, 1.05)
            step.plot(
                [-1.0, 0.0, 0.0, 6.0], [1.0, 1.0, STEP_SIZE, STEP_SIZE], color="black", linestyle="--", linewidth=1
            )
            step.set_ylim(0.7, 1.9)
            for axes in (lost, held):
                axes.set_xscale("log")
                axes.set_xticks(frequencies, [f"{each:g}" for each in frequencies])
                axes.minorticks_off()
            lost.set_ylabel(f"{device}\n|1 - H|")
            held.set_ylabel("coverage")
            step.set_ylabel("factor")
        for axes, label in zip(
            panels[-1], ("frequency [Hz]", "frequency [Hz]", "time after the step [s]"), strict=True
        ):
            axes.set_xlabel(label)
        for axes, title in zip(panels[0], ("share of a sine that is missed", "coverage", "step"), strict=True):
            axes.set_title(title, fontsize=11)
        handles = [plt.Line2D([], [], **LOOKS[method]) for method in methods]
        figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=9)
        save_figure(figure, path, dpi=90)


def write(found: Sequence[Followed], defaults: Defaults, source: Provenance, picture: str, path: Path) -> None:
    """Write the page; the picture is beside it."""
    limits = limits_of(found, defaults)
    sines = np.array([each.frequency for each in SINES])
    values = {
        "limits": limits,
        "missed": [words for words, kept in limits if not kept],
        "summary_titles": SUMMARY,
        "tables": [
            (device, own[0].output, summary_rows(own, defaults[device]), ["method", *own[0].outcomes],
             case_rows(own, defaults[device]))
            for device, own in devices_of(found).items()
        ],
        "covered": f"{100.0 * COVERED:g}",
        "extra": f"{100.0 * EXTRA:g}",
        "size": f"{100.0 * AMPLITUDE:g}",
        "sines": ", ".join(f"{each:g}" for each in sines),
        "step": f"{STEP_SIZE:g}",
        "step_time": f"{STEP_TIME:g}",
        "after_step": f"{AFTER_STEP:g}",
        "converged": f"{CONVERGED:g}",
        "duration": f"{DURATION:g}",
        "bandwidth": f"{BANDWIDTH:.2f}",
        "within": f"{100.0 * WITHIN:g}",
        "short": f"{1e3 * SHORT:g}",
        "level": LEVEL,
        "source": source,
        "picture": picture,
    }  # fmt: skip
    write_page(path, "changes/page.md", values)
