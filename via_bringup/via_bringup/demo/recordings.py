"""Location of the real robot's recordings: a given folder, the full data set, or the sample shipped with VIA."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path

FOLDER = Path("shared") / "data" / "maccepavd"  # full data set, in the parent of the current folder


@contextmanager
def recordings(given: Path | None = None) -> Iterator[tuple[Path, str]]:
    """Folder of the recordings and its name for the results. `given` has priority."""
    full = Path.cwd().parent / FOLDER
    if given is not None:
        yield given, str(given)
    elif full.is_dir():
        yield full, f"../{FOLDER}"
    else:
        with as_file(files("via_core") / "samples" / "maccepavd") as sample:
            yield sample, "the sample that comes with VIA"
