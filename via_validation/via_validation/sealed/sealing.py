"""Case folders, which the diagnosis may read, and sealed keys, which are opened afterwards.

Two folders, neither inside the other:

    CASES/seals.txt             SHA-256 of every key, in the form sha256sum -c reads
    CASES/case_000/bag          the recording; log.csv for a rigid joint; several: bag_00, bag_01 ... or log_00.csv ...
    CASES/case_000/joint.yaml   the nominal device file
    CASES/case_000/README.md    rate, signals and tolerance, as a laboratory would state them
    CASES/case_000/seal.txt     SHA-256 of the key
    KEYS/case_000.json          the key: effect, size, true device, SHA-256 of the withheld log
    KEYS/case_000_withheld      a second recording of the same joint under another motion
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from via_core.errors import ViaError

from via_validation.sealed.case import Case
from via_validation.sealed.joints import as_yaml, device_of
from via_validation.sealed.recording import write_log

SEALS = "seals.txt"
SEAL, BAG, TABLE, DEVICE, README = "seal.txt", "bag", "log", "joint.yaml", "README.md"
_SIGNALS = {
    "full": "link and motor angles{torque}",
    "no_torque": "link and motor angles; motor torques were not measured",
    "link_only": "the link angle{torque}; the motors have no encoders that were recorded",
    "encoder_and_command": "the link angle alone",
}


class SealError(ViaError):
    """A key, a seal or a withheld log differs from what was sealed."""


@dataclass(frozen=True)
class Sealed:
    """An opened key that matches its seal."""

    name: str
    key: dict[str, Any]
    withheld: Path  # bag


def name_of(number: int) -> str:
    return f"case_{number:03d}"


def seal(case: Case, name: str, cases: Path, keys: Path) -> str:
    """Write the folder of a case and its key; returns the key's SHA-256. Raises SealError if one exists already."""
    folder, key_file = cases / name, keys / f"{name}.json"
    if folder.exists() or key_file.exists():
        raise SealError(f"{folder if folder.exists() else key_file} exists already; choose new folders")
    device, positioned = device_of(case.nominal), "servo" in case.nominal
    withheld = keys / f"{name}_withheld{'' if device.motors else '.csv'}"
    write_log(withheld, device, case.withheld, positioned)
    key = {"case": name, **case.key(), "withheld": withheld.name, "withheld_sha256": digest_of(withheld)}
    text = json.dumps(key, indent=1, allow_nan=False) + "\n"
    key_file.write_text(text, encoding="utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    folder.mkdir(parents=True)
    kind, ending = (BAG, "") if device.motors else (TABLE, ".csv")
    for k, log in enumerate(case.logs):
        number = f"_{k:02d}" if len(case.logs) > 1 else ""
        write_log(folder / f"{kind}{number}{ending}", device, log, positioned)
    (folder / DEVICE).write_text(as_yaml(case.nominal), encoding="utf-8")
    (folder / README).write_text(_readme(case), encoding="utf-8")
    (folder / SEAL).write_text(digest + "\n", encoding="utf-8")
    return digest


def write_seals(cases: Path, digests: dict[str, str]) -> None:
    lines = [f"{digest}  {name}.json\n" for name, digest in digests.items()]
    (cases / SEALS).write_text("".join(lines), encoding="utf-8")


def names_in(cases: Path) -> list[str]:
    """Names of the cases in a folder, sorted. Raises SealError if there are none."""
    found = sorted(each.parent.name for each in cases.glob(f"case_*/{SEAL}"))
    if not found:
        raise SealError(f"{cases}: holds no case; `via gap blind make` writes them")
    return found


def opened(name: str, cases: Path, keys: Path) -> Sealed:
    """The key of a case. Raises SealError if key, seals or withheld log were changed after sealing."""
    try:
        text = (keys / f"{name}.json").read_bytes()
        marks = {(cases / name / SEAL).read_text(encoding="utf-8").strip()}
        listed = dict(line.split()[::-1] for line in (cases / SEALS).read_text(encoding="utf-8").splitlines())
    except (OSError, ValueError) as error:
        raise SealError(f"{name}: {getattr(error, 'filename', None) or cases / SEALS} cannot be read") from None
    digest = hashlib.sha256(text).hexdigest()
    if marks | {listed.get(f"{name}.json")} != {digest}:
        raise SealError(f"{name}: its key differs from the sealed one: SHA-256 {digest}")
    key = json.loads(text)
    withheld = keys / key["withheld"]
    if digest_of(withheld) != key["withheld_sha256"]:
        raise SealError(f"{name}: its withheld log differs from the sealed one")
    return Sealed(name, key, withheld)


def logs_in(folder: Path) -> list[Path]:
    """The recordings in the folder of a case, in order."""
    return sorted((*folder.glob(f"{BAG}*"), *folder.glob(f"{TABLE}*.csv")))


def digest_of(log: Path) -> str:
    """SHA-256 over the files of a recording, sorted by name."""
    whole = hashlib.sha256()
    for file in sorted(log.glob("*.mcap")) if log.is_dir() else [log]:
        whole.update(file.read_bytes() if file.exists() else b"")
    return whole.hexdigest()


def _readme(case: Case) -> str:
    device, positioned = device_of(case.nominal), "servo" in case.nominal
    sensors, torque = device.sensors, device.drive == "torque" and bool(device.motors)
    signals = _SIGNALS[case.level].format(torque=" and motor torques" if torque else "; the drives report no torque")
    commands = "motor torques" if torque else "equilibrium, preset and damping"
    if not device.motors:
        signals, commands = "the link angle", "`external_torque`, the torque of the drive at the link"
    if positioned:
        commands = "`equilibrium`, the goal angle of the drive"
    count, ending = len(case.logs), "" if device.motors else ".csv"
    seconds = case.logs[0].time[-1] - case.logs[0].time[0]
    files = f"`{BAG if device.motors else TABLE}{ending}` holds {seconds:.0f} s"
    if count > 1:
        first = BAG if device.motors else TABLE
        files = f"`{first}_00{ending}` to `{first}_{count - 1:02d}{ending}` hold {count} recordings of {seconds:.1f} s"
    lines = [
        "# One joint on a test bench",
        "",
        f"{files} at {sensors.rate:.0f} Hz: {signals}; and the commands ({commands}).",
        f"`{DEVICE}` is the joint as its makers describe it; inertias, frictions and stiffnesses are good to "
        f"{100.0 * case.tolerance:.0f} %.",
        "",
        "A command holds from its stamp to the next.",
    ]
    if torque:
        lines += [
            "The torque of a sample is what the drive commanded over the period that ended at the sample.",
            "The drive follows references with a controller of its own, on its own encoders.",
        ]
    return "\n".join(lines) + "\n"
