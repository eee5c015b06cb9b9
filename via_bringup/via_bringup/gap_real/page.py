"""The page of the two real robots, from its template and the reports."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
from jinja2 import Environment, StrictUndefined
from via_gap.logs.replay import pooled
from via_gap.report.report import GapReport
from via_sim.effects import place_name

from via_bringup.gap_real.pictures import draw_arm, draw_joint
from via_bringup.gap_real.run import ArmJoint, Joint
from via_bringup.provenance import Provenance

PAGE = "gap-real.md"
ADR = "0008-free-runs-judge-themselves.md"
EDGES = (0.0, 0.15, 0.3, 0.5, 0.8, 1.1)  # [s] of runs: standing, setting off, swinging, settling, at rest
SAID = {
    "effect": "One effect explains it",
    "several_effects": "Several effects together explain it",
    "main_effect": "Known effects explain most of it",
    "no_gap": "No gap",
    "unknown": "No effect of the catalogue accounts for it",
    "cannot_tell": "These logs cannot tell",
}


def write(joint: Joint, arm: Sequence[ArmJoint], source: Provenance, folder: Path) -> Path:
    """The page and its pictures in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_joint(joint, folder / "gap-real-maccepavd.png")
    draw_arm(arm, folder / "gap-real-dfki.png")
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.globals.update(verdict=verdict, causes=causes, numbers=numbers)
    template = environment.from_string(files("via_bringup.gap_real").joinpath("page.md").read_text("utf-8"))
    text = template.render(
        joint=joint, arm=arm, source=source, strategies=_strategies(joint), windows=windows(joint), adr=ADR
    )
    (folder / PAGE).write_text(text, encoding="utf-8")
    return folder / PAGE


def verdict(report: GapReport) -> str:
    """One sentence: the answer, what was added to the simulator, and what this log does not tell apart."""
    named = ", ".join(f"{place.effect} ({place.site})" for place in report.effects)
    sentence = f"**{SAID[report.verdict]}**" + (f"; in the repair: {named}." if named else "; nothing is repaired.")
    tied = [place.effect for place in report.equivalence_set]
    others = [place.effect for place in report.equivalence_set if place not in report.effects]
    if len(report.effects) > 1:
        sentence += f" In place of one of them as good: {', '.join(others)}." if others else ""
    elif len(tied) > 1:
        sentence += f" Not told apart: {', '.join(tied)}."
    return sentence


def causes(report: GapReport) -> str:
    """The leading causes as a table."""
    rows = ["| cause | where | probability | squared error left | parameters |", "|---|---|---|---|---|"]
    for cause in report.causes[:6]:
        values = ", ".join(f"{name} {v.value:.3g} +- {v.sd:.1g} {v.unit}" for name, v in cause.parameters.items())
        place = place_name(cause.site, cause.motor)
        rows.append(f"| {cause.effect} | {place} | {cause.probability:.2f} | {100 * cause.left:.3g} % | {values} |")
    return "\n".join(rows) if report.causes else "No cause was tried."


def numbers(report: GapReport) -> str:
    """The device's numbers, filed and fitted, as a table."""
    rows = ["| number | filed | fitted | |", "|---|---|---|---|"]
    for each in report.nuisance:
        end = "at the end of its tolerance" if each.at_bound else ""
        rows.append(f"| {each.name} [{each.unit}] | {each.filed:.4g} | {each.fitted:.4g} | {end} |")
    return "\n".join(rows)


def windows(joint: Joint) -> list[tuple[str, float, float, float]]:
    """(seconds, root mean squared error [rad] before, after, share of the squared error left) of parts of the runs."""
    errors = [
        (before.time - before.time[0], before.simulated - before.measured, after.simulated - after.measured)
        for _, before, after in joint.held
    ]
    time, before, after = (np.concatenate(each) for each in zip(*errors, strict=True))
    rows = []
    for low, high in pairwise((*EDGES, np.inf)):
        inside = (time >= low) & (time < high)
        if inside.any():
            first, second = (float(np.sqrt(np.mean(error[inside] ** 2))) for error in (before, after))
            share = float(np.sum(after[inside] ** 2) / np.sum(after**2))
            label = f"{low:g} to {high:g}" if high < np.inf else f"from {low:g}"
            rows.append((label, first, second, share))
    return rows


def _strategies(joint: Joint) -> list[tuple[str, int, float, float]]:
    """(name, runs, NRMSE before, after) of each damping strategy."""
    names = sorted({name.split("_")[0] for name, _, _ in joint.held})
    rows = []
    for strategy in names:
        runs = [(before, after) for name, before, after in joint.held if name.startswith(strategy)]
        before, after = (pooled([pair[i] for pair in runs]) for i in (0, 1))
        rows.append((strategy, len(runs), before, after))
    return rows
