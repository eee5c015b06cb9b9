"""Where the recordings of the real robot are: given, beside the repo, or the sample that comes with VIA."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path

FOLDER = Path("shared") / "data" / "maccepavd"  # beside the repo, where the whole data set is at hand


@contextmanager
def recordings(given: Path | None = None) -> Iterator[tuple[Path, str]]:
    """The folder to import and what to call it."""
    beside = Path.cwd().parent / FOLDER
    if given is not None:
        yield given, str(given)
    elif beside.is_dir():
        yield beside, f"../{FOLDER}"
    else:
        with as_file(files("via_core") / "samples" / "maccepavd") as sample:
            yield sample, "the sample that comes with VIA"
