"""Speed of the simulator compared with MuJoCo's rollout and scipy's solve_ivp at equal accuracy, in one run.

The joint is antagonistic and not stiff, tau_e = 5 phi + 10 phi^3; it runs for three seconds at 1 kHz with zero-order
hold. The reference of all errors is this simulator with 64 times finer steps; the finest settings of MuJoCo and scipy
differ from it by 1e-12 rad. MuJoCo simulates the same joint: three hinges, two fixed tendons with polynomial stiffness,
no contacts, no constraints; each of its integrators at steps of 1 ms and below. For each target accuracy the fastest
setting of a contender that reaches it counts. In addition, the stiff cubic joint of the document is compared with a 20
times finer integration and with DOP853, and the kernel with plain C: the same steps and events, for one joint alone.

Prints a table and writes out/bench/simulator.json. Times [s] are the minimum of several runs, one thread each.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numba import njit
from scipy.integrate import solve_ivp
from via_bringup.cli.console import answers, print_table
from via_core.devices import load_device, parse_device
from via_core.signals import Array, Signals
from via_sim.effects import Effect
from via_sim.joint.kernel import run
from via_sim.joint.layout import N_COMMANDS
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL
from via_sim.simulate import initial_state, simulate

from via_validation.bench import joint_reference
from via_validation.bench.timing import Contender, keep

RATE = 1000.0  # [Hz]
TICKS = 3000
TARGETS = (1e-4, 1e-6)  # [rad]
STIFF = 40.0  # size of the torques of excitation E1 of the document, see `torques`
SAME = 1e-9  # [rad] difference of the C reference: order of additions, fused multiplications
M, Dq, B, Dth = 0.02, 0.05, 0.01, 0.3
DEVICE = parse_device(
    f"""
name: bench
title: non-stiff antagonistic joint
source: [made for this comparison]
confidence: assumed
arrangement: antagonistic
link: {{inertia: {M}, viscous_friction: {Dq}}}
motors: [{{inertia: {B}, viscous_friction: {Dth}}}, {{inertia: {B}, viscous_friction: {Dth}}}]
springs:
  - {{law: odd_polynomial, odd_coefficients: [5.0, 10.0], max_deflection: 1.0}}
  - {{law: odd_polynomial, odd_coefficients: [5.0, 10.0], max_deflection: 1.0}}
