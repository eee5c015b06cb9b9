"""The joint of `simulator` in plain C, compiled if a compiler is found."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from via_core.signals import Array
from via_sim.joint.parameters import P
from via_sim.joint.step import N_WEIGHTS, PER_AXIS, weigh

FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")
DOUBLES = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")


def build() -> ctypes.CDLL | None:
    """The compiled reference; None without a compiler."""
    words = os.environ.get("CC", "").split() or ["cc"]
    if shutil.which(words[0]) is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "joint_reference.so"
        with as_file(files("via_validation.bench") / "joint_reference.c") as source:
            subprocess.run([*words, *FLAGS, str(source), "-o", str(target)], check=True)
        library = ctypes.CDLL(str(target))
    library.joint.argtypes = [DOUBLES, ctypes.c_long, ctypes.c_long, DOUBLES, DOUBLES, DOUBLES]
    library.joint.restype = None
    return library


def reference_run(library: ctypes.CDLL, row: Array, motor: Array) -> Callable[[], Array]:
    """Simulation of the joint with parameter row (N_PARAMETERS,) under motor torques (N, 2): angles (N, 3) [rad]."""
    substeps, weights = int(row[P.substeps]), np.full(N_WEIGHTS, np.nan)
    weigh(row, row[P.tick] / substeps, 0.0, weights)
    out = np.empty((len(motor), 3))

    def run() -> Array:
        library.joint(motor, len(motor), substeps, weights[: 3 * PER_AXIS].copy(), row[P.spring : P.spring + 2], out)
        return out

    return run
