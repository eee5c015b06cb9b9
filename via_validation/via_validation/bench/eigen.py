"""The C++ reference with Eigen, compiled if a compiler and Eigen's headers are found."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from via_core.signals import Array

FLAGS = ("-O3", "-march=native", "-std=c++17", "-shared", "-fPIC")
DOUBLES = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
N = 9  # unknowns, fixed when it is compiled


def headers() -> Path | None:
    """Folder with Eigen/Dense: the wheel `cmeel-eigen`, else the system's."""
    wheels = [Path(place) / "cmeel.prefix" / "include" / "eigen3" for place in sys.path if place]
    for folder in (*wheels, Path("/usr/include/eigen3"), Path("/usr/local/include/eigen3")):
        if (folder / "Eigen" / "Dense").is_file():
            return folder
    return None


@dataclass(frozen=True)
class Reference:
    """The compiled functions of eigen_reference.cpp."""

    library: ctypes.CDLL

    def rls(self, rows: Array, y: Array, prior: float) -> Array:
        """w (9,) after rows (N, 9) and y (N,), from P = prior times the unit matrix."""
        result = np.empty(N)
        self.library.rls(rows, y, len(rows), prior, result)
        return result

    def qr_rls(self, rows: Array, y: Array, prior: float, keep: float) -> Array:
        """x (9,) after rows (N, 9) and y (N,), from R = prior times the unit matrix."""
        result = np.empty(N)
        self.library.qr_rls(rows, y, len(rows), prior, keep, result)
        return result

    def ekf(self, steps: Array, start: Array, diagonal: Array, settings: Array) -> Array:
        """x (8,) after steps (N, 5), from x = `start` (8,) and P with that diagonal (8,); settings (5,)."""
        result = np.empty(len(start))
        self.library.ekf(steps, len(steps), start, diagonal, settings, result)
        return result


def build(folder: Path) -> Reference | str:
    """The reference compiled in `folder`, or the reason why it cannot be compiled."""
    words = os.environ.get("CXX", "").split() or ["c++"]
    if shutil.which(words[0]) is None:
        return f"no compiler: {words[0]} not found"
    eigen = headers()
    if eigen is None:
        return "no Eigen headers"
    target = folder / "eigen_reference.so"
    with as_file(files("via_validation.bench") / "eigen_reference.cpp") as source:
        made = subprocess.run(
            [*words, *FLAGS, "-isystem", str(eigen), str(source), "-o", str(target)],
            capture_output=True,
            text=True,
            check=False,
        )
    if made.returncode:
        return f"{words[0]} failed: {(made.stderr.strip().splitlines() or ['without a message'])[0]}"
    library = ctypes.CDLL(str(target))
    for name, numbers in (("rls", 1), ("qr_rls", 2)):
        function = getattr(library, name)
        function.argtypes = [DOUBLES, DOUBLES, ctypes.c_long, *(numbers * (ctypes.c_double,)), DOUBLES]
        function.restype = None
    library.ekf.argtypes = [DOUBLES, ctypes.c_long, *(4 * (DOUBLES,))]
    library.ekf.restype = None
    return Reference(library)
