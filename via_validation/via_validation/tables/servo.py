"""`link_impedance` on simulated joints whose servo, payload or friction is not that of the device file.

The joint of the device file has the servo that was observed: dead time and speed limit besides the bandwidth. Each case
changes numbers of the joint, not those of the estimator, which has the settings of the device file. The true values are
the stiffness of the spring at the present deflection and viscous damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import save_figure
from via_core.devices import Device, load_device
from via_core.metrics import WIDTH_95
from via_core.signals import Array, Signals
from via_core.status import Status
from via_estimators.methods import estimator_for
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

from via_validation.tables.rows import Progress, Row

DEVICE = "maccepavd"
DURATION, COMMANDS, TICKS = 8.0, 50.0, 8  # [s]; [Hz] of commands; simulation steps per sample
PERCENT = 100.0
MISSED = 15.0  # [%] largest share of OK samples outside their 95 % interval
MOTIONS = ("steps", "tones", "varying", "slow", "square", "damper")


@dataclass(frozen=True)
class Case:
    """Numbers of a joint."""

    name: str
    payload: float = 1.0  # [-] factor on the link inertia
    bandwidth: float = 25.0  # [rad/s]
    speed_limit: float | None = 6.5  # [rad/s]
    dead_time: float = 0.045  # [s]
    friction: float = 0.0  # [N m] dry


CASES = (
    Case("as filed"),
    Case("payload doubled", payload=2.0),
    Case("speed limit 3", speed_limit=3.0),
    Case("bandwidth 15", bandwidth=15.0),
    Case("dry friction .02", friction=0.02),
    Case("dry friction .05", friction=0.05),
    Case("no dead time, no speed limit", speed_limit=None, dead_time=0.0),
    Case("dead time .08", dead_time=0.08),
    Case("bandwidth 40", bandwidth=40.0),
    Case("payload, speed limit 3", payload=2.0, speed_limit=3.0),
    Case("payload, bandwidth 15", payload=2.0, bandwidth=15.0),
    Case("payload, friction .03", payload=2.0, friction=0.03),
    Case("speed limit 3, bandwidth 15", speed_limit=3.0, bandwidth=15.0),
    Case("speed limit 3, friction .03", speed_limit=3.0, friction=0.03),
    Case("bandwidth 15, friction .03", bandwidth=15.0, friction=0.03),
)


@dataclass(frozen=True)
class Found:
    """Shares [-] of one case and output."""

    ok: float  # samples
    missed: float  # OK samples outside their interval
    error: float  # RMS, over the RMS of the true values
    sd: float  # RMS of the standard deviation, likewise
    worst: float  # missed, of the worst motion


def commands_of(motion: str, rng: np.random.Generator) -> Signals:
    """Equilibrium [rad], preset [rad] and damping [-] commands of a motion."""
    time = np.arange(0.0, DURATION, 1.0 / COMMANDS)
    turn, phase = 2.0 * np.pi * time, rng.uniform(0.0, 6.0, 3)
    equilibrium = 0.5 * np.sin(0.8 * turn + phase[0]) + 0.35 * np.sin(1.9 * turn + phase[1])
    preset, damping = np.full(len(time), rng.uniform(0.2, 1.2)), np.full(len(time), rng.uniform(0.0, 0.6))
    if motion == "steps":
        at = 0.0
        while at < DURATION:
            equilibrium[time >= at] = rng.uniform(-0.8, 0.8)
            at += rng.uniform(0.35, 0.9)
    elif motion == "varying":
        equilibrium = 0.6 * np.sin(1.1 * turn + phase[0]) + 0.25 * np.sin(2.7 * turn + phase[1])
        preset, damping = 0.7 + 0.4 * np.sin(0.4 * turn + phase[2]), 0.4 + 0.35 * np.sin(0.5 * turn + phase[0])
    elif motion == "slow":
        equilibrium = 0.5 * np.sin(0.35 * turn + phase[0]) + 0.1 * np.sin(1.3 * turn + phase[1])
    elif motion == "square":
        equilibrium = 0.7 * np.sign(np.sin(0.8 * turn + phase[0]))
    elif motion == "damper":
        damping = np.where((time + phase[2]) % 2.0 < 1.0, 0.0, 0.7)
    channels = {"equilibrium": equilibrium, "preset": preset, "damping": damping}
    return Signals(time, channels, {"equilibrium": "rad", "preset": "rad", "damping": "-"}, frozenset(channels))


def recorded(device: Device, case: Case, motion: str, seed: int) -> tuple[Array, dict[str, Array]]:
    """Rows (N, 5) of the estimator's samples, and the true stiffness and damping (N,)."""
    commands = commands_of(motion, np.random.default_rng(seed))
    link = device.link.model_copy(update={"inertia": case.payload * device.link.inertia})
    motors = tuple(motor.model_copy(update={"bandwidth": case.bandwidth}) for motor in device.motors)
    effects = [Effect("actuator_delay", "command", {"delay": case.dead_time})]
    if case.speed_limit is not None:
        effects.append(Effect("torque_saturation", "motor", {"limit": case.speed_limit}, motor=1))
    if case.friction > 0.0:
        effects.append(Effect("coulomb_friction", "link", {"torque": case.friction}))
    plant = JointPlant.from_device(device.model_copy(update={"link": link, "motors": motors})).with_effects(effects)
    rate, (start, preset) = device.sensors.rate, (commands[name][0] for name in ("equilibrium", "preset"))
    initial = InitialConditions([start, start, preset, 0.0, 0.0, 0.0], seed)
    run = simulate(plant, commands, DURATION, TICKS * rate, replace(Sensors.of_device(device), rate=rate), initial)
    measured, at = run.measured, TICKS * np.arange(len(run.measured))
    last = np.searchsorted(commands.time, measured.time + 1e-9, side="right") - 1
    held = [commands[name][last] for name in ("equilibrium", "preset")]
    truth = {
        "stiffness": run.truth["stiffness"][at],
        "damping": run.truth["damping"][at] + device.link.viscous_friction,
    }
    return np.column_stack([measured.time, measured["q"], measured["theta"][:, 0], *held]), truth


