"""Page and picture of faulty and sound signals."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import save_figure

from via_validation.compare.faults import LATE, FaultResult, SoundResult
from via_validation.compare.looks import MARKERS
from via_validation.provenance import Provenance
from via_validation.template import write_page

ALLOWED = 0.05  # [-] share of OK samples after LATE
SOUND, FAULTY = "#1b6ca8", "#c0392b"


def draw(faulty: Sequence[FaultResult], sound: Sequence[SoundResult], path: Path) -> None:
    """One point per interval: the share of its torques that no device near the file explains. A panel per limit."""
    devices = {each.device: each.limit for each in faulty}
    marks = dict(zip(devices, itertools.cycle(MARKERS), strict=False))
    shares = [(each.device, each.variation, each.unexplained, SOUND) for each in sound]
    shares += [(each.device, each.fault, each.unexplained, FAULTY) for each in faulty]
    panels = []
    for limit in dict.fromkeys(devices.values()):
        own = [each for each in shares if devices[each[0]] == limit]
        panels.append((limit, own, list(dict.fromkeys(name for _, name, _, _ in own))))
    heights = [len(rows) for *_, rows in panels]
    figure, drawn = plt.subplots(
        len(panels), figsize=(6.6, 0.27 * sum(heights) + 1.2 * len(panels)), height_ratios=heights, sharex=True,
        constrained_layout=True, squeeze=False,
    )  # fmt: skip
    for axes, (limit, own, rows) in zip(drawn[:, 0], panels, strict=True):
        inside = [device for device in devices if devices[device] == limit]
        for device, name, values, colour in own:
            at = rows.index(name) + 0.7 * ((inside.index(device) + 0.5) / len(inside) - 0.5)
            axes.plot(values, np.full(len(values), at), marks[device], color=colour, alpha=0.5, markersize=4)
        axes.axvline(limit, color="black", linestyle="--", linewidth=1)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.grid(axis="y", alpha=0.25)
        handles = [plt.Line2D([], [], color="black", marker=marks[each], linestyle="", label=each) for each in inside]
        axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.3, 1.0), ncols=3, frameon=False, fontsize=9)
    axes.set_xlim(-0.03, 1.6)
    axes.set_xlabel("unexplained share of the torques")
    save_figure(figure, path, dpi=110)


def fault_tables(faulty: Sequence[FaultResult]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Per device its name, the titles and the rows of a table."""
    tables = []
    for device in dict.fromkeys(each.device for each in faulty):
        own = [each for each in faulty if each.device == device]
        titles = ["fault", *(f"`{method}`" for method in own[0].ok), "impossible", "named"]
        rows = [
            [each.fault, *(_share(value, value <= ALLOWED) for value in each.ok.values()),
             f"{100 * each.impossible:.0f} %", f"{100 * each.named:.0f} %"]
            for each in own
        ]  # fmt: skip
        tables.append((device, titles, rows))
    return tables


def sound_tables(sound: Sequence[SoundResult]) -> list[tuple[list[str], list[list[str]]]]:
    """Titles and rows of IMPLAUSIBLE samples by variation and device; one table for devices of equal variations."""
    found = {(each.variation, each.device): each.implausible for each in sound}
    groups: dict[tuple[str, ...], list[str]] = {}
    for device in dict.fromkeys(each.device for each in sound):
        groups.setdefault(tuple(each.variation for each in sound if each.device == device), []).append(device)
    return [
        (
            ["variation", *devices],
            [[name, *(_share(found[name, each], found[name, each] == 0.0) for each in devices)] for name in variations],
        )
        for variations, devices in groups.items()
    ]


def write(
    faulty: Sequence[FaultResult], sound: Sequence[SoundResult], source: Provenance, picture: str, path: Path
) -> None:
    """Write the page; the picture stands beside it."""
    missed = [f"{each.device}, {each.fault}, {m}" for each in faulty for m, share in each.ok.items() if share > ALLOWED]
    values = {
        "tables": fault_tables(faulty),
        "sound": sound_tables(sound),
        "cases": sum(len(each.ok) for each in faulty),
        "missed": missed,
        "impossible": sum(each.impossible for each in sound),
        "intervals": sum(len(each.unexplained) for each in sound),
        "source": source,
        "picture": picture,
        "late": f"{LATE:g}",
        "allowed": f"{100 * ALLOWED:g}",
    }
    write_page(path, "compare/faults.md", values)


def _share(share: float, good: bool) -> str:
    text = f"{100 * share:.0f} %"
    return text if good else f"**{text}**"
