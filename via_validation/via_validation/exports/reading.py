"""Exported files read by other programs: MuJoCo, pinocchio, urdfdom and libsdformat; every line of complaint counts.

The programs write to the process's own outputs, so each file is read in a child process:

    python -m via_validation.exports.reading FOLDER     # JSON: reader -> file -> lines
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Mapping
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

from via_core.errors import ViaError

SDFORMATS = tuple(f"sdformat{major}" for major in range(17, 11, -1))  # versions for pkg-config, newest first
Lines = Mapping[str, list[str]]  # file -> what its reader complained about


def read_all(folder: Path) -> dict[str, Lines]:
    """What readers complained about, by reader and file; readers that are not installed are missing.

    Raises ViaError if the child process fails.
    """
    with TemporaryDirectory() as there:  # MuJoCo writes a log file into the working folder
        done = subprocess.run(
            [sys.executable, "-m", __name__, str(folder.resolve())],
            capture_output=True,
            text=True,
            cwd=there,
            check=False,
        )
        found = {} if done.returncode else dict(json.loads(done.stdout))
        if done.returncode:
            raise ViaError(f"the files in {folder} could not be read: {done.stderr.strip()[-300:]}")
        if reader := _sdf_reader(Path(there)):
            found["libsdformat (SDF)"] = {
                each.name: _complaints([str(reader), str(each)]) for each in sorted(folder.glob("*.sdf"))
            }
    if checker := shutil.which("check_urdf", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"):
        found["urdfdom (URDF)"] = {
            each.name: _complaints([checker, str(each)]) for each in sorted(folder.glob("*.urdf"))
        }
    return found


def _complaints(words: list[str]) -> list[str]:
    """Lines that a program writes to its error output, and its exit code if it fails."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return lines + ([f"exit code {done.returncode}"] if done.returncode else [])


def _sdf_reader(folder: Path) -> Path | None:
    """A program that reads an SDF file with libsdformat, compiled in `folder`; None without compiler or library."""
    if not shutil.which("c++") or not shutil.which("pkg-config"):
        return None
    for name in SDFORMATS:
        flags = subprocess.run(["pkg-config", "--cflags", "--libs", name], capture_output=True, text=True, check=False)
        if flags.returncode:
            continue
        made = folder / "sdf_reader"
        with as_file(files("via_validation.exports") / "sdf_reader.cpp") as source:
            words = ["c++", "-std=c++17", str(source), "-o", str(made), *flags.stdout.split()]
            if not subprocess.run(words, capture_output=True, check=False).returncode:
                return made
    return None


def _with_mujoco(file: Path) -> None:
    import mujoco

    mujoco.MjModel.from_xml_path(str(file))


def _with_pinocchio(file: Path) -> None:
    import pinocchio

    pinocchio.buildModelFromUrdf(str(file))


def _heard(read: Callable[[Path], None], file: Path) -> list[str]:
    """Lines that reading a file writes to both outputs, warnings of Python, and its error."""
    with TemporaryFile() as both:
        kept = [os.dup(1), os.dup(2)]
        os.dup2(both.fileno(), 1)
        os.dup2(both.fileno(), 2)
        said = []
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                read(file)
            said += [str(each.message) for each in caught]
        except Exception as error:  # of any reader
            said.append(f"{type(error).__name__}: {error}")
        finally:
            sys.stdout.flush()
            for number, old in enumerate(kept, 1):
                os.dup2(old, number)
                os.close(old)
        both.seek(0)
        return said + [line for line in both.read().decode(errors="replace").splitlines() if line.strip()]


def _main(folder: Path) -> None:
    readers = {
        "MuJoCo (MJCF)": (_with_mujoco, "*.xml"),
        "MuJoCo (URDF)": (_with_mujoco, "*.urdf"),
        "pinocchio (URDF)": (_with_pinocchio, "*.urdf"),
    }
    found = {
        name: {each.name: _heard(read, each) for each in sorted(folder.glob(pattern))}
        for name, (read, pattern) in readers.items()
    }
    print(json.dumps(found))


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
