"""Page and picture of faulty and sound signals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from via_validation.compare.faults import LATE, FaultResult, SoundResult
from via_validation.provenance import Provenance
from via_validation.template import rendered

ALLOWED = 0.05  # [-] share of OK samples after LATE
SOUND, FAULTY = "#1b6ca8", "#c0392b"


def draw(faulty: Sequence[FaultResult], sound: Sequence[SoundResult], path: Path) -> None:
    """One point per interval: the share of its torques that no device near the file explains."""
    devices = list(dict.fromkeys(each.device for each in faulty))
    figure, panels = plt.subplots(1, len(devices), figsize=(3.1 * len(devices) + 1.6, 5.2), sharex=True)
    for axes, device in zip(np.atleast_1d(panels), devices, strict=True):
        rows = [(each.variation, each.unexplained, SOUND) for each in sound if each.device == device]
        rows += [(each.fault, each.unexplained, FAULTY) for each in faulty if each.device == device]
        for at, (_, shares, colour) in enumerate(rows):
            axes.plot(shares, np.full(len(shares), at), "o", color=colour, alpha=0.5, markersize=4)
        axes.axvline(
            next(each.limit for each in faulty if each.device == device), color="black", linestyle="--", linewidth=1
        )
        axes.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=7)
        axes.invert_yaxis()
        axes.set_xlim(-0.03, 1.6)
        axes.set_title(device, fontsize=10)
        axes.set_xlabel("unexplained share", fontsize=9)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


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
    path.write_text(rendered("compare/faults.md", values), encoding="utf-8")


def _share(share: float, good: bool) -> str:
    text = f"{100 * share:.0f} %"
    return text if good else f"**{text}**"