def found_in(device: Device, case: Case, seeds: int) -> dict[str, Found]:
    """Name of an output -> figures over all motions and seeds."""
    estimator = estimator_for(device)
    sums: dict[str, list[list[float]]] = {"stiffness": [], "damping": []}
    for motion in MOTIONS:
        per_seed: dict[str, list[list[float]]] = {name: [] for name in sums}
        for seed in range(seeds):
            rows, truth = recorded(device, case, motion, seed)
            estimates = estimator.run_rows(rows)[1]
            ok = estimates.status == Status.OK
            if not ok.any():
                continue
            for name, each in per_seed.items():
                value, sd = (column[ok] for column in estimates.column(name))
                error, size = np.abs(value - truth[name][ok]), float(np.sqrt(np.mean(truth[name][ok] ** 2)))
                each.append([
                    float(np.mean(ok)), float(np.mean(error > WIDTH_95 * sd)),
                    float(np.sqrt(np.mean(error**2))) / size, float(np.sqrt(np.mean(sd**2))) / size,
                ])  # fmt: skip
        for name, each in per_seed.items():
            if each:
                sums[name].append(np.mean(each, axis=0).tolist())
    found = {}
    for name, motions in sums.items():
        ok_share, missed, error_share, sd_share = np.mean(motions, axis=0).tolist()
        found[name] = Found(ok_share, missed, error_share, sd_share, float(np.max(np.array(motions)[:, 1])))
    return found


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Misses, error and standard deviation of stiffness and damping, one set of rows per case."""
    device, made = load_device(DEVICE), []
    for number, case in enumerate(CASES):
        progress(number, len(CASES), case.name)
        made += _rows_of(case, found_in(device, case, seeds), seeds)
    return made


def _rows_of(case: Case, found: dict[str, Found], seeds: int) -> list[Row]:
    settings = (
        f"simulated {DEVICE} with observed servo, {', '.join(MOTIONS)}, {DURATION:g} s each; link_impedance with the "
        "device file's numbers"
    )
    label = case.name.replace(" ", "_").replace(",", "").replace(".", "")
    made = []
    for name, each in found.items():
        numbers = (
            ("missed", "OK samples outside their 95 % interval", PERCENT * each.missed, MISSED),
            ("worst", "the same, worst motion", PERCENT * each.worst, None),
            ("error", "RMS error", PERCENT * each.error, None),
            ("sd", "RMS of the standard deviation", PERCENT * each.sd, None),
            ("ok", "samples with status OK", PERCENT * each.ok, None),
        )
        made += [
            Row(f"servo.{label}.{name}.{key}", f"{case.name}: {name}, {what}", "share [%]", None, ours, limit, settings,
                seeds)
            for key, what, ours, limit in numbers
        ]  # fmt: skip
    return made


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Error and standard deviation of the stiffness by case, with two seeds."""
    device = load_device(DEVICE)
    found = []
    for number, case in enumerate(CASES):
        progress(number, len(CASES), f"picture: {case.name}")
        found.append(found_in(device, case, 2))
    path = folder / "servo.png"
    _draw(found, path)
    return [path]


def _draw(found: Sequence[dict[str, Found]], path: Path) -> None:
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 5.0), sharey=True)
    at = np.arange(len(CASES))
    for axes, name in zip(panels, ("stiffness", "damping"), strict=True):
        axes.barh(at - 0.2, [PERCENT * each[name].error for each in found], 0.4, label="RMS error")
        axes.barh(at + 0.2, [PERCENT * each[name].sd for each in found], 0.4, label="standard deviation")
        axes.set_xlabel(f"{name} [% of its RMS value]")
    panels[0].set_yticks(at, [case.name for case in CASES])
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="lower center", ncol=2)
    figure.tight_layout(rect=(0.0, 0.06, 1.0, 1.0))
    save_figure(figure, path, dpi=110)
