"""Rows at shipped settings: status and interval of every method as `estimator_for` sets it up from a device file.

The device file has the sensors of the table. Nothing else is chosen for the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from via_core.devices import Device
from via_core.metrics import WIDTH_95
from via_core.signals import Array, Signals
from via_core.status import Status
from via_estimators.contract import Estimates
from via_estimators.methods import estimator_for, method_for, methods_for

from via_validation.compare.parallel import within_budget
from via_validation.tables.rows import Row

OUTSIDE = 15.0  # [%] of the OK estimates whose 95 % interval may miss the truth
OUTSIDE_WORDS = "OK estimates whose 95 % interval misses the truth [%]"
BEGIN = 2.0  # [s] after which estimates count
LATE = 5.0  # [s] after which the motion has been seen
BUDGET = 4.0  # [s] processor time of a method per case, from which the number of its seeds follows


@dataclass(frozen=True)
class Plant:
    """A simulated joint of a table.

    device    device file for the estimators
    signals   measured signals for a seed
    truth     (n,) true stiffness of the device [N m/rad]
    noisy     whether seeds differ
    """

    device: Device
    signals: Callable[[int], Signals]
    truth: Array
    noisy: bool


@dataclass(frozen=True)
class Errors:
    """Errors of a method at shipped settings, means over seeds."""

    outside: float  # [%], NaN without any OK estimate
    ok: float  # [%] of the samples
    mse_2: float  # [(N m/rad)^2] from BEGIN on
    mse_5: float  # [(N m/rad)^2] from LATE on
    mse_ok: float  # [(N m/rad)^2] of the OK estimates from BEGIN on
    inertia: Array  # (seeds, 2) at the end [kg m^2]; NaN if the method does not estimate it
    damping: Array  # (seeds, 2) [N m s/rad]
    seeds: int


def with_sensors(device: Device, quantum: float | None, torque_noise: float, motor_quantum: float | None) -> Device:
    """The device file with these sensors: encoder steps [rad], None for exact angles, and noise [N m]."""
    changes = {"link_quantum": quantum, "motor_quantum": motor_quantum, "torque_noise": torque_noise}
    return device.model_copy(update={"sensors": device.sensors.model_copy(update=changes)})


def measured_methods(plant: Plant) -> tuple[str, ...]:
    """Methods that suit the device and whose inputs the table measures; the default first."""
    known = plant.signals(0)

    def has(name: str) -> bool:
        return name in known or name.rpartition("_")[0] in known

    found = [m for m in methods_for(plant.device) if all(map(has, estimator_for(plant.device, m).inputs))]
    return tuple(sorted(found, key=lambda method: method != method_for(plant.device)))


def errors(plant: Plant, method: str, seeds: int) -> Errors:
    """Errors of a method over up to `seeds` noise realisations."""
    estimator = estimator_for(plant.device, method)
    estimator.load()

    def run(seed: int) -> Estimates:
        return estimator.run(plant.signals(seed))

    found = within_budget(run, seeds if plant.noisy else 1, BUDGET)
    time = found[0].time
    counts, late = time >= BEGIN - 1e-9, time >= LATE - 1e-9
    error = np.stack([each.column("stiffness")[0] - plant.truth for each in found])
    held = np.abs(error) <= WIDTH_95 * np.stack([each.column("stiffness")[1] for each in found])
    ok = np.stack([each.status == Status.OK for each in found]) & counts
    none = np.full((len(found), 2), nan)
    motor = "motor_inertia_1" in estimator.outputs
    return Errors(
        outside=100.0 * float(1.0 - held[ok].mean()) if ok.any() else nan,
        ok=100.0 * float(ok[:, counts].mean()),
        mse_2=float(np.mean(error[:, counts] ** 2)),
        mse_5=float(np.mean(error[:, late] ** 2)),
        mse_ok=float(np.mean(error[ok] ** 2)) if ok.any() else nan,
        inertia=_last(found, "motor_inertia") if motor else none,
        damping=_last(found, "motor_damping") if motor else none,
        seeds=len(found) if plant.noisy else 0,
    )


def outside_row(at: str, what: str, found: Errors, settings: str, reason: str) -> Row:
    """The row of the interval; `reason` is the remark of a missed one."""
    missed = not found.outside <= OUTSIDE
    remark = f"status OK in {found.ok:.0f} % of the samples"
    return Row(f"{at}.outside", what, OUTSIDE_WORDS, None, found.outside if np.isfinite(found.outside) else None,
               OUTSIDE, settings, found.seeds, f"{remark}; {reason}" if missed else remark)  # fmt: skip


def _last(found: Sequence[Estimates], name: str) -> Array:
    """Last value of both motors (seeds, 2)."""
    return np.array([[each.column(f"{name}_{i}")[0][-1] for i in (1, 2)] for each in found])
