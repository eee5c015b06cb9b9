"""Batch simulation of a thousand parameter sets of one joint, compared with a loop of simulate() and MuJoCo's rollout.

The joint is that of `bench.simulator` (antagonistic, tau_e = 5 phi + 10 phi^3, torques with zero-order hold at 1 kHz).
The sets differ in inertia, viscous friction, torque gain and, in some rows, dry friction of a motor. MuJoCo simulates
the same sets without dry friction, one model each, in one call of its rollout: once with its fastest integrator and
step at the accuracy reached here, and once with Euler's method at 1 ms, its cheapest. A loop over lanes in plain C with
the same steps, written for this joint alone, simulates them too. All use one thread. Times are processor times, minimum
over the turns, in which the contenders alternate; beside C the median of ratios.
"""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time
from typing import Any

import numpy as np
from via_bringup.cli.console import answers, print_table
from via_core.signals import Array, Signals
from via_sim.effects import Effect
from via_sim.joint.layout import N_COMMANDS
from via_sim.lockstep.run import run_many
from via_sim.plants import JointPlant
from via_sim.simulate import command_rows, initial_state, simulate

from via_validation.bench import joint_reference
from via_validation.bench.simulator import DEVICE, RATE, THREE, Dth, M, mujoco_joint, rolled, torques
from via_validation.bench.timing import Contender, keep

SETS, LOOPED, ROLLED, TURNS = 1000, 20, 40, 5
TICKS = (100, 1000, 3000)  # of a segment and of whole logs
TARGET = 1e-4  # [rad] accuracy at which MuJoCo is compared


def sets(dry: float) -> list[tuple[Effect, ...]]:
    """Effects of each set; `dry` [N m] scales the dry friction of motor 1."""
    random, found = np.random.default_rng(4), []
    for inertia, gain, viscous, friction in random.uniform(size=(SETS, 4)):
        effects = [
            Effect("link_inertia", "link", {"inertia": 0.01 * inertia}),
            Effect("torque_gain", "motor", {"gain": 0.9 + 0.2 * gain}, 1),
            Effect("viscous_friction", "motor", {"coefficient": 0.1 * viscous}, 2),
        ]
        if dry > 0.0:
            effects.append(Effect("coulomb_friction", "motor", {"torque": dry * (0.5 + friction)}, 1))
        found.append(tuple(effects))
    return found


def in_mujoco(each: list[tuple[Effect, ...]], motor: Array, integrator: str, finer: int) -> Callable[[], Array]:
    """MuJoCo's rollout of the sets, one model each -> angles (K, N, 3)."""
    models = [
        mujoco_joint(
            integrator,
            finer,
            M + inertia.parameters["inertia"],
            gain.parameters["gain"],
            Dth + viscous.parameters["coefficient"],
        )
        for inertia, gain, viscous in each
    ]
    return rolled(models, motor, finer)


def least(work: dict[str, tuple[int, Callable[[], object]]]) -> dict[str, float]:
    """Minimum processor time [s] per set of each contender over the turns, after a first turn that compiles."""
    best = dict.fromkeys(work, np.inf)
    for turn in range(TURNS + 1):
        for name, (count, run) in work.items():
            begin = thread_time()
            run()
            if turn:
                best[name] = min(best[name], (thread_time() - begin) / count)
    return best