sensors: {{rate: {RATE}}}
""",
    "bench",
)

THREE = (
    Effect("coulomb_friction", "motor", {"torque": 0.05}, 1),
    Effect("torque_ripple", "motor", {"amplitude": 0.05, "order": 7.0, "phase": 0.3}, 1),
    Effect("quadratic_drag", "link", {"coefficient": 0.02}),
)
FIVE = (
    *THREE,
    Effect("stribeck_friction", "link", {"breakaway": 0.03, "kinetic": 0.02, "velocity": 0.3}),
    Effect("actuator_delay", "command", {"delay": 0.003}),
)


@dataclass(frozen=True)
class Row:
    """One setting of one contender."""

    name: str
    error: float  # [rad] largest over link and motor angles
    seconds: float  # [s] minimum of its runs


def torques(ticks: int, size: float = 2.0) -> Array:
    """Motor torques (ticks, 2) [N m] with a smooth start and amplitudes of half the size."""
    t = np.arange(ticks) / RATE
    ramp = np.where(t < 0.3, 0.5 - 0.5 * np.cos(np.pi * t / 0.3), 1.0)
    shape = np.stack([3.0 + np.sin(2.0 * np.pi * 0.5 * t), -3.0 - np.sin(2.0 * np.pi * 0.8 * t)], axis=1)
    return ramp[:, None] * size / 2.0 * shape


def best(work: Callable[[], Array], repeats: int) -> tuple[Array, float]:
    """Result (N, 3) and minimum time [s] of `repeats` runs, after a first run that compiles."""
    result, least = work(), np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        least = min(least, time.perf_counter() - begin)
    return result, least


def ours(plant: JointPlant, motor: Array, finer: float = 1.0) -> Array:
    """Angles (N, 3) from this simulator with `finer` times its usual number of substeps."""
    return prepared(plant, motor, finer)()


def prepared(plant: JointPlant, motor: Array, finer: float = 1.0) -> Callable[[], Array]:
    """The run of `ours`, for which memory and parameters are there."""
    row, sensors, start = plant.at_rate(RATE), IDEAL.row(), initial_state(plant, RATE, None, 0)
    row[P.substeps] *= finer
    commands = np.zeros((len(motor), N_COMMANDS))
    commands[:, :2] = motor
    measured, truth = np.empty((len(motor) + 1, 9)), np.empty((len(motor) + 1, 16))

    def work() -> Array:
        run(row, sensors, start.copy(), commands, measured, truth)
        return truth[1:, :3]

    return work


def mujoco_joint(integrator: str, finer: int, link: float = M, gain: float = 1.0, second: float = Dth) -> Any:
    """The joint in MuJoCo at steps of 1 ms / `finer`.

    link, gain, second  inertia of the link, torque gain of motor 1 and viscous friction of motor 2
    """

    def body(name: str, inertia: float, friction: float) -> str:
        return (
            f'<body><joint name="{name}" axis="0 0 1" damping="{friction!r}"/>'
            f'<inertial pos="0 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/></body>'
        )

    springs = (
        f'<fixed springlength="0" stiffness="5 0 10"><joint joint="q" coef="1"/><joint joint="{motor}" coef="-1"/>'
        "</fixed>"
        for motor in "ab"
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{1.0 / RATE / finer!r}" gravity="0 0 0" integrator="{integrator}">'
        '<flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{body('q', link, Dq)}{body('a', B, Dth)}{body('b', B, second)}</worldbody>"
        f"<tendon>{''.join(springs)}</tendon>"
        f'<actuator><motor joint="a" gear="{gain!r}"/><motor joint="b"/></actuator></mujoco>'
    )


def rolled(models: Sequence[Any], motor: Array, finer: int) -> Callable[[], Array]:
    """MuJoCo's rollout of K joints in one call, each at steps of 1 ms / `finer` -> angles (K, N, 3)."""
    data = mujoco.MjData(models[0])
    start = np.zeros((len(models), mujoco.mj_stateSize(models[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    control = np.repeat(np.repeat(motor, finer, axis=0)[None], len(models), axis=0)

    def work() -> Array:
        state, _ = rollout.rollout(models, data, start, control)
        return np.asarray(state[:, finer - 1 :: finer, 1:4])

    return work


def mujoco_runs(motor: Array) -> list[tuple[str, Callable[[], Array]]]:
    """Contenders: every integrator of MuJoCo at 1, 1/2, ... 1/16 ms; angles (1, N, 3)."""
    return [
        (f"MuJoCo {integrator}, {1e3 / RATE / finer:g} ms", rolled([mujoco_joint(integrator, finer)], motor, finer))
        for integrator in ("Euler", "implicitfast", "RK4")
        for finer in (1, 2, 4, 8, 16)
    ]


@njit(cache=False)
def slope(t: float, x: Array, motor: Array) -> Array:
    """The same equations for scipy, compiled so that scipy's own cost dominates."""
    k = min(int(t * 1000.0 + 1e-9), len(motor) - 1)
    p1, p2 = x[0] - x[1], x[0] - x[2]
    e1, e2 = 5.0 * p1 + 10.0 * p1**3, 5.0 * p2 + 10.0 * p2**3
    out = np.empty(6)
    out[:3] = x[3:]
    out[3] = (-Dq * x[3] - e1 - e2) / M
    out[4] = (motor[k, 0] + e1 - Dth * x[4]) / B
    out[5] = (motor[k, 1] + e2 - Dth * x[5]) / B
    return out


def scipy_runs(motor: Array) -> list[tuple[str, Callable[[], Array]]]:
    """Contenders: solve_ivp over the whole run (it steps across jumps of the command), and restarted at each jump."""
    time_at = np.arange(1, len(motor) + 1) / RATE

    def whole(method: str, tolerance: float) -> Array:
        span = (0.0, time_at[-1])
        found = solve_ivp(
            slope, span, np.zeros(6), method, time_at, args=(motor,), rtol=tolerance, atol=tolerance, max_step=5e-3
        )
        return np.asarray(found.y[:3].T)

    def pieces(method: str, tolerance: float) -> Array:
        x, out = np.zeros(6), np.empty((len(motor), 3))
        for k in range(len(motor)):
            now = motor[k : k + 1]
            x = solve_ivp(slope, (0.0, 1.0 / RATE), x, method, args=(now,), rtol=tolerance, atol=tolerance).y[:, -1]
            out[k] = x[:3]
        return out

    settings = [(whole, "RK45", 10.0**-n, "one call") for n in (5, 7, 9)]
    settings += [(whole, "DOP853", 10.0**-n, "one call") for n in (5, 7, 9)]
    settings += [(pieces, "RK45", 10.0**-n, "each tick") for n in (3, 5, 7)]
    return [(f"scipy {m}, {how}, rtol {tol:.0e}", partial(f, m, tol)) for f, m, tol, how in settings]


def measured(reference: Array, contenders: list[tuple[str, Callable[[], Array]]], repeats: int) -> list[Row]:
    rows = []
    for name, work in contenders:
        result, seconds = best(work, repeats)
        rows.append(Row(name, float(np.max(np.abs(result - reference))), seconds))
    return rows


def fastest(rows: list[Row], target: float) -> Row | None:
    """The fastest row with an error of at most `target`; None if there is none."""
    good = [row for row in rows if row.error <= target]
    return min(good, key=lambda row: row.seconds) if good else None


def stiff() -> dict[str, float]:
    """Errors [rad] and time [s] of the document's cubic joint under excitation E1 for ten seconds."""
    device = load_device("cubic_aa_vsa")
    plant, motor = JointPlant.from_device(device), torques(10_000, STIFF)
    angles, seconds = best(lambda: ours(plant, motor), 3)
    finer = float(np.max(np.abs(angles - ours(plant, motor, 20.0))))
    x, worst = np.zeros(6), 0.0
    for k in range(2000):  # two seconds by an independent method, restarted at every jump of the command

        def rate(_t: float, x: Array, command: tuple[float, ...] = (*motor[k], 0.0, 0.0)) -> Array:
            return plant.derivative(x, command)

        x = solve_ivp(rate, (0.0, 1.0 / RATE), x, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        worst = max(worst, float(np.max(np.abs(angles[k] - x[:3]))))
    return {"error_20x_finer": finer, "error_dop853_2s": worst, "seconds_per_10s": seconds}


def speed_beside_c(plant: JointPlant, motor: Array) -> dict[str, float]:
    """Speed of the kernel relative to C that simulates the same joint with the same steps; without a compiler nothing.

    Raises AssertionError where the angles of both differ.
    """
    library, speeds = joint_reference.build(), {}
    if library is None:
        return {}
    cubic, alone = JointPlant.from_device(load_device("cubic_aa_vsa")), joint_reference.reference_run
    for name, each, given, reference in (
        ("without effects", plant, motor, alone),
        ("stiff cubic joint", cubic, torques(len(motor), STIFF), alone),
        ("five effects", plant.with_effects(FIVE), motor, joint_reference.friction_run),
    ):
        run = reference(library, each.at_rate(RATE), given)
        assert np.max(np.abs(run() - ours(each, given))) < SAME, name
        contenders = {"via_sim": Contender(len(given), prepared(each, given))}
        title = f"One joint, {name}, beside plain C: same substeps, one thread"
        speeds[name] = joint_reference.beside_c(title, Contender(len(given), run), contenders)["via_sim"]
    return speeds


def main() -> None:
    plant, motor = JointPlant.from_device(DEVICE), torques(TICKS)
    reference = ours(plant, motor, 64.0)
    commands = Signals(np.arange(TICKS) / RATE, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))

    def whole_call() -> Array:
        truth = simulate(plant, commands, TICKS / RATE, RATE).truth
        return np.column_stack([truth["q"], truth["theta"]])[1:]

    rows = {
        "via_sim": measured(
            reference,
            [("via_sim simulate()", whole_call)]
            + [(f"via_sim kernel, 1/{n:g} ms", partial(ours, plant, motor, n)) for n in (1.0, 2.0, 4.0)],
            20,
        ),
        "MuJoCo": measured(reference, mujoco_runs(motor), 3),
        "scipy": measured(reference, scipy_runs(motor), 1),
    }
    every = [row for group in rows.values() for row in group]
    cells = (
        (row.name, f"{row.error:.1e}", f"{row.seconds * 1e3:.2f}", f"{row.seconds / TICKS * 1e6:.3g}") for row in every
    )
    columns = ("setting", "largest error [rad]", "time [ms]", "us per tick")
    print_table(f"Antagonistic joint, {TICKS} ticks of 1 ms", columns, cells)

    summary: dict[str, object] = {"ticks": TICKS, "rows": [vars(row) for row in every]}
    for target in TARGETS:
        own = fastest(rows["via_sim"][:1], target)
        for name in ("MuJoCo", "scipy"):
            other = fastest(rows[name], target)
            if own is None or other is None:
                answers.print(f"error <= {target:g} rad: {name if own else 'via_sim'} does not reach it")
                continue
            ratio = other.seconds / own.seconds
            answers.print(f"error <= {target:g} rad: simulate() is {ratio:.1f} times as fast as {other.name}")
            summary[f"times_{name.lower()}_at_{target:g}"] = ratio
    summary["cubic_joint"] = cubic = stiff()
    answers.print("cubic joint, 10 s: " + ", ".join(f"{key} {value:.2e}" for key, value in cubic.items()))
    summary["speed_over_c"] = speed_beside_c(plant, motor)
    keep("simulator", summary)
