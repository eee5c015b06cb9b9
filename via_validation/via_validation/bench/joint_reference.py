"""Joints in plain C, compiled if a compiler is found: one joint, one with five effects, many lanes, and the table."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from ctypes import c_double, c_long
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from via_bringup.cli.console import print_table
from via_core.signals import Array
from via_sim.joint.parameters import LINK, MOTOR_1, P
from via_sim.joint.step import N_WEIGHTS, PER_AXIS, weigh

from via_validation.bench.timing import Contender, take_turns

SOURCES = ("joint_reference.c", "friction_reference.c")
FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")
LANES = 16  # of the C code
TURNS = 9
DOUBLES = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")


def build() -> ctypes.CDLL | None:
    """The compiled reference; None without a compiler."""
    words = os.environ.get("CC", "").split() or ["cc"]
    if shutil.which(words[0]) is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "joint_reference.so"
        with as_file(files("via_validation.bench")) as here:
            sources = [str(here / name) for name in SOURCES]
            subprocess.run([*words, *FLAGS, *sources, "-lm", "-o", str(target)], check=True)
        library = ctypes.CDLL(str(target))
    library.joint.argtypes = [DOUBLES, c_long, c_long, DOUBLES, DOUBLES, DOUBLES]
    library.lanes.argtypes = [DOUBLES, c_long, c_long, DOUBLES, DOUBLES, DOUBLES, c_long, DOUBLES]
    library.rubbing.argtypes = [DOUBLES, c_long, c_long, c_long, c_double, DOUBLES, DOUBLES]
    library.joint.restype = library.lanes.restype = library.rubbing.restype = None
    return library


def reference_run(library: ctypes.CDLL, row: Array, motor: Array) -> Callable[[], Array]:
    """Simulation of the joint with parameter row (N_PARAMETERS,) under motor torques (N, 2): angles (N, 3) [rad]."""
    weights, out = np.ascontiguousarray(_weights(row)), np.empty((len(motor), 3))

    def run() -> Array:
        library.joint(motor, len(motor), int(row[P.substeps]), weights, row[P.spring : P.spring + 2], out)
        return out

    return run


def friction_run(library: ctypes.CDLL, row: Array, motor: Array) -> Callable[[], Array]:
    """Simulation of the joint with the effects `simulator.FIVE` under motor torques (N, 2): angles (N, 3) [rad]."""
    first, link = MOTOR_1, LINK
    constants = [
        *row[P.spring : P.spring + 2],
        *(row[slot + first] for slot in (P.ripple_amplitude, P.ripple_order, P.ripple_phase)),
        *(row[slot + link] for slot in (P.quadratic_drag, P.breakaway_friction, P.kinetic_friction)),
        row[P.stribeck_velocity + link],
        row[P.kinetic_friction + first],
        *(row[slot + axis] for slot in (P.inertia, P.viscous_friction) for axis in (link, first)),
    ]
    late, given, out = round(row[P.delay] / row[P.tick]), np.array(constants), np.empty((len(motor), 3))

    def run() -> Array:
        library.rubbing(motor, len(motor), int(row[P.substeps]), late, row[P.tick], given, out)
        return out

    return run


def reference_runs(library: ctypes.CDLL, rows: Array, motor: Array) -> Callable[[], Array]:
    """`reference_run` of many rows (K, N_PARAMETERS), whose springs and substeps are those of the first: (N, 3, K)."""
    each = rows[np.arange(-(-len(rows) // LANES) * LANES) % len(rows)]
    weights, gains = np.stack([_weights(row) for row in each], axis=1), each[:, P.torque_gain + 1 : P.torque_gain + 3].T
    weights, gains = np.ascontiguousarray(weights), np.ascontiguousarray(gains)
    out, row = np.empty((len(motor), 3, len(each))), rows[0]

    def run() -> Array:
        springs = row[P.spring : P.spring + 2]
        library.lanes(motor, len(motor), int(row[P.substeps]), weights, springs, gains, len(each), out)
        return out[:, :, : len(rows)]

    return run


def _weights(row: Array) -> Array:
    weights = np.full(N_WEIGHTS, np.nan)
    weigh(row, row[P.tick] / int(row[P.substeps]), 0.0, weights)
    return weights[: 3 * PER_AXIS]


def beside_c(title: str, reference: Contender, contenders: dict[str, Contender]) -> dict[str, float]:
    """Print and return the speed of contenders relative to the reference: its processor time over theirs."""
    times = take_turns({"C": reference, **contenders}, TURNS)
    speeds = {name: times["C"].over(each) for name, each in times.items()}
    cells = ((name, f"{each.nanoseconds:.1f}", f"{speeds[name]:.2f}") for name, each in times.items())
    print_table(title, ("", "ns per tick", "speed / C"), cells)
    return speeds