def compared(ticks: int, dry: float) -> dict[str, Any]:
    """Times [s] per set of all contenders for `ticks` ticks, and their ratios."""
    plant, each, motor = JointPlant.from_device(DEVICE), sets(dry), torques(ticks)
    time = np.arange(ticks) / RATE
    signals = Signals(time, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))
    commands = command_rows(DEVICE, signals, time)
    rows = np.stack([plant.with_effects(effects).at_rate(RATE) for effects in each])
    states = np.repeat(initial_state(plant, RATE, None, 0)[None], SETS, axis=0)
    out = np.empty((SETS, ticks + 1, 6))

    def batch() -> None:
        run_many(rows, states.copy(), commands, np.zeros(len(rows), dtype=np.int64), out)

    def loop() -> list[Array]:
        return [
            simulate(plant.with_effects(effects), signals, ticks / RATE, RATE).truth["q"] for effects in each[:LOOPED]
        ]

    work: dict[str, tuple[int, Callable[[], object]]] = {"batch": (SETS, batch), "loop": (LOOPED, loop)}
    batch()
    worst = max(float(np.max(np.abs(out[k, :, 0] - q))) for k, q in enumerate(loop()))
    if dry == 0.0:
        work["MuJoCo Euler, 1 ms"] = (ROLLED, in_mujoco(each[:ROLLED], motor, "Euler", 1))
        for integrator, finer in (("implicitfast", 16), ("RK4", 1), ("RK4", 2), ("RK4", 4)):
            run = in_mujoco(each[:ROLLED], motor, integrator, finer)
            if float(np.max(np.abs(run() - out[:ROLLED, 1:, :3]))) < TARGET:
                work[f"MuJoCo {integrator}, {1.0 / finer:g} ms"] = (ROLLED, run)
    times = least(work)
    peers = [name for name in times if name.startswith("MuJoCo") and "Euler" not in name]
    row: dict[str, Any] = {"ticks": ticks, "dry": dry, "seconds": times, "worst": worst}
    row["over_loop"] = times["loop"] / times["batch"]
    if peers:
        fastest = min(peers, key=lambda name: times[name])
        row |= {"peer": fastest, "over_peer": times[fastest] / times["batch"]}
        row["over_euler"] = times["MuJoCo Euler, 1 ms"] / times["batch"]
    return row


def speed_beside_c(ticks: int) -> dict[str, float]:
    """Speed of the batch relative to lanes in C with the same substeps; without a compiler nothing."""
    library, plant, motor = joint_reference.build(), JointPlant.from_device(DEVICE), torques(ticks)
    if library is None:
        return {}
    each, commands = sets(0.0), np.zeros((ticks, N_COMMANDS))
    commands[:, :2] = motor
    states = np.repeat(initial_state(plant, RATE, None, 0)[None], SETS, axis=0)
    begins, out = np.zeros(SETS, dtype=np.int64), np.empty((SETS, ticks + 1, 6))

    def lanes(further: tuple[Effect, ...]) -> Contender:
        rows = np.stack([plant.with_effects((*effects, *further)).at_rate(RATE) for effects in each])
        return Contender(SETS * ticks, lambda: run_many(rows, states.copy(), commands, begins, out))

    rows = np.stack([plant.with_effects(effects).at_rate(RATE) for effects in each])
    return joint_reference.beside_c(
        f"{SETS} lanes beside lanes in plain C without effects, same substeps, one thread",
        Contender(SETS * ticks, joint_reference.reference_runs(library, rows, motor)),
        {"without effects": lanes(()), "dry friction": lanes(THREE[:1]), "three effects": lanes(THREE)},
    )


def main() -> None:
    rows = [compared(ticks, dry) for dry in (0.0, 0.05) for ticks in TICKS]
    columns = (
        *("ticks", "dry friction", "batch [us]", "ns per tick"),
        *("x loop", "x MuJoCo", "x Euler 1 ms", "differs"),
    )
    print_table(f"{SETS} parameter sets of one joint, one thread, per set", columns, map(_cells, rows), names=0)
    peers = sorted({row["peer"] for row in rows if "peer" in row})
    answers.print(f"MuJoCo at {TARGET:g} rad: {', '.join(peers)}")
    keep("batch", {"rows": rows, "speed_over_c": speed_beside_c(1000)})


def _cells(row: dict[str, Any]) -> list[str]:
    seconds, ticks = row["seconds"]["batch"], row["ticks"]
    speeds = (f"{row[name]:.1f}" if name in row else "-" for name in ("over_loop", "over_peer", "over_euler"))
    dry = "yes" if row["dry"] else "no"
    return [str(ticks), dry, f"{1e6 * seconds:.1f}", f"{1e9 * seconds / ticks:.0f}", *speeds, f"{row['worst']:.0e}"]
