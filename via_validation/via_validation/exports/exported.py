"""One repair exported: its losses, and the gap after it in MuJoCo beside that of the report.

Where effects are lost, the gap cannot be that of the report. Then the repair is simulated once more without the lost
effects: if both simulators agree on that, the list of losses is complete.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from pydantic import BaseModel, ConfigDict
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.text_files import write_text
from via_export import check, export
from via_gap.residual.errors import Errors
from via_sim.effects import Effect, place_name

from via_validation.exports.sources import Group, Source
from via_validation.gap_real.run import DECIDING, digest_of_sources

ALLOWED = 0.02  # difference of gaps
FORMATS = {"mjcf": ".xml", "urdf": ".urdf", "sdf": ".sdf"}  # that other programs read, and their suffixes
SENSORS = "sensors: steps and noise"  # lost in every format, without influence on the motion


class Sides(BaseModel):
    """Gap before and after the repair, relative to the standard deviation of the measurement."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    before: float
    after: float


class Lost(BaseModel):
    """An effect or an entry of the device file that MJCF has no slot for, as the file says it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    item: str
    place: str  # of an effect; empty for an entry of the device file
    kind: str  # substitute, none
    text: str


class Exported(BaseModel):
    """The export of one repair.

    report     gap after the repair as the report states it
    by         how the report measured it
    via_sim    in the simulator of the diagnosis; `mujoco` in MuJoCo with the exported model
    remaining  gap after the repair without the lost effects, in via_sim and in MuJoCo; None if none is lost
    failure    why it could not be exported or simulated
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    group: Group
    key: str
    seconds: float  # of processor time
    effects: tuple[str, ...]
    report: float
    by: str
    via_sim: Sides | None = None
    mujoco: Sides | None = None
    lost: tuple[Lost, ...] = ()
    remaining: tuple[float, float] | None = None
    failure: str = ""

    @property
    def lost_effects(self) -> tuple[Lost, ...]:
        return tuple(each for each in self.lost if each.place)

    @property
    def lost_entries(self) -> tuple[Lost, ...]:
        """Lost entries of the device file, without steps and noise of sensors."""
        return tuple(each for each in self.lost if not each.place and each.item != SENSORS)

    @property
    def expected(self) -> float:
        """The gap that MuJoCo should have: that of the report, or of via_sim where the report compares equations."""
        assert self.via_sim is not None
        return self.via_sim.after if self.by == "inverse dynamics" else self.report

    @property
    def difference(self) -> float:
        """Gap after the repair in MuJoCo minus the expected one."""
        assert self.mujoco is not None
        return self.mujoco.after - self.expected

    @property
    def unlisted(self) -> float:
        """Difference between both simulators without the lost effects: what the list of losses does not explain."""
        return 0.0 if self.remaining is None else self.remaining[1] - self.remaining[0]

    @property
    def reproduced(self) -> float | None:
        """Share of the decrease of the gap in via_sim that MuJoCo has; None if the repair does not decrease it."""
        assert self.via_sim is not None and self.mujoco is not None
        decrease = self.via_sim.before - self.via_sim.after
        return (self.mujoco.before - self.mujoco.after) / decrease if decrease > 0.1 * self.via_sim.before else None

    @property
    def kept(self) -> bool:
        """Whether MuJoCo has the gap of the report or, where effects are lost, the list of losses explains why not."""
        if self.failure:
            return False
        return abs(self.unlisted if self.lost_effects else self.difference) <= ALLOWED


def exported(source: Source, files: Path) -> Exported:
    """The export of one repair; its models are written into the folder `files`."""
    began, report = time.process_time(), source.report
    assert report.gap is not None
    made = Exported(
        name=source.name, group=source.group, key=key(source), seconds=0.0, report=report.gap.after, by=report.gap.by,
        effects=tuple(f"{each.name} ({place_name(each.site, each.motor)})" for each in report.repair()),
    )  # fmt: skip
    more: dict[str, object]
    try:
        device, logs = source.read()
        logs, effects = report.as_read(logs), report.repaired()
        _write(files, source.name, device, effects)
        lost = _lost(device, effects)
        found = check(logs, device, effects, held_out=report.held_out)
        more = {"lost": lost, "via_sim": _sides(found.via_sim), "mujoco": _sides(found.mujoco)}
        places = {(each.item, each.place) for each in lost}
        rest = [each for each in effects if (each.name, place_name(each.site, each.motor)) not in places]
        if len(rest) < len(effects):
            again = check(logs, device, rest, held_out=report.held_out)
            more["remaining"] = _sides(again.via_sim).after, _sides(again.mujoco).after
    except ViaError as error:
        more = {"failure": str(error)}
    return made.model_copy(update={**more, "seconds": time.process_time() - began})


def _write(files: Path, name: str, device: Device, effects: Sequence[Effect]) -> None:
    files.mkdir(parents=True, exist_ok=True)
    for to in FORMATS:
        write_text(files / f"{name}{FORMATS[to]}", export(device, effects, to).text)


def _lost(device: Device, effects: Sequence[Effect]) -> tuple[Lost, ...]:
    return tuple(
        Lost(item=each.item, place=each.place, kind=each.slot.kind, text=str(each))
        for each in export(device, effects).losses
    )


def _sides(errors: tuple[Errors, Errors]) -> Sides:
    return Sides(before=errors[0].overall, after=errors[1].overall)


def key(source: Source) -> str:
    """Hash of everything that the export of a report depends on."""
    text = f"{source.report.to_json()} {digest_of_sources((*DECIDING, 'via_export'))}"
    return sha256(text.encode()).hexdigest()[:16]


def kept(source: Source, folder: Path) -> Exported | None:
    """The stored export of a report; None if it is missing or out of date."""
    try:
        made = Exported.model_validate_json((folder / f"{source.name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return made if made.key == key(source) else None


def keep(made: Exported, folder: Path) -> None:
    """Store an export. Raises ViaError if the folder is not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = folder / f"{made.name}.json.unfinished"
        unfinished.write_text(made.model_dump_json(indent=1) + "\n", encoding="utf-8")
        unfinished.replace(folder / f"{made.name}.json")
    except OSError as error:
        raise ViaError(f"cannot write into {folder}: {error.strerror}") from None
